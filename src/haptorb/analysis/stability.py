"""Stability of a sampled loop with delay: passivity bound, delay bound, and the exact stability boundary for a hand.

A hand (mass m, damping b, stiffness k) in a world of stiffness K and damping B: m ẍ + b ẋ + k x = f. Poses are measured
every `period`, become a force after `delay`, and that force is held. Three criteria for the maximum K:

1. passive with any hand if b > K T/2 + |B| (Colgate and Schenkel 1997): a bound, not a boundary, and without delay;
2. stable, approximately, if K < (b + B)/(T/2 + t_d) (Gil et al. 2009): for oscillations slow compared with the delay;
3. stable if no eigenvalue of the loop over one period leaves the unit circle: exact for this hand, with the sampling,
   any delay, also fractions of a period, the velocity from the difference of two poses, and the currents' dynamics.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haptorb.arrays import Array
from haptorb.errors import InputError, UnknownName

__all__ = [
    "GRIPS",
    "MIN_STABILITY_MARGIN",
    "Field",
    "HandGrip",
    "SampledLoop",
    "Steepest",
    "Steepness",
    "check_grip",
    "steepest",
]


# --------------------------------------------------------------------------------------------------
# Models of hands for the stability of a loop: mass, spring and damper per axis.
#
# Measured by perturbation: Hogan 1989 and Hajian and Howe 1997 report 0.1 to 0.8 kg, 2 to 10 N·s/m and 100 to 500 N/m,
# from a pen held lightly to one held firmly. A tool that is not held has hardly any damping.


#: greatest damping [1/s] and stiffness [1/s²] of a hand per mass
_MAX_DAMPING_RATE, _MAX_STIFFNESS_RATE = 1e9, 1e12


@dataclass(frozen=True)
class HandGrip:
    """Impedance of a hand and the object in it, along one axis: m ẍ + b ẋ + k x = force.

    Parameters
    ----------
    mass : float
        Mass m of hand and tool [kg].
    damping : float
        Damping b [N·s/m].
    stiffness : float
        Stiffness k [N/m].

    Raises
    ------
    InputError
        If the mass is not positive, damping or stiffness is negative, damping is above 1e9/s times the mass, or
        stiffness above 1e12/s² times the mass: the motion over one period could not be computed.

    Notes
    -----
    Hogan 1989 and Hajian and Howe 1997 measured 0.1 to 0.8 kg, 2 to 10 N·s/m and 100 to 500 N/m, from a light to a firm
    grip; `haptorb.GRIPS` has three of them by name.

    Examples
    --------
    >>> HandGrip(0.1, -1.0, 0.0)
    Traceback (most recent call last):
    haptorb.errors.InputError: a grip needs mass > 0 kg, damping ≥ 0 N·s/m and stiffness ≥ 0 N/m; got 0.1, -1, 0
    """

    mass: float  #: [kg]
    damping: float  #: [N·s/m]
    stiffness: float  #: [N/m]

    def __post_init__(self) -> None:
        values = (self.mass, self.damping, self.stiffness)
        got = ", ".join(f"{value:g}" for value in values)
        if not (all(map(math.isfinite, values)) and self.mass > 0 and min(values) >= 0):
            raise InputError(f"a grip needs mass > 0 kg, damping ≥ 0 N·s/m and stiffness ≥ 0 N/m; got {got}")
        if self.damping > _MAX_DAMPING_RATE * self.mass or self.stiffness > _MAX_STIFFNESS_RATE * self.mass:
            raise InputError(
                f"a grip needs damping ≤ {_MAX_DAMPING_RATE:g}/s times mass, and stiffness ≤ "
                f"{_MAX_STIFFNESS_RATE:g}/s² times mass; got {got}"
            )

    def with_mass(self, mass: float) -> HandGrip:
        """Return the same hand with an additional mass.

        Parameters
        ----------
        mass : float
            Mass of the object [kg].

        Returns
        -------
        HandGrip
            The hand with the object.
        """
        return HandGrip(self.mass + mass, self.damping, self.stiffness)


MIN_STABILITY_MARGIN = 1.5  #: required gain margin of a loop: hands differ
#: Grips by name, `HandGrip` each. `loose` is assumed: fingers that only guide, with the minimum damping.
GRIPS = {
    "loose": HandGrip(0.1, 1.0, 20.0),
    "light": HandGrip(0.1, 2.0, 100.0),
    "firm": HandGrip(0.8, 10.0, 500.0),
}


def check_grip(text: str) -> HandGrip:
    """Return the grip with the name `text`, or with its three numbers MASS,DAMPING,STIFFNESS.

    Raises UnknownName for any other text.

    >>> check_grip("firm").damping, check_grip("0.2,3,50").mass
    (10.0, 0.2)
    """
    if text in GRIPS:
        return GRIPS[text]
    try:
        mass, damping, stiffness = (float(part) for part in text.split(","))
    except ValueError:
        raise UnknownName("grip", text, (*GRIPS, "MASS,DAMPING,STIFFNESS")) from None
    return HandGrip(mass, damping, stiffness)


_MIN_STIFFNESS, _MAX_STIFFNESS = 1e-2, 1e7  #: search range of the largest stiffness [N/m]
_MAX_DELAY_PERIODS = 64  #: maximum delay in periods


@dataclass(frozen=True)
class SampledLoop:
    """Timing of a sampled loop with delay, and the largest stiffness that it renders stably.

    `SampledLoop.of` makes one from rates and latency.

    Parameters
    ----------
    period : float
        Interval between two poses in use [s]: of the tracker, or of the servo if that is slower.
    delay : float
        Time from the measurement of a pose to the start of its force [s].
    ramp : float
        Time in which the drive changes a current from one commanded value to the next [s]: a tick of the servo.
    time_constant : float
        L/R of the coils [s]; 0: currents follow at once.
    memory : float
        Parameter θ of the filter that computes position and velocity from the poses [1]; 0: no filter.

    Raises
    ------
    InputError
        For a period that is not positive, a negative time, a ramp longer than the period, or a delay above 64 periods.

    Notes
    -----
    `passive_bound` is Colgate and Schenkel 1997 (any passive hand, no delay), `delay_bound` the condition of Gil et al.
    2009, and `largest` is exact for one hand: no eigenvalue of the loop over one period leaves the unit circle.

    Examples
    --------
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
        if self.delay > _MAX_DELAY_PERIODS * self.period:
            raise InputError(
                f"a delay of {1e3 * self.delay:g} ms is more than {_MAX_DELAY_PERIODS} periods "
                f"of {1e3 * self.period:g} ms: "
                "with this delay no world can be rendered"
            )

    @classmethod
    def of(
        cls, rate: float, tracker_rate: float | None = None, latency: float = 0.0, time_constant: float = 0.0,
        memory: float = 0.0,
    ) -> SampledLoop:  # fmt: skip
        """Make the loop of a servo and a tracker from rates and latency.

        Parameters
        ----------
        rate : float
            Rate of the servo [Hz].
        tracker_rate : float, optional
            Rate of the tracker [Hz]; None: a pose is read in every tick.
        latency : float
            Age of a pose when it arrives [s].
        time_constant : float
            L/R of the coils [s]; 0: currents follow at once.
        memory : float
            Parameter θ of the pose filter [1]; 0: no filter.

        Returns
        -------
        SampledLoop
            The loop. With a tracker on its own clock a pose waits for the next tick: on average half of the shorter
            period. If one rate is a multiple of the other, every pose waits for the same fraction of it.

        Raises
        ------
        InputError
            For a rate that is not above zero.

        Examples
        --------
        >>> round(SampledLoop.of(1000.0, tracker_rate=240.0, latency=5e-3).largest(GRIPS["light"]))      # [N/m]
        273
        """
        rates = [rate] if tracker_rate is None else [rate, tracker_rate]
        if not all(math.isfinite(one) and one > 0 for one in rates):
            raise InputError(f"rates must be above 0 Hz; got {', '.join(f'{one:g}' for one in rates)}")
        wait = 0.0 if tracker_rate is None else 0.5 / max(rates)
        return cls(1 / min(rates), latency + wait, 1 / rate, time_constant, memory)

    @property
    def lateness(self) -> float:
        """t_d [s]: the delay, plus the mean delay of the current's ramp."""
        return self.delay + self._ramp_area

    @property
    def _ramp_area(self) -> float:
        if self.time_constant == 0.0 or self.ramp == 0.0:
            return 0.0
        x = self.ramp / self.time_constant
        return self.ramp * (1 + 1 / x + 1 / math.expm1(-x))

    def passive_bound(self, damping: float, world_damping: float = 0.0) -> float:
        """Compute the largest stiffness with which the sampled world is passive, without delay: 2 (b − |B|)/T.

        Colgate and Schenkel 1997; a bound for any passive hand, not a boundary of stability.

        Parameters
        ----------
        damping : float
            Damping b of the hand [N·s/m].
        world_damping : float
            Damping B of the world [N·s/m].

        Returns
        -------
        float
            Stiffness K [N/m].
        """
        return max(2 * (damping - abs(world_damping)) / self.period, 0.0)

    def delay_bound(self, damping: float, world_damping: float = 0.0) -> float:
        """Compute the largest stiffness by the approximate condition with delay: (b + B)/(T/2 + t_d).

        Gil et al. 2009; valid for oscillations slow compared with the delay.

        Parameters
        ----------
        damping : float
            Damping b of the hand [N·s/m].
        world_damping : float
            Damping B of the world [N·s/m].

        Returns
        -------
        float
            Stiffness K [N/m].
        """
        return max((damping + world_damping) / (self.period / 2 + self.lateness), 0.0)

    def growth(self, grip: HandGrip, stiffness: complex, world_damping: float = 0.0) -> float:
        """Compute the magnitude of the largest eigenvalue of one period: below 1 the loop is stable.

        Parameters
        ----------
        grip : HandGrip
            Hand that holds the tool.
        stiffness : complex
            Stiffness of the world [N/m]; complex for a pair of eigenvalues of a non-conservative force field.
        world_damping : float
            Damping of the world [N·s/m].

        Returns
        -------
        float
            Growth per period [1].
        """
        return float(np.abs(np.linalg.eigvals(self._map(grip, stiffness, world_damping))).max())

    def largest(self, grip: HandGrip, stiffness: complex = 1.0, world_damping: float = 0.0) -> float:
        """Compute the factor by which a world's stiffness and damping may grow until the loop is unstable.

        Parameters
        ----------
        grip : HandGrip
            Hand that holds the tool.
        stiffness : complex
            Stiffness of the world [N/m].
        world_damping : float
            Damping of the world [N·s/m].

        Returns
        -------
        float
            Factor [1]; with stiffness 1 and no damping it is the largest stiffness itself [N/m]. Infinite if there is
            no limit.
        """
        scale = max(abs(stiffness), abs(world_damping) * 10.0)  # a damper at 10 rad/s is as strong as a spring of 10 B
        if scale == 0.0:
            return math.inf

        def is_unstable(factor: float) -> bool:
            return self.growth(grip, factor * stiffness, factor * world_damping) >= 1.0 + 1e-12

        low = 0.3 * self.delay_bound(grip.damping) / scale  # initial estimate; if unstable, the search starts near zero
        if low < _MIN_STIFFNESS / scale or is_unstable(low):
            low = _MIN_STIFFNESS / scale
            if is_unstable(low):
                return 0.0
        high = low
        while not is_unstable(high):
            low, high = high, 1.5 * high
            if high > _MAX_STIFFNESS / scale:
                return math.inf
        while high - low > 1e-4 * high:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if is_unstable(middle) else (middle, high)
        return low

    def _map(self, grip: HandGrip, K: complex, B: float) -> NDArray[Any]:
        """State transition over one period, from the start of one force to the next; (n, n).

        The state is x, v, the present force, the last pose, the delayed forces, and the filter's position and velocity.
        Without a filter the velocity is the difference of two poses.
        """
        late = math.ceil(self.delay / self.period - 1e-9)
        sampled = max(late * self.period - self.delay, 0.0)  # sampling time of the pose within the period
        n = 6 + late
        state = np.eye(n, dtype=np.complex128)  # columns: images of the unit states
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
        """Force computed for a sampled pose, with the filter's position and velocity after it."""
        if self.memory == 0.0:
            return -K * taken - B * (taken - before) / self.period, 0.0 * place, 0.0 * rate
        ahead = place + self.period * rate
        place = ahead + (1 - self.memory**2) * (taken - ahead)
        rate = rate + (1 - self.memory) ** 2 / self.period * (taken - ahead)
        return -K * place - B * rate, place, rate


@lru_cache(maxsize=4096)
def _transition(grip: HandGrip, time_constant: float, dt: float) -> Array:
    """(3, 4) x, v and current after `dt` from x, v, current and the current's setpoint (all as forces, in newtons)."""
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


# --------------------------------------------------------------------------------------------------
# Stiffness and damping of a world: numerical derivatives of its wrench by position and velocity over a workspace.
#
# A restoring spring counts as positive stiffness: sampling and delay can make it oscillate. Negative stiffness repels,
# as at the top of a dome, where the hand is meant to slip off.


#: (3,) force at a position (3,), with a velocity (3,), at a time [s]
Field = Callable[[Array, Array, float], Array]

_POSITION_STEP_M = 2e-5  #: step of the differences [m]
_VELOCITY_STEP_M_S = 0.05  #: step of the differences by velocity [m/s]
#: share of a change that remains over a quarter of the step: below for slopes, above for discontinuities
_JUMP_THRESHOLD = 0.6
_JUMP_PATHS = 150  #: number of paths on which discontinuities are searched
_MIN_JUMP_N = 1e-3  #: discontinuity below which it is not perceptible [N]


@dataclass(frozen=True)
class Steepness:
    """Stiffness and damping at one position, along one direction.

    A complex stiffness is an eigenvalue of a non-conservative force field, with a rotational part.
    """

    stiffness: complex  #: [N/m]
    damping: float  #: [N·s/m]
    place: tuple[float, float, float]  #: [m]


@dataclass(frozen=True)
class Steepest:
    """Maximum stiffness and damping of a world, with their positions.

    candidates   most critical for the loop: the strongest springs, dampers and negative dampers
    away         largest repelling stiffness [N/m]
    jump         largest discontinuity of the force [N], at which no gradient exists
    """

    candidates: tuple[Steepness, ...]
    away: float
    jump: float

    @property
    def stiffness(self) -> float:
        """Largest restoring stiffness [N/m]."""
        return max((one.stiffness.real for one in self.candidates), default=0.0) + 0.0

    @property
    def damping(self) -> float:
        """Largest magnitude of the world's own damping [N·s/m]."""
        return max((abs(one.damping) for one in self.candidates), default=0.0)


def steepest(
    field: Field, places: Array, inside: Callable[[Array], bool] = lambda p: True, *, seed: int = 0, keep: int = 12
) -> Steepest:
    """Evaluate `places` (n, 3) [m], maximise locally within `inside`, and return the `keep` most critical ones.

    Discontinuities of `field` are not slopes; they are measured, also between the places, and excluded.
    """
    rng = np.random.default_rng(seed)
    times = rng.uniform(0.0, 10.0, len(places))
    found: list[Steepness] = []
    away, jump = 0.0, _greatest_jump(field, places, times, inside)

    def linearize_at(p: Array, t: float, moving: bool) -> float:
        """Stiffness and damping at `p`; returns the strongest spring [N/m]."""
        nonlocal away, jump
        G, leap = _position_gradient(field, p, t)
        jump = max(jump, leap)
        at = (float(p[0]), float(p[1]), float(p[2]))
        pull, u = np.linalg.eigh(-0.5 * (G + G.T))
        away = max(away, -float(pull[0]))
        for D in _velocity_gradient(field, p, t) if moving else (np.zeros((3, 3)),):
            for j in range(3):
                found.append(Steepness(float(pull[j]), float(u[:, j] @ D @ u[:, j]), at))
        for gamma in np.linalg.eigvals(-G):
            if abs(gamma.imag) > 1e-6 * abs(gamma) and gamma.imag > 0:
                found.append(Steepness(complex(gamma), 0.0, at))
        return float(np.abs(pull).max())

    sizes = [linearize_at(p, t, True) for p, t in zip(places, times, strict=True)]
    scale = float(np.abs(places).max())
    for n in np.argsort(sizes)[::-1][:6]:
        p, best, reach, t = places[n].copy(), sizes[n], 0.05 * scale, float(times[n])
        while reach > _POSITION_STEP_M:
            tried = [q for q in p + 0.5 * reach * rng.normal(size=(8, 3)) if inside(q)]
            grown = [linearize_at(q, t, False) for q in tried]
            m = int(np.argmax(grown)) if grown else -1
            if grown and grown[m] > best:
                p, best = tried[m], grown[m]
            else:
                reach *= 0.5
        linearize_at(p, t, True)
    return Steepest(_select_critical(found, keep), away, jump)


def _select_critical(found: list[Steepness], keep: int) -> tuple[Steepness, ...]:
    """The strongest springs, dampers and negative dampers, without duplicates."""
    by: tuple[Callable[[Steepness], float], ...] = (
        lambda one: one.stiffness.real,
        lambda one: abs(one.stiffness) if one.stiffness.imag else 0.0,
        lambda one: one.damping,
        lambda one: -one.damping,
    )
    chosen: dict[Steepness, None] = {}
    for key in by:
        for one in sorted(found, key=key, reverse=True)[: keep // len(by)]:
            if key(one) > 1e-9:
                chosen[one] = None
    return tuple(chosen)


def _position_gradient(field: Field, p: Array, t: float) -> tuple[Array, float]:
    """(3, 3) ∂F/∂p [N/m] without discontinuous columns, and the largest discontinuity [N]."""
    G, jump, still = np.zeros((3, 3)), 0.0, np.zeros(3)
    for j in range(3):
        step = np.zeros(3)
        step[j] = _POSITION_STEP_M
        wide = field(p + step, still, t) - field(p - step, still, t)
        near = field(p + step / 4, still, t) - field(p - step / 4, still, t)
        whole, part = float(np.linalg.norm(wide)), float(np.linalg.norm(near))
        # otherwise the force is proportional to the step
        if whole > _MIN_JUMP_N and (part > _JUMP_THRESHOLD * whole or part == 0.0):
            beside = 1.25 * step if part == 0.0 else step
            leap = _find_jump(field, p - beside, p + beside, t)
            if leap > _MIN_JUMP_N:
                jump = max(jump, leap)
                continue
        G[:, j] = near / (_POSITION_STEP_M / 2)
    return G, jump


def _greatest_jump(field: Field, places: Array, times: Array, inside: Callable[[Array], bool]) -> float:
    """Largest discontinuity [N] on straight paths between consecutive points: bisection of the steepest segment."""
    still, jump = np.zeros(3), 0.0
    ways = []
    for a, b, t in list(zip(places, np.roll(places, 1, axis=0), times, strict=True))[:_JUMP_PATHS]:
        forces = np.array([field(a + s * (b - a), still, t) for s in np.linspace(0, 1, 33)])
        change = np.linalg.norm(np.diff(forces, axis=0), axis=1)
        n = int(change.argmax())
        ways.append((float(change[n]), a + n / 32 * (b - a), a + (n + 1) / 32 * (b - a), t))
    for change, low, high, t in sorted(ways, key=lambda way: -way[0])[:40]:
        if change <= max(jump, _MIN_JUMP_N):
            break
        if inside(low) and inside(high):
            jump = max(jump, _find_jump(field, low, high, t))
    return jump


def _find_jump(field: Field, low: Array, high: Array, t: float) -> float:
    """Discontinuity [N] between two positions: bisection of the half with the larger change, beyond any slope."""
    still = np.zeros(3)
    while np.linalg.norm(high - low) > 1e-9:
        middle = 0.5 * (low + high)
        f = field(middle, still, t)
        first = np.linalg.norm(f - field(low, still, t)) > np.linalg.norm(field(high, still, t) - f)
        low, high = (low, middle) if first else (middle, high)
    leap = float(np.linalg.norm(field(high, still, t) - field(low, still, t)))
    return leap if leap > _MIN_JUMP_N else 0.0


def _velocity_gradient(field: Field, p: Array, t: float) -> tuple[Array, Array]:
    """(3, 3) −∂F/∂v [N·s/m], symmetric: the largest and the smallest damping, among standing still and
    moving either way along each axis."""
    found = []
    for at in (np.zeros(3), *(_VELOCITY_STEP_M_S * np.eye(3)), *(-_VELOCITY_STEP_M_S * np.eye(3))):
        D = np.zeros((3, 3))
        for j in range(3):
            step = np.zeros(3)
            step[j] = 1e-4
            D[:, j] = -(field(p, at + step, t) - field(p, at - step, t)) / 2e-4
        found.append(0.5 * (D + D.T))
    spread = [np.linalg.eigvalsh(D) for D in found]
    most = max(range(len(found)), key=lambda n: float(spread[n][-1]))
    least = min(range(len(found)), key=lambda n: float(spread[n][0]))
    return found[most], found[least]
