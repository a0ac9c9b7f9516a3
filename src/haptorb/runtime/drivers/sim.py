"""The simulated driver: a device, its tool and a hand that exist only as equations, behind the door of a real one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Protocol, final

import numpy as np

from haptorb.arrays import Array
from haptorb.control.guard import silence_of
from haptorb.control.trips import CoilState
from haptorb.devices.base import Device
from haptorb.errors import DriverError, InputError
from haptorb.estimation.types import Pose, Sample
from haptorb.rotations import quaternion
from haptorb.runtime.drivers.base import Driver
from haptorb.simulation.base import Simulation
from haptorb.simulation.hand import RelaxedHand
from haptorb.simulation.registry import simulate

__all__ = ["HandTarget", "ImperfectTracker", "PoseDistortion", "SimDriver"]


_LEAD = 150e-6  #: twice what a simulated device takes to move on by one tick, and to read its sensors [s] …
_LEAD_PER_COIL = 2.5e-6  #: … and for many coils, of each [s]
_CATCH_UP = 0.1  #: a longer pause of the loop is a pause of the simulated world too [s]


class HandTarget(Protocol):
    """Where the simulated hand wants the mover; what a pointer says."""

    @property
    def p(self) -> Array:
        """(3,) [m]."""

    @property
    def q(self) -> Array:
        """(4,) quaternion (x, y, z, w) of R_SR."""

    @property
    def stamp(self) -> float:
        """When this was said, on the loop's clock [s]."""

    @property
    def held(self) -> bool:
        """A person holds the pointer."""

    @property
    def still(self) -> bool:
        """The hand rests, and gives way to what pushes it."""


@final
class SimDriver(Driver):
    """Advances `simulation` by whole servo periods, as many as passed since the last `read`, then samples it.

    period [s] is the servo's. `goal(now)` says where the hand wants the mover; without it the hand stays at the start.
    Time passes in `prepare`, before the tick, as it does for a real device between two ticks; `read` hands over what
    its sensors said. Who does not prepare waits in `read` for the same result.
    Like a real device it switches its coils off by itself when no `read` comes for 20 ms (two periods, if these are
    longer), and does not latch it: the guard starts its ramp again.
    The pose is as old as the goal while a person holds the pointer, so that a console that has gone lets it expire;
    else it is fresh. Time is the argument of `read`: two runs with the same times, goals and duties are equal to the
    bit.

    Raises InputError if `period` is not above 0 and at most 0.1 s.
    """

    name = "sim"
    simulated = True

    def __init__(
        self, simulation: Simulation, period: float, goal: Callable[[float], HandTarget] | None = None, *, seed: int = 0
    ) -> None:
        if not (np.isfinite(period) and 0.0 < period <= _CATCH_UP):
            raise InputError(f"period of the servo must be above 0 and at most {_CATCH_UP} s; got {period} s")
        self.simulation = simulation
        self.lead = max(_LEAD, _LEAD_PER_COIL * simulation.device.channels)
        self.goal = goal
        self._period = float(period)
        self._silence = silence_of(self._period)
        self._seed = seed
        self._open = False
        self._start()

    @classmethod
    def of(
        cls, device: Device, period: float, goal: Callable[[float], HandTarget] | None = None, seed: int = 0
    ) -> SimDriver:
        """The driver of a simulated `device`; DeviceError if its kind cannot be simulated.

        >>> from haptorb.devices.loader import load
        >>> with SimDriver.of(load("omni"), 1e-3) as driver:
        ...     first = driver.read(0.0)
        >>> first.pose.valid, driver.write(np.ones(3)).tolist()       # closed: the coils stay off
        (True, [0.0, 0.0, 0.0])
        """
        return cls(simulate(device, seed), period, goal, seed=seed)

    def _start(self) -> None:
        channels = self.simulation.device.channels
        self._duties = np.zeros(channels)
        self._clock: float | None = None  # time up to which the world has been simulated
        self._hand = RelaxedHand()
        self._ready: Sample | None = None  # read by `prepare`, not yet by the loop
        state = self.simulation.state()
        self._target = np.concatenate((state.p, quaternion(state.R_SR)))

    def open(self) -> None:
        """Begin at the start again: coils off, noise from the seed."""
        self.simulation.reset(self._seed)
        self._start()
        self._open = True

    def close(self) -> None:
        """Coils off."""
        self._duties = np.zeros(self.simulation.device.channels)
        self._ready = None  # safety: prepared-dropped
        self._open = False

    def prepare(self, now: float) -> None:
        """Let time pass until `now` [s] and read the sensors, once. Raises DriverError as `read` does."""
        if self._ready is None or self._ready.t != now:
            self._ready = None
            self._ready = self._sample(now)

    def read(self, now: float) -> Sample:
        """The sample at `now` [s]; `now` may repeat but never decrease. Raises DriverError if it does, if it is not
        finite, and while the driver is not open."""
        ready, self._ready = self._ready, None
        if ready is not None and ready.t == now:
            return ready
        return self._sample(now)

    def _sample(self, now: float) -> Sample:
        if not self._open:
            raise DriverError("the simulated device is not open; use it in a `with` block or call open() first")
        if not now - now == 0.0:
            raise DriverError(f"the loop's clock must be finite; got {now}")
        stamp, valid, target = now, True, self._target
        if self.goal is not None:
            wish = self.goal(now)
            target[:3], target[3:] = wish.p, wish.q
            if wish.still:
                target[:] = self._rest(now)
            if wish.held:
                stamp = min(wish.stamp, now)
                valid = stamp - stamp == 0.0
        if self._clock is None:
            if self.goal is not None:
                with suppress(InputError):  # the hand begins where it wants to be, if that is a place
                    self.simulation.place(target[:3], target[3:])
            self._clock = now
        periods = round((now - self._clock) / self._period)
        if periods < 0:
            raise DriverError(f"the loop's clock went back from {self._clock} s to {now} s")
        if periods:
            self._clock += periods * self._period
            passed = min(periods * self._period, _CATCH_UP)
            # A board's watchdog: a loop that is silent for so long finds its coils off.
            # safety: simulated-watchdog
            if passed > self._silence + 1e-9:  # periods are whole, their sum is not
                self.simulation.advance(self._silence, self._duties, target[:3], target[3:])
                passed -= self._silence
                self._duties = np.zeros_like(self._duties)
            self.simulation.advance(passed, self._duties, target[:3], target[3:])
        return self.simulation.sample(now, stamp if valid else now, valid)

    def _rest(self, now: float) -> Array:
        """(7,) where a hand is that rests at the target."""
        place = self._hand.rest_at(self._target, now)
        if self._hand.is_due(now):
            state = self.simulation.state()
            self._hand.yield_to(np.concatenate((state.p, quaternion(state.R_SR))), now)
        return place

    def write(self, duties: Array) -> Array:
        """Chop `duties` (m,) and hold them until the next; returns (m,) what was applied, zeros when not open."""
        if self._open:
            self._duties = self.simulation.quantise(duties)
        return self._duties.copy()

    def cool(self) -> None:
        """The coils are at the ambient temperature, also in a sample that was prepared before."""
        self.simulation.cool()
        self._ready = None

    @property
    def coil_state(self) -> CoilState:
        """On while any duty is not zero."""
        # Of a list: numpy's own ways to ask take three to ten times as long.
        return CoilState.ON if any(self._duties.tolist()) else CoilState.OFF

    def truth(self) -> Array:
        """(6,) the mean wrench of coils and core on the mover over the last advance [N, N·m]."""
        return self.simulation.truth()

    def target(self) -> Array:
        """(7,) where the hand wants the mover: position [m], then quaternion (x, y, z, w). Overwritten by `read`."""
        return self._target


# --------------------------------------------------------------------------------------------------
# A tracker with errors: in front of a driver that knows the pose exactly and at once.


class PoseDistortion(ABC):
    """What a tracker makes of the poses that it measures: noise, delay."""

    @abstractmethod
    def reset(self) -> None:
        """Forget earlier poses: the driver opens."""

    @abstractmethod
    def distort(self, now: float, pose: Pose) -> Pose:
        """The pose that the tracker reports at `now` [s], if `pose` is the true one. Called once in every tick."""


@final
class ImperfectTracker(Driver):
    """Reports the poses of `inner` with `distortions`, one after the other; everything else is that of `inner`.

    It does not count as simulated: its poses are as old as they say, as with a real tracker.
    """

    name, simulated = "imperfect", False

    def __init__(self, inner: Driver, *distortions: PoseDistortion) -> None:
        self._inner, self._distortions = inner, distortions
        self.lead = inner.lead

    def open(self) -> None:
        """Open `inner`."""
        self._inner.open()
        for distortion in self._distortions:
            distortion.reset()

    def close(self) -> None:
        """Coils off."""
        self._inner.close()

    def prepare(self, now: float) -> None:
        """As `inner` does."""
        self._inner.prepare(now)

    def read(self, now: float) -> Sample:
        """The sample of `inner` with the pose that the tracker reports."""
        sample = self._inner.read(now)
        pose = sample.pose
        for distortion in self._distortions:
            pose = distortion.distort(now, pose)
        return replace(sample, pose=pose)

    def write(self, duties: Array) -> Array:
        """Apply `duties` (m,), −1…1 [1], as `inner` does; returns (m,) those applied."""
        return self._inner.write(duties)

    @property
    def coil_state(self) -> CoilState:
        """As `inner` knows it."""
        return self._inner.coil_state

    @property
    def field_axes(self) -> Array | None:
        """(k, 3) unit vectors [1] of `inner`."""
        return self._inner.field_axes

    def engage(self) -> None:
        """As `inner` does."""
        self._inner.engage()

    def cool(self) -> None:
        """As `inner` does."""
        self._inner.cool()

    def truth(self) -> Array:
        """(6,) as `inner` knows it [N, N·m]."""
        return self._inner.truth()

    def target(self) -> Array:
        """(7,) as `inner` knows it: position [m], quaternion."""
        return self._inner.target()
