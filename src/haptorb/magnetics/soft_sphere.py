"""Response of a soft-magnetic sphere to magnets outside it: an exact series in spherical harmonics.

A charge q at s outside a sphere of radius a and relative permeability µ sees, at x outside, the extra potential

    φ(x) = −q/(4πa) Σ_l β_l t^(l+1) P_l(x̂·ŝ),   t = a²/(|x||s|),   β_l = l(µ−1)/(l(µ+1)+1)

(Smythe, Static and Dynamic Electricity, §5; Jackson, Classical Electrodynamics, §4.4, with the potential's continuity
and that of µ ∂φ/∂r at r = a). For µ → ∞ all β_l are 1 and the sum closes: the image −q a/|s| at a²/s and +q a/|s| at
the centre. Any magnet is a sum of charges, so energy, force and field follow by summing pairs; the addition theorem
has done the sum over orders. Zárate 2020 neglects this response; it pulls the tool with 52.9 mN at 50 mm (erratum E18).
Left out: saturation, hysteresis, and eddy currents.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, check_finite, gauss_legendre, vectors
from haptorb.compiled import kernel
from haptorb.errors import GeometryError, InputError, PrecisionError
from haptorb.magnetics.dipole import MU0_OVER_4PI
from haptorb.magnetics.source import Source

__all__ = [
    "SoftSphere",
    "add_induced_field",
    "add_response_wrench",
    "harmonic_sums",
    "response_to_charges",
    "response_to_source",
    "weigh_charges",
]


_MAX_TERMS = 4000  #: limit on the terms: more mean that a charge touches the sphere


@kernel
def add_induced_field(rows: Array, radius: float, response: Array, x: float, y: float, z: float, out: Array) -> None:
    """Add to out (3,) [T] the sphere's own field at (x, y, z) [m] in the presence of charges `rows` (4, n).

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
            share = 1.0 / (l + 1)  # outside the dependency chain: a division takes as long as five of its steps
            after = (2 * l + 1) * share * c * now - l * share * before
            d_after = d_before + (2 * l + 1) * now
            before, now, d_before, d_now = now, after, d_now, d_after
            power *= t
        along += q * (radial + turning * c)
        bx += q * turning * sx * inverse
        by += q * turning * sy * inverse
        bz += q * turning * sz * inverse
    scale = MU0_OVER_4PI / radius * reach
    out[0] += scale * (bx - along * ux)
    out[1] += scale * (by - along * uy)
    out[2] += scale * (bz - along * uz)


@kernel
def _fields(rows: Array, radius: float, response: Array, points: Array, out: Array) -> None:
    for n in range(points.shape[0]):
        add_induced_field(rows, radius, response, points[n, 0], points[n, 1], points[n, 2], out[n])


@kernel
def pair_sums(rows: Array, radius: float, out: Array) -> None:
    """out (L,): Σ_ij q_i q_j t_ij^(l+1) P_l(c_ij) for l = 1 … L. Pairs are symmetric: only half of them are
    computed."""
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
    """Soft-magnetic sphere at the origin: a linear core without hysteresis.

    Parameters
    ----------
    radius : float
        Radius [m].
    permeability : float
        Relative permeability [1]; infinity is allowed.

    Examples
    --------
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
        """Number of terms for a truncation error below `precision`, for points at `nearest` and `other` [m].

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
        if terms > _MAX_TERMS:
            reached = t ** (_MAX_TERMS + 1) / (1 - t)
            raise PrecisionError(
                f"a charge {(nearest - self.radius) * 1e3:.2g} mm above the sphere needs {terms} terms for "
                f"{precision:.1g}; {_MAX_TERMS} would reach {reached:.1g}: move it further out or request less"
            )
        return max(terms, 2)

    def _rows(self, points: ArrayLike, charges: ArrayLike) -> tuple[Array, float]:
        at, q = vectors(points, "points").reshape(-1, 3), check_finite(charges, "charges").reshape(-1)
        if len(at) != len(q) or not len(q):
            raise InputError(f"one charge per point, and at least one; got {len(at)} points and {len(q)} charges")
        nearest = float(np.sqrt((at**2).sum(axis=1).min()))
        return np.ascontiguousarray(np.vstack([at.T, q])), nearest

    def energy(self, points: ArrayLike, charges: ArrayLike, *, precision: float = 1e-10) -> float:
        """Energy [J] of fixed `charges` (n,) [A·m] at `points` (n, 3) [m] in the sphere's response to them.

        Half of Σ q μ0 φ: the sphere is magnetised by the charges themselves. Forces on the whole are minus its
        derivatives.
        """
        return float(self.energy_by_degree(points, charges, precision=precision).sum())

    def energy_by_degree(self, points: ArrayLike, charges: ArrayLike, *, precision: float = 1e-10) -> Array:
        """(L,) terms l = 1 … L of `energy` [J]: contribution of each harmonic."""
        rows, nearest = self._rows(points, charges)
        order = self.order(nearest, precision=precision)
        sums = np.empty(order)
        pair_sums(rows, self.radius, sums)
        terms: Array = -MU0_OVER_4PI / (2 * self.radius) * self.response(order) * sums
        return terms

    def forces(self, points: ArrayLike, charges: ArrayLike, *, precision: float = 1e-10) -> Array:
        """(n, 3) [N]: on every charge, from the sphere's response to all of them."""
        q = check_finite(charges, "charges").reshape(-1, 1)
        force: Array = q * self.compute_induced_field(points, charges, points, precision=precision)
        return force

    def compute_induced_field(
        self, points: ArrayLike, charges: ArrayLike, at: ArrayLike, *, precision: float = 1e-10
    ) -> Array:
        """(..., 3) [T] sphere's own part of the field at `at` (..., 3) [m] outside it.

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
        """(..., 3) [A·m²] moment induced by any source whose own field at the sphere's centre is `field` [T].

        m = 4π/μ0 a³ β_1 B(0): the mean of a source-free field over a ball is its value at the centre, so this is exact
        for coils and magnets alike.

        >>> bool(abs(SoftSphere(0.1).moment_in((0, 0, 1e-3))[2] - 10.0) < 1e-9)
        True
        """
        moment: Array = self.response(1)[0] * self.radius**3 / MU0_OVER_4PI * vectors(field, "field")
        return moment


# --------------------------------------------------------------------------------------------------
# Response of a soft sphere to coils and magnets, in solid harmonics about its centre: for the servo, in one pass.
#
# `soft_sphere` sums over pairs of charges. Here the response to each source is a fixed set of coefficients C of
# irregular solid harmonics, φ = Re Σ C*_lm I_lm(x/a), and the wrench on a set of charges follows from its own sums S_lm
# = Σ q I_lm(x/a): a derivative of I_lm is an I of the next degree, and a rotation preserves the degree. So the cost
# grows with charges plus coils and not with their product, and the sphere's attraction of the charges themselves is
# included.
#
#     I_lm = (l−m)! P_lm(cosθ) e^{imφ}/r^{l+1}        R_lm = r^l P_lm(cosθ) e^{imφ}/(l+m)!
#     1/|x − s| = Σ R*_lm(x) I_lm(s), |x| < |s|;      R_lm → −β_l I_lm/((l−m)!(l+m)!) outside a sphere of radius 1
#
# with β_l as in `soft_sphere`. Source: Jackson, Classical Electrodynamics, sections 3.5 and 4.4, in the normalisation
# of White and Head-Gordon (J. Chem. Phys. 101, 6593, 1994). Terms fall as (a²/(r_source r_charge))^l.


_SAMPLING_RADIUS = 0.6  #: radius at which a source is sampled, relative to the sphere's: the field is smoother there


@kernel
def harmonic_sums(placed: Array, radius: float, order: int, sums: Array) -> None:
    """sums (k, 2), real and imaginary: Σ q I_lm(x/a) [A·m] to degree `order` + 1, number l (l + 1)/2 + m.

    placed (≥ 3, n): places [m] about the sphere's centre, the charges [A·m] in the last row.
    """
    last, top = placed.shape[0] - 1, order + 1
    sums[:] = 0.0
    value = np.empty_like(sums)
    for n in range(placed.shape[1]):
        x, y, z = placed[0, n] / radius, placed[1, n] / radius, placed[2, n] / radius
        inverse = 1.0 / (x * x + y * y + z * z)
        value[0, 0], value[0, 1] = placed[last, n] * np.sqrt(inverse), 0.0
        cx, cy, cz = x * inverse, y * inverse, z * inverse
        for l in range(1, top + 1):
            here, before, earlier = l * (l + 1) // 2, (l - 1) * l // 2, (l - 2) * (l - 1) // 2
            for m in range(l):
                for part in range(2):
                    v = (2 * l - 1) * cz * value[before + m, part]
                    if m < l - 1:
                        v -= ((l - 1) * (l - 1) - m * m) * inverse * value[earlier + m, part]
                    value[here + m, part] = v
            a, b = value[before + l - 1, 0], value[before + l - 1, 1]
            value[here + l, 0] = -(2 * l - 1) * (cx * a - cy * b)
            value[here + l, 1] = -(2 * l - 1) * (cx * b + cy * a)
        for k in range(sums.shape[0]):
            sums[k, 0] += value[k, 0]
            sums[k, 1] += value[k, 1]


@kernel
def _read(sums: Array, l: int, m: int) -> tuple[float, float]:
    """S_lm for any m from −l to l; 0 beyond."""
    if m > l or m < -l:
        return 0.0, 0.0
    if m >= 0:
        k = l * (l + 1) // 2 + m
        return sums[k, 0], sums[k, 1]
    k = l * (l + 1) // 2 - m
    sign = 1.0 if m % 2 == 0 else -1.0
    return sign * sums[k, 0], -sign * sums[k, 1]


@kernel
def add_response_wrench(sums: Array, responses: Array, radius: float, order: int, p: Array, out: Array) -> None:
    """Add to out (6, m) the force and the torque about p (3,) [m] on the charges of `sums` in the sphere's responses.

    responses (m, k, 2): coefficients C [T·m] per ampere of every coil, or [T·m] of anything else.
    """
    part = np.empty((6, 2))
    for l in range(1, order + 1):
        for m in range(l + 1):
            # ∂z I_lm = −I_{l+1,m};  (∂x + i∂y) I_lm = I_{l+1,m+1};  (∂x − i∂y) I_lm = −I_{l+1,m−1}
            ur, ui = _read(sums, l + 1, m + 1)
            dr, di = _read(sums, l + 1, m - 1)
            zr, zi = _read(sums, l + 1, m)
            part[0, 0], part[0, 1] = 0.5 * (ur - dr), 0.5 * (ui - di)
            part[1, 0], part[1, 1] = 0.5 * (ui + di), -0.5 * (ur + dr)
            part[2, 0], part[2, 1] = -zr, -zi
            # x × ∇ = iL;  L± I_lm = (l ∓ m) I_{l,m±1};  L_z I_lm = m I_lm
            ur, ui = _read(sums, l, m + 1)
            dr, di = _read(sums, l, m - 1)
            zr, zi = _read(sums, l, m)
            ur, ui, dr, di = (l - m) * ur, (l - m) * ui, (l + m) * dr, (l + m) * di
            part[3, 0], part[3, 1] = -0.5 * (ui + di), 0.5 * (ur + dr)
            part[4, 0], part[4, 1] = 0.5 * (ur - dr), 0.5 * (ui - di)
            part[5, 0], part[5, 1] = -m * zi, m * zr
            k = l * (l + 1) // 2 + m
            for i in range(6):
                scale = -1.0 / radius if i < 3 else -1.0
                real, imaginary = scale * part[i, 0], scale * part[i, 1]
                if i >= 3:  # from the sphere's centre to p: T − p × F
                    a, b = (i - 2) % 3, (i - 1) % 3
                    real += (p[a] * part[b, 0] - p[b] * part[a, 0]) / radius
                    imaginary += (p[a] * part[b, 1] - p[b] * part[a, 1]) / radius
                for j in range(responses.shape[0]):
                    out[i, j] += real * responses[j, k, 0] + imaginary * responses[j, k, 1]


@kernel
def response_to_charges(sums: Array, shares: Array, out: Array) -> None:
    """out (1, k, 2): the sphere's response [T·m] to the charges of `sums` themselves; shares (k,) of
    `weigh_charges`."""
    for k in range(shares.shape[0]):
        out[0, k, 0] = shares[k] * sums[k, 0]
        out[0, k, 1] = shares[k] * sums[k, 1]


def weigh_charges(sphere: SoftSphere, order: int) -> Array:
    """(k,) [T·m/(A·m)] factors by which `response_to_charges` multiplies the sums, to degree `order`.

    >>> weigh_charges(SoftSphere(0.1), 1).shape
    (3,)
    """
    response = sphere.response(order)
    weights = [0.0]
    for l in range(1, order + 1):
        for m in range(l + 1):
            both = 1.0 if m == 0 else 2.0
            weights.append(
                -MU0_OVER_4PI * both * response[l - 1] / (sphere.radius * factorial(l - m) * factorial(l + m))
            )
    return np.array(weights)


def response_to_source(sphere: SoftSphere, source: Source, order: int) -> Array:
    """(k, 2) coefficients C [T·m] of the sphere's response to `source` anywhere about it (coils: per ampere).

    From the source's radial field on a sphere of radius b < a, so that sources close to the sphere do no harm:
    C_lm = β_l (2 − δ_m0)(2l + 1) a (a/b)^(l−1)/(4π l) ∫ B_r R_lm dΩ. The source's
    matter must not reach into the sphere: GeometryError.

    >>> from haptorb.magnetics.dipole import Dipole
    >>> from haptorb.magnetics.source import PlacedSource
    >>> far = PlacedSource(Dipole((0, 0, 1.0)), (0, 0, 0.5), np.eye(3))
    >>> response = response_to_source(SoftSphere(0.02), far, 3)
    >>> moment = SoftSphere(0.02).moment_in(far.field((0, 0, 0)))[2]     # the response's first term is that dipole's
    >>> bool(abs(response[1, 0] - 1e-7 * moment / 0.02**2) < 1e-9 * response[1, 0])
    True
    """
    cosine, weight = gauss_legendre(2 * order + 8)
    steps = 4 * order + 16
    angle = 2 * np.pi * (np.arange(steps) + 0.5) / steps
    sine = np.sqrt(1 - cosine**2)[:, None]
    level = np.repeat(cosine[:, None], steps, axis=1)
    unit = np.stack([sine * np.cos(angle), sine * np.sin(angle), level], axis=-1)
    if source.contains(sphere.radius * unit).any():
        raise GeometryError("a source reaches into the soft sphere, where no field is defined; move it out")
    radial = (source.field(_SAMPLING_RADIUS * sphere.radius * unit) * unit).sum(axis=-1)
    flux = radial * weight[:, None] * (2 * np.pi / steps)
    response = sphere.response(order)
    out = np.zeros(((order + 1) * (order + 2) // 2, 2))
    for (l, m), harmonic in _regular(unit, order).items():
        if l:
            both = (1.0 if m == 0 else 2.0) * _SAMPLING_RADIUS ** (1 - l)
            c = response[l - 1] * both * (2 * l + 1) * sphere.radius / (4 * np.pi * l) * (flux * harmonic).sum()
            out[l * (l + 1) // 2 + m] = c.real, c.imag
    return out


def _regular(unit: Array, order: int) -> dict[tuple[int, int], Array]:
    """R_lm at unit vectors (..., 3)."""
    x, y, z = np.moveaxis(unit, -1, 0)
    across = x + 1j * y
    found = {(0, 0): np.ones_like(across)}
    for l in range(1, order + 1):
        found[l, l] = -across / (2 * l) * found[l - 1, l - 1]
        for m in range(l):
            value = (2 * l - 1) * z * found[l - 1, m]
            if m < l - 1:
                value = value - found[l - 2, m]
            found[l, m] = value / ((l + m) * (l - m))
    return found
