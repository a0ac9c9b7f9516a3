"""Heat in one coil: winding → body → air, two bodies in a row, solved exactly.

    C_w dx_w/dt = P − G_wb (x_w − x_b)            x: rise above the ambient temperature [K]
    C_b dx_b/dt = G_wb (x_w − x_b) − G_ba x_b

Zárate 2020 prints three endurances of its coils: 17 W continuously (§III), full power for 5 s and half duty for 60 s
(§V). One body cannot hold them together: it would need a time constant of 65 s for one and of 171 s for the other. Two
can. Left out: radiation, and the coils' heating of each other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from haptorb.errors import InputError
from haptorb.numerics.arrays import Array, check_finite
from haptorb.numerics.compiled import kernel

__all__ = ["TwoNode", "heat_step", "single_time_constant"]

_DRIVES = ("power", "current", "voltage")


@kernel
def heat_step(step: Array, winding: float, body: float, ambient: float, power: float) -> tuple[float, float]:
    """Temperatures [K] of winding and body one step later; `step` (2, 3) from `TwoNode.step`, power [W] held in it."""
    w, b = winding - ambient, body - ambient
    return (
        ambient + step[0, 0] * w + step[0, 1] * b + step[0, 2] * power,
        ambient + step[1, 0] * w + step[1, 1] * b + step[1, 2] * power,
    )


@dataclass(frozen=True)
class TwoNode:
    """Two heat capacities [J/K] in a row with two conductances [W/K]; all rises are above the ambient [K].

    >>> coil = TwoNode(15.0, 73.0, 1.9, 1 / 3)
    >>> coil.steady_rise(17.0).round(2).tolist()
    [59.95, 51.0]
    """

    winding_capacity: float  #: C_w [J/K]
    body_capacity: float  #: C_b [J/K]
    winding_to_body: float  #: G_wb [W/K]
    body_to_air: float  #: G_ba [W/K]

    def __post_init__(self) -> None:
        for name in ("winding_capacity", "body_capacity", "winding_to_body", "body_to_air"):
            value = getattr(self, name)
            if not float(check_finite(value, name)) > 0.0:
                raise InputError(f"{name} of a coil's heat must be positive; got {value}")

    def _system(self, heating: float = 0.0) -> tuple[Array, Array]:
        """Rate matrix (2, 2) and its eigenvalues (2,), fast first, with `heating` [W/K] more power per kelvin of rise.

        Both rates are real: the off-diagonal terms have the same sign.
        """
        w, b = self.winding_capacity, self.body_capacity
        rate = np.array(
            [
                [(heating - self.winding_to_body) / w, self.winding_to_body / w],
                [self.winding_to_body / b, -(self.winding_to_body + self.body_to_air) / b],
            ]
        )
        middle = (rate[0, 0] + rate[1, 1]) / 2
        spread = np.sqrt(((rate[0, 0] - rate[1, 1]) / 2) ** 2 + rate[0, 1] * rate[1, 0])
        return rate, np.array([middle - spread, middle + spread])

    @property
    def time_constants(self) -> tuple[float, float]:
        """The winding's fast and the whole's slow time constant [s]."""
        _, rates = self._system()
        return float(-1 / rates[0]), float(-1 / rates[1])

    def steady_rise(self, power: float) -> Array:
        """(2,) rise of winding and body [K] in steady state with `power` [W]."""
        body = power / self.body_to_air
        return np.array([body + power / self.winding_to_body, body])

    def step(self, dt: float) -> Array:
        """(2, 3) exact step over `dt` [s]: rises after = step @ (winding rise, body rise, power held in between).

        Raises InputError for a negative time.

        >>> bool((TwoNode(15.0, 73.0, 1.9, 1 / 3).step(0.0) == [[1, 0, 0], [0, 1, 0]]).all())
        True
        """
        if not float(check_finite(dt, "dt")) >= 0.0:
            raise InputError(f"dt must be 0 or more; got {dt} s")
        rate, (fast, slow) = self._system()
        # exp(A t) by its two eigenvalues: (e^λ₂t (A − λ₁) − e^λ₁t (A − λ₂)) / (λ₂ − λ₁), with differences kept small.
        grown = (np.expm1(slow * dt) * (rate - fast * np.eye(2)) - np.expm1(fast * dt) * (rate - slow * np.eye(2))) / (
            slow - fast
        )
        return np.hstack([np.eye(2) + grown, -(grown @ self.steady_rise(1.0))[:, None]])

    def rise(self, t: ArrayLike, power: float, start: ArrayLike = (0.0, 0.0)) -> Array:
        """(..., 2) rise of winding and body [K] at times `t` (...) [s] under constant `power` [W]."""
        steady = self.steady_rise(power)
        times = check_finite(t, "t")
        rate, (fast, slow) = self._system()
        gap = check_finite(start, "start") - steady
        towards = rate @ gap
        one, two = (towards - slow * gap) / (fast - slow), (towards - fast * gap) / (slow - fast)
        rises: Array = steady + np.exp(fast * times)[..., None] * one + np.exp(slow * times)[..., None] * two
        return rises

    def time_to(
        self,
        rise: float,
        power: float,
        start: ArrayLike = (0.0, 0.0),
        *,
        drive: str = "power",
        coefficient: float = 3.93e-3,
    ) -> float:
        """Time [s] until the winding's rise is `rise` [K] under a load of `power` [W] at zero rise; inf if it never is.

        drive says what is held while the wire's resistance grows with `coefficient` [1/K] of its value at ambient:
        "power": the power itself; "current": power grows with resistance, which may run away; "voltage": power falls.

        Raises InputError for another drive, another shape, or a negative load.

        >>> coil = TwoNode(15.0, 73.0, 1.9, 1 / 3)
        >>> times = [coil.time_to(60.0, 60.0, drive=drive) for drive in ("current", "power", "voltage")]
        >>> times == sorted(times)
        True
        """
        if drive not in _DRIVES:
            raise InputError(f"drive must be one of {', '.join(_DRIVES)}; got {drive!r}")
        begin = check_finite(start, "start")
        if begin.shape != (2,):
            raise InputError(f"start must be the rises of winding and body [K], shape (2,); got {begin.shape}")
        if not (power >= 0.0 and np.isfinite(power) and np.isfinite(rise) and coefficient >= 0.0):
            raise InputError(
                f"power must be 0 or more and all numbers finite; got {power} W, {rise} K, {coefficient}/K"
            )
        if begin[0] >= rise:
            return 0.0
        if drive == "voltage" and coefficient > 0.0:
            return self._time_on_voltage(rise, power, begin, coefficient)
        heating = power * coefficient if drive == "current" else 0.0
        return self._first_crossing(rise, power, begin, heating)

    def _first_crossing(self, rise: float, power: float, begin: Array, heating: float) -> float:
        rate, (fast, slow) = self._system(heating)
        source = np.array([power / self.winding_capacity, 0.0])
        if abs(slow) < 1e-12:  # at the very edge of running away no steady state exists; a hair off it one does
            return self._first_crossing(rise, power, begin, heating * (1 - 1e-9))
        steady = -np.linalg.solve(rate, source)
        gap = begin - steady
        towards = rate @ gap
        one = float((towards[0] - slow * gap[0]) / (fast - slow))
        two = float((towards[0] - fast * gap[0]) / (slow - fast))

        def above(t: float) -> float:
            return float(steady[0] - rise + one * np.exp(fast * t) + two * np.exp(slow * t))

        # Two exponentials turn at most once: a summit may reach the rise before the slow one falls away from it.
        if one * two != 0.0 and -one * fast / (two * slow) > 0.0:
            turn = float(np.log(-one * fast / (two * slow)) / (slow - fast))
            if turn > 0.0 and above(turn) >= 0.0:
                return _root(above, 0.0, turn)
        rising = two * slow > 0.0 if two != 0.0 else one * fast > 0.0
        if not rising or (slow < 0.0 and steady[0] <= rise):
            return float("inf")
        upper = 1.0 / abs(fast)
        while above(upper) < 0.0:
            upper *= 2
            if upper > 1e4 / abs(slow):
                return float("inf")
        return _root(above, 0.0, upper)

    def _time_on_voltage(self, rise: float, power: float, begin: Array, coefficient: float) -> float:
        fast, slow = self.time_constants
        dt = fast / 400
        step = self.step(dt)
        x, t = begin, 0.0
        while t < 40 * slow:
            # Power at the winding's rise halfway through the step: second order, far below the model's own error.
            guess = step @ np.array([*x, power / (1 + coefficient * x[0])])
            after = step @ np.array([*x, power / (1 + coefficient * (x[0] + guess[0]) / 2)])
            if after[0] >= rise:
                return float(t + dt * (rise - x[0]) / (after[0] - x[0]))
            if abs(after[0] - x[0]) < 1e-12 and abs(after[1] - x[1]) < 1e-12:
                break
            x, t = after, t + dt
        return float("inf")


def _root(function: Callable[[float], float], low: float, high: float, xtol: float = 1e-12) -> float:
    from scipy.optimize import brentq  # a quarter of a second that only those who look for times should wait

    return float(brentq(function, low, high, xtol=xtol, rtol=1e-12))


def single_time_constant(power: float, time: float, sustained: float) -> float:
    """The time constant [s] of one body that withstands `power` [W] for `time` [s] and `sustained` [W] continuously.

    Raises InputError where no time constant could do it.

    >>> [round(single_time_constant(p, t, 17.0)) for p, t in ((230.0, 5.0), (57.5, 60.0))]    # they contradict
    [65, 171]
    """
    if not (power > sustained > 0.0 and time > 0.0):
        raise InputError(f"needs power > sustained > 0 and time > 0; got {power} W, {sustained} W, {time} s")
    return float(-time / np.log1p(-sustained / power))
