"""Driver of a simulated device, its tool and a hand, with the interface of a real one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import final

import numpy as np

from haptorb.arrays import Array
from haptorb.compiled import load_compiler
from haptorb.control.missed_deadlines import silence_of
from haptorb.control.trip_reasons import CoilState
from haptorb.devices.base import Device
from haptorb.errors import DriverError, InputError
from haptorb.estimation.types import HandGoal, Pose, Sample
from haptorb.rotations import quaternion
from haptorb.runtime.drivers.base import Driver
from haptorb.simulation.base import Simulation
from haptorb.simulation.hand_motion import RelaxedHand
from haptorb.simulation.registry import simulate

__all__ = ["ImperfectTracker", "PoseDistortion", "SimDriver"]


_LEAD_S = 150e-6  #: twice the computing time of one tick of the simulation, including its sensors …
_LEAD_PER_COIL_S = 2.5e-6  #: … and additionally for each of many coils
_MAX_CATCH_UP_S = 0.1  #: longest simulated step; a longer pause of the loop pauses the simulation


@final
class SimDriver(Driver):
    """Driver that advances `simulation` by the whole servo periods since the last `read`, then samples it.

    period [s] is the servo's. `goal(now)` returns the goal of the hand; without it the hand stays at the start.
    The simulation advances in `prepare`, before the tick, as a real device does between two ticks; `read` returns the
    sensors' readings. Without `prepare`, `read` does both, with the same result.
    Like a real device it switches its coils off when there is no `read` for 20 ms (two periods, if these are
    longer), and does not latch that: the guard starts its ramp again.
    The pose is as old as the goal while the user holds the pointer, so that it expires when the console has ended;
    else it is current. Time is the argument of `read`: two runs with the same times, goals and duties are equal to the
    bit.

    Raises InputError if `period` is not above 0 and at most 0.1 s.
    """

    name = "sim"
    simulated = True

    def __init__(
        self, simulation: Simulation, period: float, goal: Callable[[float], HandGoal] | None = None, *, seed: int = 0
    ) -> None:
        if not (np.isfinite(period) and 0.0 < period <= _MAX_CATCH_UP_S):
            raise InputError(f"period of the servo must be above 0 and at most {_MAX_CATCH_UP_S} s; got {period} s")
        self.simulation = simulation
        self.lead = max(_LEAD_S, _LEAD_PER_COIL_S * simulation.device.channels)
        self.goal = goal
        self._period = float(period)
        self._silence = silence_of(self._period)
        self._seed = seed
        self._open = False
        self._start()

    @classmethod
    def of(
        cls, device: Device, period: float, goal: Callable[[float], HandGoal] | None = None, seed: int = 0
    ) -> SimDriver:
        """Make the driver of a simulated `device`; DeviceError if its kind cannot be simulated.

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
        self._squeezed, self._grip = 0.0, np.nan  # force on the gripper [N], goal of thumb and finger [m]
        self._clock: float | None = None  # time of the simulation
        self._hand = RelaxedHand()
        self._ready: Sample | None = None  # sample of `prepare`, not yet read by the loop
        state = self.simulation.state()
        self._hand_goal = np.concatenate((state.p, quaternion(state.R_SR)))

    def open(self) -> None:
        """Restart the simulation: coils off, noise from the seed."""
        self.simulation.reset(self._seed)
        self._start()
        self._open = True

    def close(self) -> None:
        """Coils and gripper off."""
        self._duties = np.zeros(self.simulation.device.channels)
        self._squeezed = 0.0
        self._ready = None  # safety: prepared-dropped
        self._open = False

    def prepare(self, now: float) -> None:
        """Advance the simulation to `now` [s] and read the sensors, once. Raises DriverError as `read` does."""
        if self._ready is None or self._ready.t != now:
            self._ready = None
            self._ready = self._sample(now)

    def read(self, now: float) -> Sample:
        """Return the sample at `now` [s]; `now` may repeat but never decrease. Raises DriverError if it does, if it is
        not finite, and while the driver is not open."""
        ready, self._ready = self._ready, None
        if ready is not None and ready.t == now:
            return ready
        return self._sample(now)

    def _sample(self, now: float) -> Sample:
        if not self._open:
            raise DriverError("the simulated device is not open; use it in a `with` block or call open() first")
        if not now - now == 0.0:
            raise DriverError(f"the loop's clock must be finite; got {now}")
        stamp, valid, wanted = now, True, self._hand_goal
        if self.goal is not None:
            goal = self.goal(now)
            wanted[:3], wanted[3:] = goal.p, goal.q
            if self.simulation.gripper is not None:
                self._grip = goal.grip
            if goal.still:
                wanted[:] = self._rest(now)
            if goal.held:
                stamp = min(goal.stamp, now)
                valid = stamp - stamp == 0.0
        if self._clock is None:
            if self.goal is not None:
                with suppress(InputError):  # the hand begins at its goal, if that is a valid pose
                    self.simulation.place(wanted[:3], wanted[3:])
                if self.simulation.gripper is not None:
                    self.simulation.gripper.reset(self._grip)
            self._clock = now
        periods = round((now - self._clock) / self._period)
        if periods < 0:
            raise DriverError(f"the loop's clock went back from {self._clock} s to {now} s")
        if periods:
            self._clock += periods * self._period
            passed = min(periods * self._period, _MAX_CATCH_UP_S)
            # The watchdog of a board: coils off if the loop is silent for that time.
            # safety: simulated-watchdog
            if passed > self._silence + 1e-9:  # tolerance for rounding of the sum of periods
                self._advance(self._silence)
                passed -= self._silence
                self._duties, self._squeezed = np.zeros_like(self._duties), 0.0
            self._advance(passed)
        return self.simulation.sample(now, stamp if valid else now, valid)

    def _advance(self, dt: float) -> None:
        """Let `dt` [s] pass in the simulation."""
        self.simulation.advance(dt, self._duties, self._hand_goal[:3], self._hand_goal[3:])
        if self.simulation.gripper is not None:
            self.simulation.gripper.advance(dt, self._squeezed, self._grip)

    def _rest(self, now: float) -> Array:
        """Pose (7,) of a hand that rests at its goal."""
        place = self._hand.rest_at(self._hand_goal, now)
        if self._hand.is_due(now):
            state = self.simulation.state()
            self._hand.yield_to(np.concatenate((state.p, quaternion(state.R_SR))), now)
        return place

    def write(self, duties: Array) -> Array:
        """Quantise and clip `duties` (m,); apply them until the next; return the applied (m,), zeros when not open."""
        if self._open:
            self._duties = self.simulation.quantise(duties)
        return self._duties.copy()

    def write_grip_force(self, force: float) -> float:
        """Command `force` [N] of the gripper until the next; return it, zero when not open or without a gripper."""
        able = self._open and self.simulation.gripper is not None  # safety: gripper-closed
        self._squeezed = force if able else 0.0
        return self._squeezed

    def cool(self) -> None:
        """Set the coils to the ambient temperature, also in a sample that was prepared before."""
        self.simulation.cool()
        self._ready = None

    @property
    def coil_state(self) -> CoilState:
        """ON while any duty is not zero."""
        # On a list: numpy's functions take three to ten times as long.
        return CoilState.ON if any(self._duties.tolist()) else CoilState.OFF

    def wrench_actual(self) -> Array:
        """Mean wrench (6,) of coils and core on the mover over the last advance [N, N·m]."""
        return self.simulation.wrench_actual()

    def hand_goal(self) -> Array:
        """Goal (7,) of the hand: position [m], then quaternion (x, y, z, w). Overwritten by `read`."""
        return self._hand_goal


# --------------------------------------------------------------------------------------------------
# Simulated tracker errors, for a driver that returns the exact pose without delay.


class PoseDistortion(ABC):
    """Error model of a tracker: noise, delay."""

    @abstractmethod
    def reset(self) -> None:
        """Reset its state when the driver opens."""

    @abstractmethod
    def distort(self, now: float, pose: Pose) -> Pose:
        """Return the pose reported at `now` [s], if `pose` is the true one. Called once in every tick."""


@final
class ImperfectTracker(Driver):
    """Driver that applies `distortions` in turn to the poses of `inner`; everything else is that of `inner`.

    It does not count as simulated: the ages of its poses are used, as with a real tracker.
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
        """Return the sample of `inner` with the pose that the tracker reports."""
        sample = self._inner.read(now)
        pose = sample.pose
        for distortion in self._distortions:
            pose = distortion.distort(now, pose)
        return replace(sample, pose=pose)

    def write(self, duties: Array) -> Array:
        """Apply `duties` (m,), −1…1 [1], as `inner` does; return those applied (m,)."""
        return self._inner.write(duties)

    def write_grip_force(self, force: float) -> float:
        """As `inner` does, `force` [N]."""
        return self._inner.write_grip_force(force)

    @property
    def coil_state(self) -> CoilState:
        """As of `inner`."""
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

    def wrench_actual(self) -> Array:
        """Wrench (6,) of `inner` [N, N·m]."""
        return self._inner.wrench_actual()

    def hand_goal(self) -> Array:
        """Goal (7,) of `inner`: position [m], quaternion."""
        return self._inner.hand_goal()


load_compiler()  # at import, so that no device waits for it
