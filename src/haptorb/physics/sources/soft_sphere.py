"""How a soft-magnetic sphere answers magnets outside it: an exact series in spherical harmonics.

A charge q at s outside a sphere of radius a and relative permeability µ sees, at x outside, the extra potential

    φ(x) = −q/(4πa) Σ_l β_l t^(l+1) P_l(x̂·ŝ),   t = a²/(|x||s|),   β_l = l(µ−1)/(l(µ+1)+1)

(Smythe, Static and Dynamic Electricity, §5; Jackson, Classical Electrodynamics, §4.4, with the potential's continuity
and that of µ ∂φ/∂r at r = a). For µ → ∞ all β_l are 1 and the sum closes: the image −q a/|s| at a²/s and +q a/|s| at
the centre. Any magnet is a sum of charges, so energy, force and field follow by summing pairs; the addition theorem
has done the sum over orders. Zárate 2020 neglects this answer; it pulls the tool with 52.9 mN at 50 mm (erratum E18).
Left out: saturation, hysteresis, and eddy currents.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from haptorb.errors import GeometryError, InputError, PrecisionError
from haptorb.numerics.arrays import Array, check_finite, vectors
from haptorb.numerics.compiled import kernel
from haptorb.physics.sources.dipole import MU0

__all__ = ["SoftSphere", "add_induced_field"]

_K = MU0 / (4 * np.pi)
_LONGEST = 4000  #: more terms than this mean that a charge touches the sphere


@kernel
def add_induced_field(rows: Array, radius: float, response: Array, x: float, y: float, z: float, out: Array) -> None:
    """Add to out (3,) [T] the sphere's own field at (x, y, z) [m] while charges `rows` (4, n) stand around it.

    response (L,) holds β_1 … β_L. B = μ0 q/(4πa|x|) Σ_l β_l t^(l+1) [P_l' (ŝ − c x̂) − (l+1) P_l x̂], c = x̂·ŝ.
    """
    reach = 1.0 / np.sqrt(x * x + y * y + z * z)
    ux, uy, uz = x * reach, y * reach, z * reach
    along, bx, by, bz = 0.0, 0.0, 0.0, 0.0
    for n in range(rows.shape[1]):
        sx, sy, sz, q = rows[0, n], rows[1, n], rows[2, n], rows[3, n]
        inverse = 1.0 / np.sqrt(sx * sx + sy * sy + sz * sz)
        c = (ux * sx + uy * sy + uz * sz) * inverse
        t = radius * radius * reach * inverse
        power = t * t
        before, now, d_before, d_now = 1.0, c, 0.0, 1.0
        radial, turning = 0.0, 0.0
        for l in range(1, response.shape[0] + 1):
            weight = response[l - 1] * power
            radial += weight * (l + 1) * now
            turning += weight * d_now
            share = 1.0 / (l + 1)  # beside the chain of steps, not in it: a division takes as long as five of them
            after = (2 * l + 1) * share * c * now - l * share * before
            d_after = d_before + (2 * l + 1) * now
            before, now, d_before, d_now = now, after, d_now, d_after
            power *= t
        along += q * (radial + turning * c)
        bx += q * turning * sx * inverse
        by += q * turning * sy * inverse
        bz += q * turning * sz * inverse
    scale = _K / radius * reach
    out[0] += scale * (bx - along * ux)
    out[1] += scale * (by - along * uy)
    out[2] += scale * (bz - along * uz)


@kernel
def _fields(rows: Array, radius: float, response: Array, points: Array, out: Array) -> None:
    for n in range(points.shape[0]):
        add_induced_field(rows, radius, response, points[n, 0], points[n, 1], points[n, 2], out[n])


@kernel
def pair_sums(rows: Array, radius: float, out: Array) -> None:
    """out (L,): Σ_ij q_i q_j t_ij^(l+1) P_l(c_ij) for l = 1 … L. Pairs are symmetric: half of them are walked."""
    out[:] = 0.0
    count = rows.shape[1]
    for i in range(count):
        xi, yi, zi = rows[0, i], rows[1, i], rows[2, i]
        ri = 1.0 / np.sqrt(xi * xi + yi * yi + zi * zi)
        for j in range(i, count):
            xj, yj, zj = rows[0, j], rows[1, j], rows[2, j]
            rj = 1.0 / np.sqrt(xj * xj + yj * yj + zj * zj)
            c = (xi * xj + yi * yj + zi * zj) * ri * rj
            t = radius * radius * ri * rj
            weight = rows[3, i] * rows[3, j] * t * t * (1.0 if i == j else 2.0)
            before, now = 1.0, c
            for l in range(1, out.shape[0] + 1):
                out[l - 1] += weight * now
                before, now = now, ((2 * l + 1) * c * now - l * before) / (l + 1)
                weight *= t


@dataclass(frozen=True)
class SoftSphere:
    """A soft-magnetic sphere at the origin: `radius` [m] and relative `permeability` (infinity allowed).

    >>> SoftSphere(15e-3, np.inf).response(3)
    array([1., 1., 1.])
    """

    radius: float
    permeability: float = np.inf

    def __post_init__(self) -> None:
        check_finite(self.radius, "radius of the soft sphere")
        if self.radius <= 0.0:
            raise GeometryError(f"radius of the soft sphere must be positive; got {self.radius} m")
        if not self.permeability >= 0.0:
            raise InputError(f"relative permeability must be 0 or more, infinity allowed; got {self.permeability}")

    def response(self, order: int) -> Array:
        """(order,) β_l = l(µ−1)/(l(µ+1)+1) for l = 1 … order; no sphere: 0; µ → ∞: 1."""
        degree = np.arange(1, order + 1, dtype=np.float64)
        if np.isinf(self.permeability):
            return np.ones(order)
        mu = self.permeability
        share: Array = degree * (mu - 1.0) / (degree * (mu + 1.0) + 1.0)
        return share

    def order(self, nearest: float, other: float | None = None, precision: float = 1e-10) -> int:
        """How many terms leave out less than `precision` of the sum, for points at `nearest` and `other` [m].

        Raises GeometryError for a charge in the sphere, PrecisionError where the series would be too long.

        >>> SoftSphere(15e-3).order(0.038)
        14
        """
        t = self.radius**2 / (nearest * (nearest if other is None else other))
        if not t < 1.0:
            raise GeometryError(
                f"a charge {nearest * 1e3:.4g} mm from the centre lies in or on the sphere of radius "
                f"{self.radius * 1e3:.4g} mm; keep it outside"
            )
        terms = int(np.ceil(np.log(precision * (1 - t)) / np.log(t))) + 1
        if terms > _LONGEST:
            reached = t ** (_LONGEST + 1) / (1 - t)
            raise PrecisionError(
                f"a charge {(nearest - self.radius) * 1e3:.2g} mm above the sphere needs {terms} terms for "
                f"{precision:.1g}; {_LONGEST} would reach {reached:.1g}: move it further out or request less"
            )
        return max(terms, 2)

    def _rows(self, points: ArrayLike, charges: ArrayLike) -> tuple[Array, float]:
        at, q = vectors(points, "points").reshape(-1, 3), check_finite(charges, "charges").reshape(-1)
        if len(at) != len(q) or not len(q):
            raise InputError(f"one charge per point, and at least one; got {len(at)} points and {len(q)} charges")
        nearest = float(np.sqrt((at**2).sum(axis=1).min()))
        return np.ascontiguousarray(np.vstack([at.T, q])), nearest

    def energy(self, points: ArrayLike, charges: ArrayLike, *, precision: float = 1e-10) -> float:
        """Energy [J] of fixed `charges` (n,) [A·m] at `points` (n, 3) [m] in the sphere's answer to them.

        Half of Σ q μ0 φ: the sphere is magnetised by the charges themselves. Forces on the whole are minus its
        derivatives.
        """
        return float(self.energy_by_degree(points, charges, precision=precision).sum())

    def energy_by_degree(self, points: ArrayLike, charges: ArrayLike, *, precision: float = 1e-10) -> Array:
        """(L,) the terms l = 1 … L of `energy` [J]: how much of it the first harmonic alone would tell."""
        rows, nearest = self._rows(points, charges)
        order = self.order(nearest, precision=precision)
        sums = np.empty(order)
        pair_sums(rows, self.radius, sums)
        terms: Array = -_K / (2 * self.radius) * self.response(order) * sums
        return terms

    def forces(self, points: ArrayLike, charges: ArrayLike, *, precision: float = 1e-10) -> Array:
        """(n, 3) [N]: on every charge, from the sphere's answer to all of them."""
        q = check_finite(charges, "charges").reshape(-1, 1)
        force: Array = q * self.compute_induced_field(points, charges, points, precision=precision)
        return force

    def compute_induced_field(
        self, points: ArrayLike, charges: ArrayLike, at: ArrayLike, *, precision: float = 1e-10
    ) -> Array:
        """(..., 3) [T] the sphere's own part of the field at `at` (..., 3) [m] outside it.

        Raises GeometryError for a point inside the sphere.

        >>> far = SoftSphere(0.015).compute_induced_field([(0, 0, 0.05)], [1.0], (0, 0, 1.0))
        >>> bool(far[2] < 0)         # the near pole attracts the charge
        True
        """
        rows, nearest = self._rows(points, charges)
        where = vectors(at, "at")
        flat = np.ascontiguousarray(where.reshape(-1, 3))
        if not len(flat):
            return np.zeros(where.shape)
        order = self.order(nearest, float(np.sqrt((flat**2).sum(axis=1).min())), precision)
        if float((flat**2).sum(axis=1).min()) < self.radius**2:
            raise GeometryError("the series holds outside the sphere, but a point of `at` lies inside it; move it out")
        out = np.zeros_like(flat)
        _fields(rows, self.radius, self.response(order), flat, out)
        return out.reshape(where.shape)

    def moment_in(self, field: ArrayLike) -> Array:
        """(..., 3) [A·m²] the moment that any source induces whose own field at the sphere's centre is `field` [T].

        m = 4π/μ0 a³ β_1 B(0): the mean of a source-free field over a ball is its value at the centre, so this is exact
        for coils and magnets alike.

        >>> bool(abs(SoftSphere(0.1).moment_in((0, 0, 1e-3))[2] - 10.0) < 1e-9)
        True
        """
        moment: Array = self.response(1)[0] * self.radius**3 / _K * vectors(field, "field")
        return moment
