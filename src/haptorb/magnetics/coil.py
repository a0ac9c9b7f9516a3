"""Round coil with a winding volume: field to a given precision, resistance, inductance and heat capacity."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from haptorb.arrays import Array, check_finite, gauss_legendre, vectors
from haptorb.compiled import kernel
from haptorb.errors import GeometryError, InputError, PrecisionError
from haptorb.magnetics import source
from haptorb.magnetics.current_sheets import SERIES_RADII, coefficients, sheet, sheet_gradient, zonal, zonal_gradient
from haptorb.magnetics.dipole import MU0
from haptorb.magnetics.soft_sphere import SoftSphere
from haptorb.magnetics.source import RoundBody, Source, tensor

__all__ = [
    "COPPER_RESISTIVITY",
    "FAR_RADII",
    "CentredCoil",
    "Coil",
    "InteriorCoil",
    "WindingTable",
    "coil_and_core",
    "integrate_bessel",
    "table_field",
    "tabulate_winding",
    "winding_field",
    "winding_gradient",
]


# --------------------------------------------------------------------------------------------------
# Field of a round winding to a given precision: current sheets, integrated over the wall by adaptive Gauss rules.


_MAX_DEPTH = 48  #: maximum depth of bisection of one interval of the wall's thickness
_MAX_INTERVALS = 1000  #: maximum number of intervals for one point
_COARSE_X, _COARSE_W = gauss_legendre(8)
_FINE_X, _FINE_W = gauss_legendre(13)


@kernel
def _panel(left: float, right: float, h: float, rho: float, z: float, order: int, gradient: bool) -> tuple[float, ...]:
    """∫ of the sheets' components over the radius from `left` to `right` by the coarse (0) or fine (1) Gauss rule."""
    x, w = (_FINE_X, _FINE_W) if order else (_COARSE_X, _COARSE_W)
    half, middle = 0.5 * (right - left), 0.5 * (right + left)
    over, axial, shear = 0.0, 0.0, 0.0
    for i in range(x.shape[0]):
        if gradient:
            o, a, s = sheet_gradient(middle + half * x[i], h, rho, z)
            shear += half * w[i] * s
        else:
            o, a = sheet(middle + half * x[i], h, rho, z)
        over += half * w[i] * o
        axial += half * w[i] * a
    return over, axial, shear


@kernel
def _integral(
    inner: float, outer: float, h: float, rho: float, z: float, wanted: float, gradient: bool
) -> tuple[float, float, float, float, float]:
    """Components over the whole wall, difference of the two Gauss rules (bisected until small), and Σ|panels|.

    The wall is cut where the point's own radius crosses it, as the sheets' field is not smooth there.
    """
    left, right, level = np.empty(_MAX_DEPTH + 4), np.empty(_MAX_DEPTH + 4), np.empty(_MAX_DEPTH + 4, np.int64)
    left[0], right[0], level[0] = inner, outer, 0
    count = 1
    if inner < rho < outer:
        right[0] = rho
        left[1], right[1], level[1] = rho, outer, 0
        count = 2
    lever = max(rho, 0.1 * outer)  # lever arm that converts B_ρ/ρ to a field for the error estimate
    total_over, total_axial, total_shear, error, gross = 0.0, 0.0, 0.0, 0.0, 0.0
    spent = 0
    while count:
        count -= 1
        spent += 1
        a, b, deep = left[count], right[count], level[count]
        o0, z0, s0 = _panel(a, b, h, rho, z, 0, gradient)
        o1, z1, s1 = _panel(a, b, h, rho, z, 1, gradient)
        if gradient:
            off = max(abs(o1 - o0), abs(z1 - z0), lever * abs(s1 - s0))
            size = max(abs(o1), abs(z1), lever * abs(s1))
        else:
            off = max(lever * abs(o1 - o0), abs(z1 - z0))
            size = max(lever * abs(o1), abs(z1))
        # tolerance in proportion to width or to magnitude, whichever is larger
        share = max((b - a) / (outer - inner) * (gross + size), size)
        if off > 0.2 * wanted * share and deep < _MAX_DEPTH and spent < _MAX_INTERVALS and b - a > 1e-11 * outer:
            middle = 0.5 * (a + b)
            left[count], right[count], level[count] = a, middle, deep + 1
            left[count + 1], right[count + 1], level[count + 1] = middle, b, deep + 1
            count += 2
            continue
        total_over += o1
        total_axial += z1
        total_shear += s1
        error += off
        gross += size
    return total_over, total_axial, total_shear, error, gross


@kernel
def winding_field(
    points: Array, shape: Array, c: Array, density: float, wanted: float, far2: float, out: Array, bound: Array,
    gross: Array,
) -> None:  # fmt: skip
    """Fill out (n, 3) [T] with the field at points (n, 3) [m], bound (n,) with its error, gross (n,) before
    cancellation.

    shape (3,): inner and outer radius, half length [m]; c, far2: the zonal series for points beyond √far2; density:
    [T/m] of one ampere; wanted: relative precision.
    """
    inner, outer, h = shape
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        rho2 = x * x + y * y
        if rho2 + z * z > far2:
            over, b_z = zonal(c, rho2, z)
            whole = abs(b_z) + np.sqrt(rho2) * abs(over)
            error = 1e-14 * whole
        else:
            over, b_z, _, error, whole = _integral(inner, outer, h, np.sqrt(rho2), z, wanted, False)
            over, b_z, error, whole = density * over, density * b_z, density * error, density * whole
        out[n, 0], out[n, 1], out[n, 2], bound[n], gross[n] = over * x, over * y, b_z, error, whole


@kernel
def winding_gradient(
    points: Array, shape: Array, c: Array, density: float, wanted: float, far2: float, out: Array, bound: Array,
    gross: Array,
) -> None:  # fmt: skip
    """Gradient as in `winding_field`: out (n, 3, 3) [T/m], bound and gross [T/m]."""
    inner, outer, h = shape
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        rho2 = x * x + y * y
        if rho2 + z * z > far2:
            over, stretch, shear = zonal_gradient(c, rho2, z)
            whole = abs(stretch) + abs(over)
            error = 1e-14 * whole
        else:
            over, stretch, shear, error, whole = _integral(inner, outer, h, np.sqrt(rho2), z, wanted, True)
            over, stretch, shear = density * over, density * stretch, density * shear
            error, whole = density * error, density * whole
        tensor(x, y, over, stretch, shear, out[n])
        # in the wire curl B = μ0 J: ∂B_z/∂ρ does not contain it yet
        if inner * inner < rho2 < outer * outer and abs(z) < h:
            out[n, 2, 0] -= density * x / np.sqrt(rho2)
            out[n, 2, 1] -= density * y / np.sqrt(rho2)
        bound[n], gross[n] = error, whole


COPPER_RESISTIVITY = 1.7241e-8  #: annealed copper at 293 K (IEC 60028) [Ω·m]
COPPER_DENSITY = 8.89e3  #: annealed copper at 293 K (IEC 60028) [kg/m³]
COPPER_SPECIFIC_HEAT = 385.0  #: at 298 K [J/(kg·K)]

_SERIES_X, _SERIES_W = gauss_legendre(17)


@final
class Coil(RoundBody):
    """Thick round coil: turns of wire that fill a rectangular cross-section uniformly; per ampere.

    A positive current is right-handed about +z.

    Parameters
    ----------
    turns : float
        Number of turns [1].
    inner_radius : float
        Inner radius of the winding [m].
    outer_radius : float
        Outer radius of the winding [m].
    length : float
        Length along the axis [m].
    precision : float
        Bound of the field's error relative to what the turns give before their fields cancel [1].

    Raises
    ------
    InputError
        If turns or lengths are not positive, or the inner radius is not smaller than the outer one.

    Notes
    -----
    Closed form of current sheets (Callaghan & Maslen 1960, Derby & Olbert 2010) integrated over the thickness of the
    wall by bisected Gauss rules; `field_bounded` also returns the bound. Finite everywhere, in the winding too. Left
    out: the wire's helix, its single turns and its leads.

    Examples
    --------
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
        self.inner_radius = source.length(inner_radius, "inner_radius")
        self.outer_radius = source.length(outer_radius, "outer_radius")
        if self.inner_radius >= self.outer_radius:
            raise InputError(
                f"inner_radius must be below outer_radius; got {self.inner_radius} m and {self.outer_radius} m"
            )
        self.length = source.length(length, "length")
        self.precision = _relative(precision)
        self._density = MU0 * self.turns / (self.length * (self.outer_radius - self.inner_radius))
        self._shape = np.array([self.inner_radius, self.outer_radius, 0.5 * self.length])
        self._far2 = (SERIES_RADII * self.bounding_radius) ** 2

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
        """Compute the field, with a bound of its error.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            Points in the frame of the coil [m].
        precision : float
            Greatest relative error of the field [1].

        Returns
        -------
        field : ndarray, shape (..., 3)
            Field per ampere [T/A].
        bound : ndarray, shape (...)
            Bound of its error [T/A].

        Raises
        ------
        PrecisionError
            If `precision` is out of reach.
        """
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
        """Replace the winding by loops at Gauss points.

        Parameters
        ----------
        across : int
            Loops along the radius.
        along : int
            Loops along the axis.

        Returns
        -------
        radii : ndarray, shape (n,)
            Radius of each of the `across` × `along` loops [m].
        heights : ndarray, shape (n,)
            Height on the axis [m].
        turns : ndarray, shape (n,)
            Turns that each stands for [1].
        """
        x, u = gauss_legendre(across)
        y, v = gauss_legendre(along)
        middle, half = 0.5 * (self.outer_radius + self.inner_radius), 0.5 * (self.outer_radius - self.inner_radius)
        turns = 0.25 * self.turns * np.outer(u, v).ravel()
        return np.repeat(middle + half * x, along), np.tile(0.5 * self.length * y, across), turns

    def resistance(self, fill: float, resistivity: float = COPPER_RESISTIVITY) -> float:
        """Compute the resistance of the winding: ρ 2πr̄N²/(fill·section).

        Parameters
        ----------
        fill : float
            Share of the winding's section that is conductor [1], above 0 and up to 1.
        resistivity : float, optional
            Resistivity ρ of the conductor [Ω·m]; that of copper at 20 °C unless given.

        Returns
        -------
        float
            Resistance [Ω].

        Examples
        --------
        >>> round(Coil(1000, 4.764e-3, 15.88e-3, 7.62e-3).resistance(0.6), 2)
        22.0
        """
        mean = 0.5 * (self.outer_radius + self.inner_radius)
        return float(resistivity * 2 * np.pi * mean * self.turns**2 / (_share(fill) * self._section))

    def heat_capacity(self, fill: float) -> float:
        """Compute the heat capacity of the copper, without insulation and former.

        Parameters
        ----------
        fill : float
            Share of the winding's section that is copper [1], above 0 and up to 1.

        Returns
        -------
        float
            Heat capacity [J/K].
        """
        volume = np.pi * (self.outer_radius**2 - self.inner_radius**2) * self.length
        return float(_share(fill) * volume * COPPER_DENSITY * COPPER_SPECIFIC_HEAT)

    @property
    def inductance(self) -> float:
        """Self-inductance [H] at low frequency, relative error below 1e-7.

        L = 2πμ0 N² ∫₀^∞ P(k)² (kl − 1 + e^(−kl))/(kl)² dk with P(k) = ∫ r J₁(kr) dr/(rₒ − rᵢ), the mean of the mutual
        inductances of all pairs of turns (Smythe 8.06 for one pair). P follows from ∫ x J₁(x) dx (`integrate_bessel`).
        The integrand falls as k⁻⁴ and is truncated at k rₒ = 1500, with an error of 1e-9. Insulation is neglected.

        >>> c = 0.02     # Brooks's coil: square section of side c, inner radius c; Grover gives 1.6994 µH/m · r̄ N²
        >>> round(Coil(1, c, 2 * c, c).inductance / (1.5 * c) * 1e6, 4)
        1.6994
        """
        return self.turns**2 * _inductance_of_one_turn(self.inner_radius, self.outer_radius, self.length)

    @cached_property
    def _series(self) -> Array:
        """`far_series`, when it is needed: a simulated winding is a coil for each of its layers, seen from nearby."""
        middle, half = 0.5 * (self.outer_radius + self.inner_radius), 0.5 * (self.outer_radius - self.inner_radius)
        return coefficients(middle + half * _SERIES_X, 0.5 * self.length, self._density * half * _SERIES_W)

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
    """Raise PrecisionError unless every bound is below `precision` of the field of the turns before cancellation."""
    short = ~(bound <= max(precision, 1e-13) * gross)
    if short.any():
        worst = int(np.argmax(np.where(short, np.nan_to_num(bound / gross, nan=np.inf), 0)))
        raise PrecisionError(
            f"the coil's field at {points[worst].tolist()} m converged to {bound[worst] / gross[worst]:.1e} "
            f"relative, not to {precision:.1e}; request less, or move the point off the winding's edge"
        )


# --------------------------------------------------------------------------------------------------
# Self-inductance of a round winding, by ∫₀ˣ t J₁(t) dt without scipy, whose special functions take longer to import
# than a device file.
#
# Sources: Abramowitz & Stegun 1964, 9.1.18 (Bessel's integral), 9.2.5 (Hankel's expansions), 11.1.7 (the integral by
# Struve's functions) and 12.1.29 (their expansions).


_MIN_EXPANSION_ARGUMENT = 30.0  #: argument from which the expansions are used, with terms that fall below 1e-12
_BESSEL_NODES = 24  #: of the integral below it; its error is of the order of J₉₆(30)
_BESSEL_TERMS = 8


def integrate_bessel(x: Array) -> Array:
    """∫₀ˣ t J₁(t) dt = ∫₀ˣ J₀ dt − x J₀(x) for x ≥ 0, same shape, without dimension [1]; error below 1e-11.

    >>> float(integrate_bessel(np.array([1.0]))[0].round(8))
    0.15453272
    """
    x = np.asarray(x, dtype=float)
    out, near = np.empty(x.shape), x < _MIN_EXPANSION_ARGUMENT
    s = np.sin(0.5 * np.pi * (np.arange(_BESSEL_NODES) + 0.5) / _BESSEL_NODES)
    phase = x[near][..., None] * s
    out[near] = (np.sin(phase) / s - x[near][..., None] * np.cos(phase)).mean(axis=-1)
    out[~near] = _expand_bessel_integral(x[~near])
    return out


def _expand_bessel_integral(x: Array) -> Array:
    """1 + (πx/2)(J₁ A₀ − J₀ A₁) with Aₙ = Hₙ − Yₙ, as J₁Y₀ − J₀Y₁ = 2/(πx)."""
    square = 1.0 / (x * x)
    a0, a1, term, other = np.ones_like(x), 1.0 + square, np.ones_like(x), square
    for k in range(1, _BESSEL_TERMS):
        term = -term * (2 * k - 1) ** 2 * square
        a0 = a0 + term
        other = -other * (2 * k + 1) * (2 * k - 1) * square
        a1 = a1 + other
    out: Array = 1.0 + _bessel(1, x) * a0 - x * _bessel(0, x) * a1
    return out


def _bessel(order: int, x: Array) -> Array:
    """J of that order by Hankel's expansion."""
    p, q, term = np.ones_like(x), np.zeros_like(x), np.ones_like(x)
    for k in range(1, 2 * _BESSEL_TERMS):
        term = term * (4 * order * order - (2 * k - 1) ** 2) / (8 * k * x)
        sign = -1.0 if k % 4 in (2, 3) else 1.0
        if k % 2:
            q = q + sign * term
        else:
            p = p + sign * term
    angle = x - (0.5 * order + 0.25) * np.pi
    out: Array = np.sqrt(2 / (np.pi * x)) * (p * np.cos(angle) - q * np.sin(angle))
    return out


@lru_cache(maxsize=64)  # a search for a motor creates thousands with the same coils
def _inductance_of_one_turn(ri: float, ro: float, l: float) -> float:
    """L/N² [H] of a winding of inner and outer radius and length [m]; see `Coil.inductance`."""
    edges = np.concatenate([np.linspace(0, 1500 / ro, 1501)])
    x, w = gauss_legendre(6)
    half = 0.5 * np.diff(edges)[:, None]
    k = (0.5 * (edges[1:] + edges[:-1])[:, None] + half * x).ravel()
    weight = (half * w).ravel()
    p = (integrate_bessel(k * ro) - integrate_bessel(k * ri)) / (k * k * (ro - ri))
    kl = k * l
    mean = np.where(kl < 1e-3, 0.5 - kl / 6 + kl**2 / 24, (kl + np.expm1(-kl)) / kl**2)
    return float(2 * np.pi * MU0 * np.sum(weight * p**2 * mean))


# --------------------------------------------------------------------------------------------------
# Field of a coil centred on a soft sphere, including the sphere's, outside both: zonal harmonics about the coil's axis.
#
# A loop at (ρ, z), s = √(ρ² + z²) from the centre, c = z/s, has on its axis the field Σ b_l x^(l−1) inside s, and Σ b_l
# s^(2l+1)/x^(l+2) outside, with b_l = μ0 N (1 − c²) P_l'(c)/(2 s^l) per ampere. The sphere of radius a responds to the
# first with Σ b_l β_l (l+1)/l a^(2l+1)/x^(l+2) (`soft_sphere`). Off the axis e, at x r̂ from the centre,
#
#     B = Σ k_l (P_(l+1)'(r̂·e) r̂ − P_l'(r̂·e) e)/x^(l+2),    (l+1) k_l = coefficient of 1/x^(l+2) on the axis
#
# Source: Smythe, Static and Dynamic Electricity, §7.13. A winding is a Gauss sum of loops; of one that is symmetric
# about the centre the even degrees vanish. Terms fall as (s/x)^l.


_NODES = 12  #: per direction, of the Gauss sums over the winding's section
_TRUNCATION = 1e-6  #: relative magnitude of the first neglected term
_MAX_DEGREE = 151  #: degrees


@final
class CentredCoil:
    """`coil` about the centre of `core`, its axis along z, for points at least `nearest` [m] from the centre.

    Raises GeometryError unless `nearest` is outside coil and core.

    >>> from haptorb.magnetics.dipole import Dipole
    >>> coil, core = Coil(100.0, 0.02, 0.021, 0.001), SoftSphere(0.015)
    >>> far = CentredCoil(coil, core, 1.0).field((0.6, 0.0, 0.8))
    >>> moment = coil.moment[2] + core.moment_in(coil.field((0.0, 0.0, 0.0)))[2]
    >>> bool(np.allclose(far, Dipole((0.0, 0.0, moment)).field((0.6, 0.0, 0.8)), rtol=1e-2))
    True
    """

    def __init__(self, coil: Coil, core: SoftSphere, nearest: float) -> None:
        reach = max(float(np.hypot(coil.outer_radius, coil.length / 2)), core.radius)
        if not nearest > reach:
            raise GeometryError(
                f"points {nearest * 1e3:g} mm from the centre are within coil or core: {reach * 1e3:g} mm"
            )
        order = int(min(_MAX_DEGREE, 3 + np.log(_TRUNCATION) / np.log(reach / nearest)))
        degrees = np.arange(1, order + 1, 2)
        radii, heights, turns = coil.filaments(_NODES, _NODES)
        far = np.hypot(radii, heights)
        c = heights / far
        slopes = _list_slopes(c, order)[degrees]
        loops = 0.5 * MU0 * turns * (1 - c * c) * slopes  # b_l s^l of each
        responses = core.response(order)[degrees - 1] * (degrees + 1) / degrees
        own = (loops * (far / reach) ** (degrees[:, None] + 1)).sum(axis=1)
        core_part = responses * (loops * (core.radius / far) ** degrees[:, None]).sum(axis=1)
        core_part *= (core.radius / reach) ** (degrees + 1)
        self._reach, self._order = reach, order
        self._strengths: Array = (own + core_part) / (degrees + 1)  # k_l/reach^(l+1) [T·m]

    def terms(self, reach: float, count: int) -> Array:
        """(count,) [T·m/A] strengths of the odd degrees for lengths in units of `reach` [m], padded with zeros."""
        degrees = 2 * np.arange(len(self._strengths)) + 1
        out = np.zeros(count)
        scaled = self._strengths * (self._reach / reach) ** (degrees + 1)
        out[: len(scaled)] = scaled[:count]
        return out

    def field(self, points: ArrayLike) -> Array:
        """(..., 3) [T/A] at `points` (..., 3) [m]."""
        at = vectors(points, "points")
        x = np.linalg.norm(at, axis=-1)
        unit = at / x[..., None]
        slopes = _list_slopes(unit[..., 2], self._order + 1)
        scale = self._reach / x
        out = np.zeros(at.shape)
        for degree, strength in zip(range(1, self._order + 1, 2), self._strengths.tolist(), strict=True):
            size = strength * scale ** (degree + 1) / x
            out += (size * slopes[degree + 1])[..., None] * unit
            out[..., 2] -= size * slopes[degree]
        return out


def coil_and_core(coil: Coil, core: SoftSphere, points: Array) -> Array:
    """(n, 3) [T/A] of `coil` about the centre of `core`, its axis along z, at `points` (n, 3) [m] outside the core.

    Unlike `CentredCoil` also near the winding and within it: only what the core adds is a series.

    >>> coil, core, at = Coil(100.0, 0.02, 0.021, 0.001), SoftSphere(0.015), np.array([[0.01, 0.02, 0.03]])
    >>> bool(np.allclose(coil_and_core(coil, core, at), CentredCoil(coil, core, 0.03).field(at), rtol=1e-6))
    True
    """
    x = np.linalg.norm(points, axis=1)
    radii, heights, turns = coil.filaments(_NODES, _NODES)
    far = np.hypot(radii, heights)
    ratio = core.radius**2 / (float(far.min()) * float(x.min()))
    order = int(min(_MAX_DEGREE, 3 + np.log(_TRUNCATION) / np.log(min(ratio, 0.99))))
    degrees = np.arange(1, order + 1, 2)
    c = heights / far
    loops = 0.5 * MU0 * turns * (1 - c * c) * _list_slopes(c, order)[degrees]
    responses = core.response(order)[degrees - 1] / degrees
    strengths = responses * (loops * (core.radius / far) ** degrees[:, None]).sum(axis=1)
    unit = points / x[:, None]
    slopes, share = _list_slopes(unit[:, 2], order + 1), core.radius / x
    out: Array = coil.field(points)
    for degree, strength in zip(degrees.tolist(), strengths.tolist(), strict=True):
        size = strength * share ** (degree + 1) / x
        out += (size * slopes[degree + 1])[:, None] * unit
        out[:, 2] -= size * slopes[degree]
    return out


_INTERIOR_RATIO = 0.75  #: largest distance from the centre for the interior series, relative to the inner radius
_INTERIOR_TRUNCATION = 1e-17  #: relative magnitude of the first neglected term, and of the Gauss sums' error


@final
class InteriorCoil(Source):
    """`coil` of which the field is needed around its centre: a series there, without compiled code.

    With b_l as above the field is Σ b_l/l x^(l−1) (P_l'(r̂·e) e − P_(l−1)'(r̂·e) r̂). Points farther from the centre than
    3/4 of the inner radius have the closed form of `coil`.

    >>> coil, at = Coil(100.0, 0.02, 0.025, 0.03), (0.003, -0.005, 0.01)
    >>> bool(np.allclose(InteriorCoil(coil).field(at), coil.field(at), rtol=1e-12, atol=0.0))
    True
    """

    def __init__(self, coil: Coil) -> None:
        self.coil = coil

    @property
    def moment(self) -> Array:
        """(3,) [A·m² per A]."""
        return self.coil.moment

    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """(...,) whether `points` (..., 3) [m] are inside the winding."""
        return self.coil.contains(points)

    def field_gradient(self, points: ArrayLike) -> Array:
        """(..., 3, 3) [T/m/A], [i, j] = ∂B_i/∂x_j, in closed form."""
        return self.coil.field_gradient(points)

    def field(self, points: ArrayLike) -> Array:
        """(..., 3) [T/A] at `points` (..., 3) [m]."""
        at, coil = vectors(points, "points"), self.coil
        x = np.linalg.norm(at, axis=-1)
        reach = float(x.max(initial=0.0))
        if reach > _INTERIOR_RATIO * coil.inner_radius:
            return coil.field(at)
        small, clear = np.log(_INTERIOR_TRUNCATION), coil.inner_radius - reach
        order = 2 + int(small / np.log(max(reach / coil.inner_radius, 1e-3)))
        # Gauss sums converge by the distance of the points from the section, relative to its extent.
        across = np.arccosh(1 + 2 * clear / (coil.outer_radius - coil.inner_radius))
        along = np.arcsinh(2 * clear / coil.length)
        radii, heights, turns = coil.filaments(*(int(np.ceil(-0.5 * small / rate)) for rate in (across, along)))
        far = np.hypot(radii, heights)
        c, degrees = heights / far, np.arange(1, order + 1, 2)
        loops = 0.5 * MU0 * turns * (1 - c * c) * _list_slopes(c, order)[degrees] / far
        strengths = (loops * (coil.inner_radius / far) ** (degrees[:, None] - 1)).sum(axis=1) / degrees
        unit = at / np.where(x > 0.0, x, 1.0)[..., None]
        slopes, ratio = _list_slopes(unit[..., 2], order), x / coil.inner_radius
        out = np.zeros(at.shape)
        for degree, strength in zip(degrees.tolist(), strengths.tolist(), strict=True):
            size = strength * ratio ** (degree - 1)
            out[..., 2] += size * slopes[degree]
            out -= (size * slopes[degree - 1])[..., None] * unit
        return out


def _list_slopes(c: Array, order: int) -> Array:
    """(order + 1, …) P_l'(c) of the Legendre polynomials up to degree `order`."""
    out = np.zeros((order + 1, *np.shape(c)))
    value, before = np.asarray(c), np.ones_like(c)
    out[1] = 1.0
    for degree in range(2, order + 1):  # P_l' = c P_(l−1)' + l P_(l−1)
        np.multiply(c, out[degree - 1], out=out[degree, ...])
        out[degree] += degree * value
        value, before = ((2 * degree - 1) * c * value - (degree - 1) * before) / degree, value
    return out


# --------------------------------------------------------------------------------------------------
# Table of a round winding's field for the servo: cubic splines near it, a short series of harmonics far from it.
#
# The table has the values that `Coil` computes in closed form: B_ρ/ρ and B_z per ampere and turn at uniform steps in ρ
# and z, with their parity in ρ and z built in, within `FAR_RADII` bounding radii. A uniform cubic B-spline through the
# values is smooth to the second derivative; for a field that varies over the distance d its error is about
# 0.06 (step/d)⁴. Beyond, the zonal series of `zonal` is truncated below that error. The tests check both against
# `Coil`; in the winding itself and nearer to it than four steps the table is coarse.


FAR_RADII = 2.5  #: range of the table in bounding radii
_CELLS = 96  #: steps from the centre to the end of the table's range, along ρ and along z
_MARGIN_STEPS = 8  #: additional steps beyond it, so that the spline's end conditions decay
_TABLE_PRECISION = 1e-7  #: relative precision of the values in the table
_1, _2, _3, _4, _5, _6, _7 = (np.uint64(k) for k in range(1, 8))
#: number of terms of the series beyond the table, and from 2.4 and 11 times as far
_NEAR_TERMS, _MIDDLE_TERMS, _FAR_TERMS = 7, 4, 2


@kernel
def table_field(table: Array, scale: float, far2: float, series: Array, rho: float, z: float) -> tuple[float, float]:
    """B_ρ/ρ [T/m] and B_z [T] per ampere and turn at `rho` and `z` [m], of one `WindingTable`.

    table (n, n, 2): splines over z and ρ, with one coefficient before zero; scale: steps per metre [1/m]; far2: square
    of the distance up to which the table is read [m²]; series (2, 7, 8) for further away.
    """
    r2 = rho * rho + z * z
    if r2 > far2:
        terms = _NEAR_TERMS
        if r2 > 125.0 * far2:
            terms = _FAR_TERMS
        elif r2 > 6.0 * far2:
            terms = _MIDDLE_TERMS
        inverse = 1.0 / r2
        share, q = far2 * inverse, z * z * inverse
        over, axial = 0.0, 0.0
        for back in range(terms):
            k = terms - 1 - back
            first, second = series[0, k, k], series[1, k, k + 1]
            for j in range(k, 0, -1):
                first = first * q + series[0, k, j - 1]
                second = second * q + series[1, k, j]
            over = over * share + first
            axial = axial * share + second * q + series[1, k, 0]
        cube = inverse * np.sqrt(inverse)
        over *= cube * inverse * z
        axial *= cube
        return over, axial
    cells = table.reshape(-1)
    u, w = rho * scale, abs(z) * scale
    i, j = int(u), int(w)
    u -= i
    w -= j
    a, b = 1.0 - u, 1.0 - w
    u0, u3 = a * a * a / 6.0, u * u * u / 6.0
    u1, u2 = 2.0 / 3.0 - 0.5 * u * u * (1.0 + a), 2.0 / 3.0 - 0.5 * a * a * (1.0 + u)
    w0, w3 = b * b * b / 6.0, w * w * w / 6.0
    w1, w2 = 2.0 / 3.0 - 0.5 * w * w * (1.0 + b), 2.0 / 3.0 - 0.5 * b * b * (1.0 + w)
    width = 2 * table.shape[0]
    over, axial = 0.0, 0.0
    at = np.uint64(j * width + 2 * i)  # unsigned: a possibly negative index costs a test at each access
    for k in range(4):
        share = w0
        if k == 1:
            share = w1
        elif k == 2:
            share = w2
        elif k == 3:
            share = w3
        over += share * (u0 * cells[at] + u1 * cells[at + _2] + u2 * cells[at + _4] + u3 * cells[at + _6])
        axial += share * (u0 * cells[at + _1] + u1 * cells[at + _3] + u2 * cells[at + _5] + u3 * cells[at + _7])
        at += np.uint64(width)
    return (over if z >= 0.0 else -over), axial


@dataclass(frozen=True)
class WindingTable:
    """Field per ampere of one turn of a winding of a given size; multiply by the number of turns."""

    table: Array  #: (n, n, 2) spline coefficients over z and ρ: of B_ρ/ρ [T/m] and B_z [T]
    scale: float  #: steps per metre [1/m]
    far2: float  #: square of the distance of its range [m²]
    series: Array  #: (2, 7, 8) beyond it, of B_ρ/ρ and B_z: by degree and by power of cos²θ

    def field(self, points: Array) -> Array:
        """(n, 3) flux density per ampere and turn [T/A] at `points` (n, 3) [m] about the winding's own axis z."""
        out = np.empty((len(points), 3))
        _fill(self.table, self.scale, self.far2, self.series, np.ascontiguousarray(points), out)
        return out


@kernel
def _fill(table: Array, scale: float, far2: float, series: Array, points: Array, out: Array) -> None:
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        over, axial = table_field(table, scale, far2, series, np.sqrt(x * x + y * y), z)
        out[n, 0], out[n, 1], out[n, 2] = over * x, over * y, axial


@lru_cache(maxsize=64)
def tabulate_winding(inner_radius: float, outer_radius: float, length: float) -> WindingTable:
    """Table of a winding of these sizes [m]: about half a second, cached for all windings of the same size.

    Raises InputError for sizes that make no winding.

    >>> thick = tabulate_winding(5e-3, 12e-3, 20e-3)
    >>> exact = Coil(1, 5e-3, 12e-3, 20e-3)
    >>> at = np.array([[8e-3, 0.0, 18e-3]])
    >>> bool(np.abs(thick.field(at) - exact.field(at)).max() < 1e-5 * np.abs(exact.field(at)).max())
    True
    """
    coil = Coil(1, inner_radius, outer_radius, length, precision=_TABLE_PRECISION)
    reach = FAR_RADII * coil.bounding_radius
    step, count = reach / _CELLS, _CELLS + _MARGIN_STEPS + 1
    even = step * np.arange(count)
    even[0] = 1e-6 * step  # B_ρ/ρ on the axis itself is the limit
    points = np.zeros((count, count, 3))
    points[..., 0], points[..., 2] = even[None, :], even[:, None]
    field = coil.field(points)
    over = field[..., 0] / even[None, :]
    over[0] = 0.0
    across = _spline_matrix(count, 1.0)
    splines = [
        _solve_both(over, _spline_matrix(count, -1.0), across),
        _solve_both(field[..., 2], across, across),
    ]
    # one coefficient before zero: the mirror image
    table = np.zeros((2, count + 1, count + 1))
    table[:, 1:, 1:] = splines
    table[:, 1:, 0] = table[:, 1:, 2]
    table[0, 0], table[1, 0] = -table[0, 2], table[1, 2]
    return WindingTable(
        np.ascontiguousarray(np.moveaxis(table, 0, 2)), 1.0 / step, reach * reach, _expand(coil.far_series, reach)
    )


def _expand(series: Array, reach: float) -> Array:
    """(2, 7, 8): B_ρ/ρ = z/r⁵ Σ_k s^k Σ_j [0, k, j] q^j and B_z = r⁻³ Σ_k s^k Σ_j [1, k, j] q^j with s = (reach/r)² and
    q = cos²θ, from the zonal `series` (16,): c_n P_{n+1}'/rⁿ⁺³ and c_n (n + 1) P_{n+1}/rⁿ⁺², n = 2k + 1."""
    out = np.zeros((2, _NEAR_TERMS, _NEAR_TERMS + 1))
    for k in range(_NEAR_TERMS):
        n = 2 * k + 1
        polynomial = np.polynomial.legendre.leg2poly(np.eye(n + 2)[n + 1])  # even: powers 0, 2 … n + 1
        slope = np.polynomial.polynomial.polyder(polynomial)  # odd: powers 1, 3 … n
        weight = series[k] / reach ** (2 * k)
        out[0, k, : k + 1] = weight * slope[1::2]
        out[1, k, : k + 2] = weight * (n + 1) * polynomial[::2]
    return out


def _spline_matrix(count: int, parity: float) -> Array:
    """Matrix from coefficients to values of a uniform cubic B-spline, even (parity 1) or odd (−1) at its first node."""
    matrix = (np.diag(np.full(count, 4.0)) + np.diag(np.ones(count - 1), 1) + np.diag(np.ones(count - 1), -1)) / 6.0
    matrix[0, 1] *= 1.0 + parity
    matrix[-1] = 0.0  # linear at the end
    matrix[-1, -1] = 1.0
    return matrix


def _solve_both(values: Array, along: Array, across: Array) -> Array:
    half = np.linalg.solve(along, values)
    return np.asarray(np.linalg.solve(across, half.T).T, dtype=np.float64)
