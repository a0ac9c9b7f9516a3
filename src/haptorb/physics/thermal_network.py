"""Heat in several coils that warm each other: windings, a body around each, one core between them, air outside.

    C_w dw_j/dt = P_j − G_wb (w_j − b_j) − G_wc,j (w_j − c)      rises above the ambient temperature [K]
    C_b db_j/dt = G_wb (w_j − b_j) − G_ba b_j
    C_c dc/dt   = Σ_j G_wc,j (w_j − c)

Fourier's law between nodes, for nested coils as those of Zárate 2020. Any network of capacities and conductances is
solved, exactly: with symmetric conductances its modes are real, and every course is a sum of exponentials. Without a
core it is one `TwoNode` for each coil. Left out: radiation, and convection that grows with the rise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from haptorb.errors import InputError
from haptorb.numerics.arrays import Array, check_finite
from haptorb.numerics.compiled import kernel
from haptorb.physics.thermal import TwoNode

__all__ = ["ThermalNetwork", "network_step"]

_DRIVES = ("power", "current")
_MOMENTS = 400  #: at which a course is looked at before a crossing is found exactly
_RUNAWAY = 500.0  #: exponent of a course beyond every temperature, whose square is still a number
_LONGEST = 40.0  #: after so many of the slowest time constants everything has settled


@kernel
def network_step(step: Array, rises: Array, power: Array, out: Array) -> None:
    """Write the `rises` (n,) [K] of all nodes one step later into `out` (n,); `power` (m,) [W] is held in it.

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

    Raises InputError for shapes that do not fit, values that cannot be, or a node from which no way leads to the air.

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
        """Coils that are alike, winding and body each, around one core: nodes are the windings, the bodies, the core.

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
        """(m, m) [K/W] steady rise of each winding (row) for power in each (column)."""
        inverse: Array = np.asarray(np.linalg.inv(self._outflow()), dtype=np.float64)
        return inverse[: self.windings, : self.windings]

    @property
    def time_constants(self) -> Array:
        """(n,) [s], the longest first."""
        constants: Array = np.sort(-1.0 / self._modes(np.zeros(self.windings))[0])[::-1]
        return constants

    def steady_rise(self, power: ArrayLike) -> Array:
        """(n,) rise of all nodes [K] in steady state with `power` (m,) [W]."""
        return np.asarray(np.linalg.solve(self._outflow(), self._source(power)), dtype=np.float64)

    def step(self, dt: float) -> Array:
        """(n, n + m) exact step over `dt` [s]: rises after = step @ (rises, powers held in between).

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
        """(..., n) rise of all nodes [K] at times `t` (...) [s] under constant `power` (m,) [W], from `start` (n,)."""
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
        """Time [s] until the first winding's rise is `rise` [K] under `power` (m,) [W] at zero rise; inf if never.

        drive says what is held while the wires' resistance grows with `coefficient` [1/K] of its value at ambient:
        "power": the power itself; "current": power grows with resistance, which may run away. start (n,) [K] is zero
        where it is not given. Raises InputError for another drive, another shape, or a negative load.

        >>> alone = ThermalNetwork.of_coils(TwoNode(15.0, 73.0, 1.9, 1 / 3), (0.0,), 1.0)
        >>> round(alone.time_to(60.0, (60.0,)) - TwoNode(15.0, 73.0, 1.9, 1 / 3).time_to(60.0, 60.0), 6)
        0.0
        """
        if drive not in _DRIVES:
            raise InputError(f"drive must be one of {', '.join(_DRIVES)}; got {drive!r}")
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
        end = _LONGEST / min(slowest, float(np.abs(rates).max()))
        moments = np.geomspace(1e-4 / float(np.abs(rates).max()), end, _MOMENTS)
        course = self._course(moments, source, begin, heating)[:, :m].max(axis=1)
        beyond = np.flatnonzero(course >= rise)
        if not len(beyond):
            return float("inf")
        from scipy.optimize import brentq  # a quarter of a second that only those who look for times should wait

        first = int(beyond[0])
        return float(brentq(above, moments[first - 1] if first else 0.0, moments[first], xtol=1e-10, rtol=1e-12))

    def _outflow(self) -> Array:
        """(n, n) [W/K]: heat that leaves each node per kelvin of every node."""
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
        """Rates (n,) [1/s], modes (n, n) and √C (n,) with `heating` (m,) [W/K] more power per kelvin of each winding.

        √C x makes the rate matrix symmetric: its modes are orthogonal.
        """
        root = np.sqrt(self.capacity)
        gained = np.concatenate([heating, np.zeros(self.nodes - self.windings)])
        rates, modes = np.linalg.eigh((np.diag(gained) - self._outflow()) / np.outer(root, root))
        return rates, modes, root

    def _course(self, t: Array, source: Array, begin: Array, heating: Array) -> Array:
        rates, modes, root = self._modes(heating)
        remaining = np.exp(np.minimum(rates * t[..., None], _RUNAWAY)) * (modes.T @ (root * begin))
        driven = _integral(rates, t[..., None]) * (modes.T @ (source / root))
        rises: Array = (remaining + driven) @ modes.T / root
        return rises


def _integral(rates: Array, t: Array | float) -> Array:
    """∫ e^(λs) ds from 0 to `t` for each of the `rates` λ; t itself where λ is zero."""
    product = np.minimum(rates * t, _RUNAWAY)
    small = np.abs(product) < 1e-12
    integral: Array = np.where(small, t, np.expm1(product) / np.where(small, 1.0, rates))
    return integral
