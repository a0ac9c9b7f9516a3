"""How stiff a sampled, late loop may be: the passivity bound, the delay bound, and the exact boundary for a hand.

A hand (mass m, damping b, stiffness k) in a world of stiffness K and damping B: m ẍ + b ẋ + k x = f. Poses are taken
every `period`, become a force `delay` later, and that force is held. Three answers to how great K may be:

1. passive with any hand if b > K T/2 + |B| (Colgate and Schenkel 1997): a bound, not a boundary, and without delay;
2. stable, roughly, if K < (b + B)/(T/2 + t_d) (Gil et al. 2009): holds while the oscillation is slow against the delay;
3. stable if no eigenvalue of the loop over one period leaves the unit circle: exact for this hand, with the sampling,
   the delay as any part of a period, the velocity from the difference of two poses, and the currents' own course.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haptorb.control.stability.hand_grip import HandGrip
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array

__all__ = ["SampledLoop"]

_SOFT, _HARD = 1e-2, 1e7  #: between these a largest stiffness is sought [N/m]
_LONGEST = 64  #: a delay of more periods is refused


@dataclass(frozen=True)
class SampledLoop:
    """When poses are taken and when their forces act.

    period         between two poses that are used: of the tracker, or of the servo if that is slower [s]
    delay          from the moment of a pose to the beginning of its force [s]
    ramp           in which the drive brings a current from one wanted value to the next: a tick of the servo [s]
    time_constant  L/R of the coils, after which the ramp is shaped [s]; 0: currents jump
    memory         θ of the filter that makes place and velocity of a pose (`sensing.place_filter`); 0: none

    >>> SampledLoop(1e-3).delay_bound(1.0), round(SampledLoop(1 / 240, 5e-3).delay_bound(1.0), 1)
    (2000.0, 141.2)
    """

    period: float
    delay: float = 0.0
    ramp: float = 0.0
    time_constant: float = 0.0
    memory: float = 0.0

    def __post_init__(self) -> None:
        values = (self.period, self.delay, self.ramp, self.time_constant)
        if not (all(map(math.isfinite, values)) and self.period > 0 and min(values) >= 0):
            raise InputError(f"a loop needs a period above 0 and times of at least 0 [s]; got {values}")
        if not 0.0 <= self.memory < 1.0:
            raise InputError(f"a filter's memory is at least 0 and below 1; got {self.memory:g}")
        if self.ramp > self.period * (1 + 1e-9):
            raise InputError(f"ramp {self.ramp:g} s must not be longer than the period {self.period:g} s")
        if self.delay > _LONGEST * self.period:
            raise InputError(
                f"a delay of {1e3 * self.delay:g} ms is more than {_LONGEST} periods of {1e3 * self.period:g} ms: "
                "with this delay no world can be rendered"
            )

    @classmethod
    def of(
        cls, rate: float, tracker_rate: float | None = None, latency: float = 0.0, time_constant: float = 0.0,
        memory: float = 0.0,
    ) -> SampledLoop:  # fmt: skip
        """The loop of a servo at `rate` [Hz] with a tracker at `tracker_rate` [Hz], its poses `latency` [s] old.

        None: the pose is read in every tick. A tracker with a clock of its own makes its pose wait for the next tick,
        at worst the shorter of the two periods.

        Raises InputError for a rate that is not above zero.
        """
        rates = [rate] if tracker_rate is None else [rate, tracker_rate]
        if not all(math.isfinite(one) and one > 0 for one in rates):
            raise InputError(f"rates must be above 0 Hz; got {', '.join(f'{one:g}' for one in rates)}")
        wait = 0.0 if tracker_rate is None else 1 / max(rates)
        return cls(1 / min(rates), latency + wait, 1 / rate, time_constant, memory)

    @property
    def lateness(self) -> float:
        """t_d [s]: the delay, and how late the current's area is on its ramp."""
        return self.delay + self._ramp_area

    @property
    def _ramp_area(self) -> float:
        if self.time_constant == 0.0 or self.ramp == 0.0:
            return 0.0
        x = self.ramp / self.time_constant
        return self.ramp * (1 + 1 / x + 1 / math.expm1(-x))

    def passive_bound(self, damping: float, world_damping: float = 0.0) -> float:
        """Greatest K [N/m] with which the sampled world is passive, if nothing is late: 2 (b − |B|)/T."""
        return max(2 * (damping - abs(world_damping)) / self.period, 0.0)

    def delay_bound(self, damping: float, world_damping: float = 0.0) -> float:
        """Greatest K [N/m] by the rough condition with delay: (b + B)/(T/2 + t_d)."""
        return max((damping + world_damping) / (self.period / 2 + self.lateness), 0.0)

    def growth(self, grip: HandGrip, stiffness: complex, world_damping: float = 0.0) -> float:
        """The magnitude of the largest eigenvalue of one period: below 1 the loop is stable.

        A complex stiffness stands for a pair of eigenvalues of a force field that is no gradient.
        """
        return float(np.abs(np.linalg.eigvals(self._map(grip, stiffness, world_damping))).max())

    def largest(self, grip: HandGrip, stiffness: complex = 1.0, world_damping: float = 0.0) -> float:
        """The factor by which a world of `stiffness` and `world_damping` may be multiplied: 1 is the boundary.

        With stiffness 1 and no damping it is the largest stiffness itself [N/m]; inf where none is too large.
        """
        scale = max(abs(stiffness), abs(world_damping) * 10.0)  # a damper at 10 rad/s is as strong as a spring of 10 B
        if scale == 0.0:
            return math.inf

        def is_unstable(factor: float) -> bool:
            return self.growth(grip, factor * stiffness, factor * world_damping) >= 1.0 + 1e-12

        low = 0.3 * self.delay_bound(grip.damping) / scale  # a good guess; if not stable there, begin from next to none
        if low < _SOFT / scale or is_unstable(low):
            low = _SOFT / scale
            if is_unstable(low):
                return 0.0
        high = low
        while not is_unstable(high):
            low, high = high, 1.5 * high
            if high > _HARD / scale:
                return math.inf
        while high - low > 1e-4 * high:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if is_unstable(middle) else (middle, high)
        return low

    def _map(self, grip: HandGrip, K: complex, B: float) -> NDArray[Any]:
        """One period, from one force's beginning to the next; (n, n).

        The state is x, v, the force that acted until now, the last pose, the forces that are on their way, and the
        filter's place and velocity. Without a filter the velocity is the difference of two poses.
        """
        late = math.ceil(self.delay / self.period - 1e-9)
        sampled = max(late * self.period - self.delay, 0.0)  # when in the period the pose is taken
        n = 6 + late
        state = np.eye(n, dtype=np.complex128)  # columns: where every part of the state goes
        x, v, before, pose = state[0], state[1], state[2], state[3]
        if late:
            force = state[4]
        else:
            force, place, rate = self._answer(K, B, x, pose, state[-2], state[-1])
        taken = x if sampled <= 0.0 else None
        share = 1.0 if self._ramp_area == 0.0 else -1 / math.expm1(-self.ramp / self.time_constant)
        current, t = (force if self._ramp_area == 0.0 else before), 0.0
        ends = sorted({sampled, self.ramp if self._ramp_area else 0.0, self.period} - {0.0})
        for end in ends:
            ramping = t < self.ramp and self._ramp_area > 0.0
            goal = before + (force - before) * share if ramping else force
            step = _transition(grip, self.time_constant if self._ramp_area else 0.0, end - t)
            x, v, current = (row @ np.stack([x, v, current, goal]) for row in step)
            if not ramping:
                current = force
            t = end
            if taken is None and end == sampled:
                taken = x
        assert taken is not None
        if late:
            new, place, rate = self._answer(K, B, taken, pose, state[-2], state[-1])
        rows = [x, v, force, taken, *([*state[5:-2], new] if late else []), place, rate]
        return np.stack(rows)

    def _answer(
        self, K: complex, B: float, taken: NDArray[Any], before: NDArray[Any], place: NDArray[Any], rate: NDArray[Any]
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """The force to a pose that was taken, and the filter's place and velocity after it."""
        if self.memory == 0.0:
            return -K * taken - B * (taken - before) / self.period, 0.0 * place, 0.0 * rate
        ahead = place + self.period * rate
        place = ahead + (1 - self.memory**2) * (taken - ahead)
        rate = rate + (1 - self.memory) ** 2 / self.period * (taken - ahead)
        return -K * place - B * rate, place, rate


@lru_cache(maxsize=4096)
def _transition(grip: HandGrip, time_constant: float, dt: float) -> Array:
    """(3, 4) x, v and current after `dt` from x, v, current and the current's goal (all forces, in newtons)."""
    from scipy.linalg import expm

    m, b, k = grip.mass, grip.damping, grip.stiffness
    A = np.zeros((4, 4))
    A[0, 1] = 1.0
    A[1, :2] = -k / m, -b / m
    if time_constant > 0.0:
        A[1, 2] = 1 / m
        A[2, 2:] = -1 / time_constant, 1 / time_constant
    else:
        A[1, 3] = 1 / m
    out: Array = expm(A * dt)[:3]
    return out
