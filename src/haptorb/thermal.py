"""Thermal models: resistance of a warm winding, one coil (winding, body, air), and several coupled coils."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, check_finite
from haptorb.compiled import kernel
from haptorb.errors import InputError

__all__ = [
    "ThermalNetwork",
    "TwoNode",
    "heat_step",
    "network_step",
    "resistance_ratio",
    "single_time_constant",
    "warm_ratio",
    "winding_temperature",
]


# --------------------------------------------------------------------------------------------------
# Resistance of a winding by its temperature.


Temperature = TypeVar("Temperature", float, Array)


def resistance_ratio(coefficient: float, reference: float, temperature: Temperature) -> Temperature:
    """Resistance over that at `reference` [K], of one or (m,) windings at `temperature` [K]; coefficient in [1/K].

    >>> resistance_ratio(3.93e-3, 293.15, np.array([293.15, 393.15])).tolist()
    [1.0, 1.393]
    """
    return 1 + coefficient * (temperature - reference)


def winding_temperature(coefficient: float, reference: float, ratio: Temperature) -> Temperature:
    """Temperature [K] of one or (m,) windings whose resistance is `ratio` times that at `reference` [K].

    >>> winding_temperature(3.93e-3, 293.15, np.array([1.0, 1.393])).round(2).tolist()
    [293.15, 393.15]
    """
    return reference + (ratio - 1) / coefficient


@kernel
def warm_ratio(coefficient: float, reference: float, temperature: float) -> float:
    """The same of one winding, in compiled code."""
    return 1.0 + coefficient * (temperature - reference)


# --------------------------------------------------------------------------------------------------
# Thermal model of one coil: winding → body → air, two nodes in series, solved exactly.
#
#     C_w dx_w/dt = P − G_wb (x_w − x_b)            x: rise above the ambient temperature [K]
#     C_b dx_b/dt = G_wb (x_w − x_b) − G_ba x_b
#
# Zárate 2020 prints three endurances of its coils: 17 W continuously (§III), full power for 5 s and half duty for 60 s
# (§V). One node cannot reproduce all of them: it would need a time constant of 65 s for one and of 171 s for the other.
# Two nodes can. Neglected: radiation, and the coupling of the coils.


_THERMAL_DRIVES = ("power", "current", "voltage")


@kernel
def heat_step(step: Array, winding: float, body: float, ambient: float, power: float) -> tuple[float, float]:
    """Return temperatures [K] of winding and body one step later; `step` (2, 3) from `TwoNode.step`, `power` [W] is
    constant in it."""
    w, b = winding - ambient, body - ambient
    return (
        ambient + step[0, 0] * w + step[0, 1] * b + step[0, 2] * power,
        ambient + step[1, 0] * w + step[1, 1] * b + step[1, 2] * power,
    )


@dataclass(frozen=True)
class TwoNode:
    """Two heat capacities [J/K] in series with two conductances [W/K]; all rises are above the ambient [K].

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
        """Fast time constant of the winding and slow one of the whole coil [s]."""
        _, rates = self._system()
        return float(-1 / rates[0]), float(-1 / rates[1])

    def steady_rise(self, power: float) -> Array:
        """Return the rise of winding and body (2,) [K] in steady state with `power` [W]."""
        body = power / self.body_to_air
        return np.array([body + power / self.winding_to_body, body])

    def step(self, dt: float) -> Array:
        """Return the exact step over `dt` [s] (2, 3): rises after = step @ (winding rise, body rise, constant power).

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
        """Return the rise of winding and body (..., 2) [K] at times `t` (...) [s] under constant `power` [W]."""
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
        """Return the time [s] until the winding's rise is `rise` [K] under `power` [W] at zero rise; inf if never.

        drive is held constant while the wire's resistance grows with `coefficient` [1/K] of its value at ambient:
        "power": the power itself; "current": power grows with resistance, which may run away; "voltage": power falls.

        Raises InputError for another drive, another shape, or a negative load.

        >>> coil = TwoNode(15.0, 73.0, 1.9, 1 / 3)
        >>> times = [coil.time_to(60.0, 60.0, drive=drive) for drive in ("current", "power", "voltage")]
        >>> times == sorted(times)
        True
        """
        if drive not in _THERMAL_DRIVES:
            raise InputError(f"drive must be one of {', '.join(_THERMAL_DRIVES)}; got {drive!r}")
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
        if abs(slow) < 1e-12:  # on the boundary of thermal runaway there is no steady state; a tiny offset gives one
            return self._first_crossing(rise, power, begin, heating * (1 - 1e-9))
        steady = -np.linalg.solve(rate, source)
        gap = begin - steady
        towards = rate @ gap
        one = float((towards[0] - slow * gap[0]) / (fast - slow))
        two = float((towards[0] - fast * gap[0]) / (slow - fast))

        def above(t: float) -> float:
            return float(steady[0] - rise + one * np.exp(fast * t) + two * np.exp(slow * t))

        # A sum of two exponentials has at most one extremum: a maximum may reach the rise before the slow one decays.
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
            # power at the winding's rise halfway through the step: second order, far below the model's own error
            guess = step @ np.array([*x, power / (1 + coefficient * x[0])])
            after = step @ np.array([*x, power / (1 + coefficient * (x[0] + guess[0]) / 2)])
            if after[0] >= rise:
                return float(t + dt * (rise - x[0]) / (after[0] - x[0]))
            if abs(after[0] - x[0]) < 1e-12 and abs(after[1] - x[1]) < 1e-12:
                break
            x, t = after, t + dt
        return float("inf")


def _root(function: Callable[[float], float], low: float, high: float, xtol: float = 1e-12) -> float:
    from scipy.optimize import brentq  # imported here: it takes 0.25 s, which only callers of this method should pay

    return float(brentq(function, low, high, xtol=xtol, rtol=1e-12))


def single_time_constant(power: float, time: float, sustained: float) -> float:
    """Return the time constant [s] of a node that withstands `power` [W] for `time` [s], `sustained` [W] continuously.

    Raises InputError if there is no such time constant.

    >>> [round(single_time_constant(p, t, 17.0)) for p, t in ((230.0, 5.0), (57.5, 60.0))]    # they contradict
    [65, 171]
    """
    if not (power > sustained > 0.0 and time > 0.0):
        raise InputError(f"needs power > sustained > 0 and time > 0; got {power} W, {sustained} W, {time} s")
    return float(-time / np.log1p(-sustained / power))


# --------------------------------------------------------------------------------------------------
# Thermal model of several coupled coils: windings, a body around each, one core between them, air outside.
#
#     C_w dw_j/dt = P_j − G_wb (w_j − b_j) − G_wc,j (w_j − c)      rises above the ambient temperature [K]
#     C_b db_j/dt = G_wb (w_j − b_j) − G_ba b_j
#     C_c dc/dt   = Σ_j G_wc,j (w_j − c)
#
# Fourier's law between nodes, for nested coils as those of Zárate 2020. Any network of capacities and conductances is
# solved, exactly: with symmetric conductances its modes are real, and every response is a sum of exponentials. Without
# a core it is one `TwoNode` for each coil. Neglected: radiation, and convection that increases with the rise.


_THERMAL_NETWORK_DRIVES = ("power", "current")
_SAMPLES = 400  #: number of samples of a response before a crossing is found exactly
_MAX_EXPONENT = 500.0  #: exponent of a response beyond any temperature, whose square is still finite
_SETTLED_TIME_CONSTANTS = 40.0  #: settling time in units of the slowest time constant


@kernel
def network_step(step: Array, rises: Array, power: Array, out: Array) -> None:
    """Write the `rises` (n,) [K] of all nodes one step later into `out` (n,); `power` (m,) [W] is constant in it.

    step (n, n + m) is `ThermalNetwork.step`.
    """
    n = rises.size
    for i in range(n):
        rise = 0.0
        for j in range(n):
            rise += step[i, j] * rises[j]
        for j in range(power.size):
            rise += step[i, n + j] * power[j]
        out[i] = rise


@dataclass(frozen=True)
class ThermalNetwork:
    """Nodes with heat capacities, conductances between them and to the air; the first `windings` nodes are heated.

    capacity  (n,) [J/K]
    exchange  (n, n) [W/K] conductance between every two nodes, symmetric
    to_air    (n,) [W/K] conductance of every node to the air

    Raises InputError for inconsistent shapes, invalid values, or a node without a path to the air.

    >>> pair = ThermalNetwork.of_coils(TwoNode(15.0, 73.0, 1.9, 1 / 3), (0.5, 0.5), 50.0)
    >>> pair.steady_rise((17.0, 0.0)).round(1).tolist()     # the other coil is warmed through the core
    [40.8, 19.1, 34.7, 16.3, 30.0]
    """

    capacity: Array
    exchange: Array
    to_air: Array
    windings: int

    def __post_init__(self) -> None:
        for name in ("capacity", "exchange", "to_air"):
            object.__setattr__(self, name, check_finite(getattr(self, name), name))
        n = len(self.capacity) if self.capacity.ndim == 1 else 0
        if not (1 <= self.windings <= n and self.exchange.shape == (n, n) and self.to_air.shape == (n,)):
            raise InputError(
                f"a thermal network needs capacity (n,), exchange (n, n), to_air (n,) and 1 to n windings; got "
                f"{self.capacity.shape}, {self.exchange.shape}, {self.to_air.shape}, {self.windings}"
            )
        if not (self.capacity > 0.0).all():
            raise InputError(f"capacities of a thermal network must be positive; got {self.capacity.tolist()} J/K")
        if (self.exchange < 0.0).any() or (self.to_air < 0.0).any() or (self.exchange != self.exchange.T).any():
            raise InputError("conductances of a thermal network [W/K] must be symmetric, and none negative")
        if not self._reaches_air():
            raise InputError(
                "every node of a thermal network must conduct heat to the air, or its temperature would have no limit"
            )

    @classmethod
    def of_coils(cls, coil: TwoNode, to_core: ArrayLike, core_capacity: float) -> ThermalNetwork:
        """Build the network of identical coils, winding and body each, around one core; nodes: windings, bodies, core.

        to_core (m,) [W/K] is the conductance of each winding to the core, `core_capacity` in [J/K]. With zero
        conductances there is no core.
        """
        conductance = check_finite(to_core, "to_core")
        m, core = conductance.size, bool(conductance.any())
        n = 2 * m + core
        capacity, exchange, to_air = np.empty(n), np.zeros((n, n)), np.zeros(n)
        capacity[:m], capacity[m : 2 * m] = coil.winding_capacity, coil.body_capacity
        to_air[m : 2 * m] = coil.body_to_air
        for j in range(m):
            exchange[j, m + j] = exchange[m + j, j] = coil.winding_to_body
        if core:
            capacity[-1] = core_capacity
            exchange[:m, -1] = exchange[-1, :m] = conductance
        return cls(capacity, exchange, to_air, m)

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return len(self.capacity)

    @property
    def rise_per_watt(self) -> Array:
        """Steady rise of each winding (row) for power in each (column) (m, m) [K/W]."""
        inverse: Array = np.asarray(np.linalg.inv(self._outflow()), dtype=np.float64)
        return inverse[: self.windings, : self.windings]

    @property
    def time_constants(self) -> Array:
        """Time constants (n,) [s], longest first."""
        constants: Array = np.sort(-1.0 / self._modes(np.zeros(self.windings))[0])[::-1]
        return constants

    def steady_rise(self, power: ArrayLike) -> Array:
        """Return the rise of all nodes (n,) [K] in steady state with `power` (m,) [W]."""
        return np.asarray(np.linalg.solve(self._outflow(), self._source(power)), dtype=np.float64)

    def step(self, dt: float) -> Array:
        """Return the exact step over `dt` [s] (n, n + m): rises after = step @ (rises, constant powers).

        Raises InputError for a negative time.
        """
        if not float(check_finite(dt, "dt")) >= 0.0:
            raise InputError(f"dt must be 0 or more; got {dt} s")
        rates, modes, root = self._modes(np.zeros(self.windings))
        remaining = np.exp(rates * dt)
        after = (modes * remaining) @ modes.T * root / root[:, None]
        driven = (modes * _integral(rates, dt)) @ modes.T / root / root[:, None]
        return np.ascontiguousarray(np.hstack([after, driven[:, : self.windings]]))

    def rise(self, t: ArrayLike, power: ArrayLike, start: ArrayLike | None = None) -> Array:
        """Return nodes' rise (..., n) [K] at times `t` (...) [s] under `power` (m,) [W] from `start` (n,)."""
        return self._course(check_finite(t, "t"), self._source(power), self._begin(start), np.zeros(self.windings))

    def time_to(
        self,
        rise: float,
        power: ArrayLike,
        start: ArrayLike | None = None,
        *,
        drive: str = "power",
        coefficient: float = 3.93e-3,
    ) -> float:
        """Time [s] until the first winding rises by `rise` [K]; `power` (m,) [W] at zero rise; inf if never.

        drive is held constant while the wires' resistance grows with `coefficient` [1/K] of its value at ambient:
        "power": the power itself; "current": power grows with resistance, which may run away. start (n,) [K] defaults
        to zero. Raises InputError for another drive, another shape, or a negative load.

        >>> alone = ThermalNetwork.of_coils(TwoNode(15.0, 73.0, 1.9, 1 / 3), (0.0,), 1.0)
        >>> round(alone.time_to(60.0, (60.0,)) - TwoNode(15.0, 73.0, 1.9, 1 / 3).time_to(60.0, 60.0), 6)
        0.0
        """
        if drive not in _THERMAL_NETWORK_DRIVES:
            raise InputError(f"drive must be one of {', '.join(_THERMAL_NETWORK_DRIVES)}; got {drive!r}")
        source, begin, m = self._source(power), self._begin(start), self.windings
        if (source < 0.0).any() or not (np.isfinite(rise) and coefficient >= 0.0):
            raise InputError(
                f"power must be 0 or more and all numbers finite; got {power!r} W, {rise} K, {coefficient}/K"
            )
        if begin[:m].max() >= rise:
            return 0.0
        heating = source[:m] * coefficient if drive == "current" else np.zeros(m)
        rates = self._modes(heating)[0]

        def above(t: float) -> float:
            return float(self._course(np.array(t), source, begin, heating)[:m].max() - rise)

        slowest = np.abs(rates)[np.abs(rates) > 1e-12].min(initial=np.inf)
        end = _SETTLED_TIME_CONSTANTS / min(slowest, float(np.abs(rates).max()))
        moments = np.geomspace(1e-4 / float(np.abs(rates).max()), end, _SAMPLES)
        course = self._course(moments, source, begin, heating)[:, :m].max(axis=1)
        beyond = np.flatnonzero(course >= rise)
        if not len(beyond):
            return float("inf")
        # imported here: it takes 0.25 s, which only callers of this method should pay
        from scipy.optimize import brentq

        first = int(beyond[0])
        return float(brentq(above, moments[first - 1] if first else 0.0, moments[first], xtol=1e-10, rtol=1e-12))

    def _outflow(self) -> Array:
        """Matrix of heat flow out of each node per kelvin of every node (n, n) [W/K]."""
        flow: Array = np.diag(self.exchange.sum(axis=1) + self.to_air) - self.exchange
        return flow

    def _reaches_air(self) -> bool:
        reached = self.to_air > 0.0
        for _ in range(self.nodes):
            reached = reached | (self.exchange[:, reached] > 0.0).any(axis=1)
        return bool(reached.all())

    def _source(self, power: ArrayLike) -> Array:
        watts = check_finite(power, "power")
        if watts.shape != (self.windings,):
            raise InputError(f"power [W] must have one value per winding, shape ({self.windings},); got {watts.shape}")
        return np.concatenate([watts, np.zeros(self.nodes - self.windings)])

    def _begin(self, start: ArrayLike | None) -> Array:
        begin = np.zeros(self.nodes) if start is None else check_finite(start, "start")
        if begin.shape != (self.nodes,):
            raise InputError(f"start must be the rises of all nodes [K], shape ({self.nodes},); got {begin.shape}")
        return begin

    def _modes(self, heating: Array) -> tuple[Array, Array, Array]:
        """Return rates (n,) [1/s], modes (n, n) and √C (n,) with `heating` (m,) [W/K] more power per kelvin of winding.

        √C x makes the rate matrix symmetric: its modes are orthogonal.
        """
        root = np.sqrt(self.capacity)
        gained = np.concatenate([heating, np.zeros(self.nodes - self.windings)])
        rates, modes = np.linalg.eigh((np.diag(gained) - self._outflow()) / np.outer(root, root))
        return rates, modes, root

    def _course(self, t: Array, source: Array, begin: Array, heating: Array) -> Array:
        rates, modes, root = self._modes(heating)
        remaining = np.exp(np.minimum(rates * t[..., None], _MAX_EXPONENT)) * (modes.T @ (root * begin))
        driven = _integral(rates, t[..., None]) * (modes.T @ (source / root))
        rises: Array = (remaining + driven) @ modes.T / root
        return rises


def _integral(rates: Array, t: Array | float) -> Array:
    """Return ∫ e^(λs) ds from 0 to `t` for each of the `rates` λ; t itself where λ is zero."""
    product = np.minimum(rates * t, _MAX_EXPONENT)
    small = np.abs(product) < 1e-12
    integral: Array = np.where(small, t, np.expm1(product) / np.where(small, 1.0, rates))
    return integral
