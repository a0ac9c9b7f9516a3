"""A round coil with a winding volume: field to a wanted precision, and what an electrician asks of it."""

from __future__ import annotations

from functools import lru_cache
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from haptorb.errors import InputError, PrecisionError
from haptorb.numerics.arrays import Array, check_finite, vectors
from haptorb.physics.sources import round_body
from haptorb.physics.sources.bessel import integrate_bessel
from haptorb.physics.sources.dipole import MU0
from haptorb.physics.sources.round_body import RoundBody
from haptorb.physics.sources.winding_field import winding_field, winding_gradient
from haptorb.physics.sources.zonal import FAR, coefficients

__all__ = ["COPPER_RESISTIVITY", "Coil"]

COPPER_RESISTIVITY = 1.7241e-8  #: annealed copper at 293 K (IEC 60028) [Ω·m]
COPPER_DENSITY = 8.89e3  #: annealed copper at 293 K (IEC 60028) [kg/m³]
COPPER_SPECIFIC_HEAT = 385.0  #: at 298 K [J/(kg·K)]

_SERIES_X, _SERIES_W = np.polynomial.legendre.leggauss(17)


@final
class Coil(RoundBody):
    """`turns` of wire that fill a ring between `inner_radius` and `outer_radius` [m] of `length` [m] evenly.

    Per ampere; a positive current is right-handed about +z. The field is the closed form of current sheets
    (see `current_sheet`) integrated over the wall's thickness by bisected Gauss rules, to `precision` relative to what
    the turns give before their fields cancel; `field_bounded` also tells the bound. Finite everywhere, in the winding
    too. Left out: the wire's helix, its single turns and its leads.

    Raises InputError for turns or lengths that are not positive, or an inner radius that is not the smaller one.

    >>> coil = Coil(turns=1000, inner_radius=4.764e-3, outer_radius=15.88e-3, length=7.62e-3)
    >>> float(coil.moment[2].round(5))      # N π (rₒ² + rₒrᵢ + rᵢ²)/3
    0.36707
    """

    def __init__(
        self, turns: float, inner_radius: float, outer_radius: float, length: float, precision: float = 1e-10
    ) -> None:
        number = check_finite(turns, "turns")
        if number.ndim or number <= 0:
            raise InputError(f"turns must be one positive number; got {turns!r}")
        self.turns = float(number)
        self.inner_radius = round_body.length(inner_radius, "inner_radius")
        self.outer_radius = round_body.length(outer_radius, "outer_radius")
        if self.inner_radius >= self.outer_radius:
            raise InputError(
                f"inner_radius must be below outer_radius; got {self.inner_radius} m and {self.outer_radius} m"
            )
        self.length = round_body.length(length, "length")
        self.precision = _relative(precision)
        self._density = MU0 * self.turns / (self.length * (self.outer_radius - self.inner_radius))
        self._shape = np.array([self.inner_radius, self.outer_radius, 0.5 * self.length])
        middle, half = 0.5 * (self.outer_radius + self.inner_radius), 0.5 * (self.outer_radius - self.inner_radius)
        self._series = coefficients(middle + half * _SERIES_X, 0.5 * self.length, self._density * half * _SERIES_W)
        self._far2 = (FAR * self.bounding_radius) ** 2

    def __repr__(self) -> str:
        return (
            f"Coil(turns={self.turns}, inner_radius={self.inner_radius}, outer_radius={self.outer_radius}, "
            f"length={self.length})"
        )

    @property
    def far_series(self) -> Array:
        """(16,) coefficients of the field's zonal series per ampere, n = 1, 3 … 31 [T·mⁿ⁺²] (see `zonal`)."""
        return self._series.copy()

    @property
    def moment(self) -> Array:
        """(3,) [A·m² per A]: N π (rₒ² + rₒrᵢ + rᵢ²)/3."""
        ro, ri = self.outer_radius, self.inner_radius
        return np.array([0.0, 0.0, self.turns * np.pi * (ro * ro + ro * ri + ri * ri) / 3])

    def field(self, points: ArrayLike) -> Array:
        """Flux density per ampere (..., 3) [T/A] at `points` (..., 3) [m], to the coil's own precision."""
        return self.field_bounded(points, self.precision)[0]

    def field_bounded(self, points: ArrayLike, precision: float) -> tuple[Array, Array]:
        """Field (..., 3) [T/A] and its error bound (...,) [T/A]; PrecisionError if `precision` is out of reach."""
        at = vectors(points, "points")
        flat = np.ascontiguousarray(at.reshape(-1, 3))
        precision = _relative(precision)
        out, bound, gross = np.empty_like(flat), np.empty(len(flat)), np.empty(len(flat))
        winding_field(flat, self._shape, self._series, self._density, precision, self._far2, out, bound, gross)
        _check_precision(bound, gross, precision, flat)
        return out.reshape(at.shape), bound.reshape(at.shape[:-1])

    def field_gradient(self, points: ArrayLike) -> Array:
        """(..., 3, 3) [T/m/A], [i, j] = ∂B_i/∂x_j; infinite on the winding volume's edges, where it raises."""
        at = vectors(points, "points")
        flat = np.ascontiguousarray(at.reshape(-1, 3))
        out, bound, gross = np.empty((len(flat), 3, 3)), np.empty(len(flat)), np.empty(len(flat))
        winding_gradient(flat, self._shape, self._series, self._density, self.precision, self._far2, out, bound, gross)
        _check_precision(bound, gross, self.precision, flat)
        return out.reshape(*at.shape, 3)

    def filaments(self, across: int, along: int) -> tuple[Array, Array, Array]:
        """The winding as `across` × `along` loops at Gauss points: radii [m], heights [m], turns."""
        x, u = np.polynomial.legendre.leggauss(across)
        y, v = np.polynomial.legendre.leggauss(along)
        middle, half = 0.5 * (self.outer_radius + self.inner_radius), 0.5 * (self.outer_radius - self.inner_radius)
        turns = 0.25 * self.turns * np.outer(u, v).ravel()
        return np.repeat(middle + half * x, along), np.tile(0.5 * self.length * y, across), turns

    def resistance(self, fill: float, resistivity: float = COPPER_RESISTIVITY) -> float:
        """Resistance [Ω] when conductor fills the share `fill` of the winding section: ρ 2πr̄N²/(fill·section).

        >>> round(Coil(1000, 4.764e-3, 15.88e-3, 7.62e-3).resistance(0.6), 2)
        22.0
        """
        mean = 0.5 * (self.outer_radius + self.inner_radius)
        return float(resistivity * 2 * np.pi * mean * self.turns**2 / (_share(fill) * self._section))

    def heat_capacity(self, fill: float) -> float:
        """[J/K] of the copper in the winding (insulation and former left out)."""
        volume = np.pi * (self.outer_radius**2 - self.inner_radius**2) * self.length
        return float(_share(fill) * volume * COPPER_DENSITY * COPPER_SPECIFIC_HEAT)

    @property
    def inductance(self) -> float:
        """Self-inductance [H] at low frequency, relative error below 1e-7.

        L = 2πμ0 N² ∫₀^∞ P(k)² (kl − 1 + e^(−kl))/(kl)² dk with P(k) = ∫ r J₁(kr) dr/(rₒ − rᵢ), the mean of the mutual
        inductances of all pairs of turns (Smythe 8.06 for one pair). P follows from ∫ x J₁(x) dx (`bessel`). The
        integrand falls as k⁻⁴ and is cut at k rₒ = 1500, where 1e-9 is left. Left out: insulation between turns.

        >>> c = 0.02     # Brooks's coil: square section of side c, inner radius c; Grover gives 1.6994 µH/m · r̄ N²
        >>> round(Coil(1, c, 2 * c, c).inductance / (1.5 * c) * 1e6, 4)
        1.6994
        """
        return self.turns**2 * _inductance_of_one_turn(self.inner_radius, self.outer_radius, self.length)

    @property
    def _section(self) -> float:
        return self.length * (self.outer_radius - self.inner_radius)


def _share(fill: float) -> float:
    if not 0 < float(check_finite(fill, "fill")) <= 1:
        raise InputError(f"fill must be a share of the winding section in (0, 1]; got {fill!r}")
    return float(fill)


def _relative(precision: float) -> float:
    number = check_finite(precision, "precision")
    if number.ndim or not 0 < number < 1:
        raise InputError(f"precision must be a relative error between 0 and 1; got {precision!r}")
    return float(number)


def _check_precision(bound: Array, gross: Array, precision: float, points: Array) -> None:
    """PrecisionError unless every bound is below `precision` of what the turns give before they cancel."""
    short = ~(bound <= max(precision, 1e-13) * gross)
    if short.any():
        worst = int(np.argmax(np.where(short, np.nan_to_num(bound / gross, nan=np.inf), 0)))
        raise PrecisionError(
            f"the coil's field at {points[worst].tolist()} m converged to {bound[worst] / gross[worst]:.1e} "
            f"relative, not to {precision:.1e}; request less, or move the point off the winding's edge"
        )


@lru_cache(maxsize=64)  # a search for a motor builds thousands with the same coils
def _inductance_of_one_turn(ri: float, ro: float, l: float) -> float:
    """L/N² [H] of a winding of inner and outer radius and length [m]; see `Coil.inductance`."""
    edges = np.concatenate([np.linspace(0, 1500 / ro, 1501)])
    x, w = np.polynomial.legendre.leggauss(6)
    half = 0.5 * np.diff(edges)[:, None]
    k = (0.5 * (edges[1:] + edges[:-1])[:, None] + half * x).ravel()
    weight = (half * w).ravel()
    p = (integrate_bessel(k * ro) - integrate_bessel(k * ri)) / (k * k * (ro - ri))
    kl = k * l
    mean = np.where(kl < 1e-3, 0.5 - kl / 6 + kl**2 / 24, (kl + np.expm1(-kl)) / kl**2)
    return float(2 * np.pi * MU0 * np.sum(weight * p**2 * mean))
