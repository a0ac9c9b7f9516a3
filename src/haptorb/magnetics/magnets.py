"""Round magnets: cylinder, ring, and the ring as magnetic charge on its end faces."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from haptorb.arrays import Array, check_finite, gauss_legendre, rotation, vectors
from haptorb.compiled import kernel
from haptorb.errors import GeometryError, InputError
from haptorb.magnetics import source
from haptorb.magnetics.dipole import MU0, MU0_OVER_4PI
from haptorb.magnetics.source import RoundBody, SheetStack, Source

__all__ = ["ChargedRing", "CylinderMagnet", "RingMagnet", "charge_field", "dipole_on_charges"]


# --------------------------------------------------------------------------------------------------
# Solid round magnet, magnetised uniformly along its axis: exact field inside and outside.


@final
class CylinderMagnet(RoundBody):
    """Solid round magnet, magnetised uniformly along its axis: exact field inside and outside.

    Parameters
    ----------
    radius : float
        Radius [m].
    length : float
        Length along the axis [m].
    polarization : float
        Polarisation J = μ0 M along +z [T]; negative: along −z.

    Raises
    ------
    InputError
        If radius or length is not a positive number.

    Notes
    -----
    Flux density by Callaghan & Maslen 1960 and Derby & Olbert 2010, relative error below 1e-12 of the local field
    except within a few rounding steps of the edges, where it grows without limit as ln(distance). B is defined inside
    too (in a thin slot across the axis); H = (B − J)/μ0 there, and a force on a part of the magnet itself, are not
    given. On the side wall B_z jumps by J, and the mean is returned. Left out: the magnet's own permeability (recoil
    about 1.05) and demagnetisation.

    Examples
    --------
    >>> magnet = CylinderMagnet(radius=0.01, length=0.02, polarization=1.0)
    >>> float(magnet.field((0, 0, 0))[2].round(12))     # J h/√(h² + a²)
    0.707106781187
    """

    inner_radius = 0.0

    def __init__(self, radius: float, length: float, polarization: float) -> None:
        self.outer_radius = source.length(radius, "radius")
        self.length = source.length(length, "length")
        self.polarization = float(check_finite(polarization, "polarization"))
        self._sheets = SheetStack([self.outer_radius], 0.5 * self.length, [self.polarization])

    def __repr__(self) -> str:
        return f"CylinderMagnet(radius={self.radius}, length={self.length}, polarization={self.polarization})"

    @property
    def radius(self) -> float:
        """[m]."""
        return self.outer_radius

    @property
    def moment(self) -> Array:
        """(3,) [A·m²]: M times the volume."""
        return np.array([0.0, 0.0, self.polarization / MU0 * np.pi * self.radius**2 * self.length])

    def field(self, points: ArrayLike) -> Array:
        """Flux density (..., 3) [T] at `points` (..., 3) [m]; GeometryError on an edge."""
        return self._sheets.field(points)

    def field_gradient(self, points: ArrayLike) -> Array:
        """(..., 3, 3) [T/m], [i, j] = ∂B_i/∂x_j; not defined on the side wall."""
        return self._sheets.field_gradient(points)

    def filaments(self, across: int, along: int) -> tuple[Array, Array, Array]:
        """Replace the bound current M on the side wall by loops.

        Parameters
        ----------
        across : int
            Without effect: the sheet has no thickness.
        along : int
            Loops along the axis.

        Returns
        -------
        radii : ndarray, shape (n,)
            Radius of each loop [m].
        heights : ndarray, shape (n,)
            Height on the axis [m].
        currents : ndarray, shape (n,)
            Current of each [A].
        """
        nodes, weights = gauss_legendre(along)
        currents = self.polarization / MU0 * 0.5 * self.length * weights
        return np.full(along, self.radius), 0.5 * self.length * nodes, currents


# --------------------------------------------------------------------------------------------------
# Ring magnet (a cylinder with a round hole), magnetised uniformly along its axis: exact field everywhere.


@final
class RingMagnet(RoundBody):
    """Ring magnet, magnetised uniformly along its axis: exact field inside and outside.

    Parameters
    ----------
    outer_radius : float
        Outer radius [m].
    inner_radius : float
        Radius of the hole [m].
    length : float
        Length along the axis [m].
    polarization : float
        Polarisation J = μ0 M along +z [T]; negative: along −z.

    Raises
    ------
    InputError
        If the radii or the length make no ring.

    Notes
    -----
    The difference of two cylinders in closed form, see `CylinderMagnet`. B is defined in the material, in the hole and
    outside; on the two side walls B_z jumps by J, and the mean is returned. Left out: the magnet's permeability.

    Examples
    --------
    >>> ring = RingMagnet(outer_radius=0.006, inner_radius=0.0025, length=0.024, polarization=1.348)
    >>> round(float(ring.moment[2]), 3)
    2.406
    """

    def __init__(self, outer_radius: float, inner_radius: float, length: float, polarization: float) -> None:
        self.outer_radius = source.length(outer_radius, "outer_radius")
        self.inner_radius = source.length(inner_radius, "inner_radius")
        if self.inner_radius >= self.outer_radius:
            raise InputError(
                f"inner_radius must be below outer_radius; got {self.inner_radius} m and {self.outer_radius} m"
            )
        self.length = source.length(length, "length")
        self.polarization = float(check_finite(polarization, "polarization"))
        walls = [self.outer_radius, self.inner_radius]
        self._sheets = SheetStack(walls, 0.5 * self.length, [self.polarization, -self.polarization])

    def __repr__(self) -> str:
        return (
            f"RingMagnet(outer_radius={self.outer_radius}, inner_radius={self.inner_radius}, "
            f"length={self.length}, polarization={self.polarization})"
        )

    @property
    def moment(self) -> Array:
        """(3,) [A·m²]: M times the volume."""
        area = np.pi * (self.outer_radius**2 - self.inner_radius**2)
        return np.array([0.0, 0.0, self.polarization / MU0 * area * self.length])

    def field(self, points: ArrayLike) -> Array:
        """Flux density (..., 3) [T] at `points` (..., 3) [m]; GeometryError on an edge."""
        return self._sheets.field(points)

    def field_gradient(self, points: ArrayLike) -> Array:
        """(..., 3, 3) [T/m], [i, j] = ∂B_i/∂x_j; not defined on the side walls."""
        return self._sheets.field_gradient(points)

    def filaments(self, across: int, along: int) -> tuple[Array, Array, Array]:
        """Replace the bound currents ±M on both side walls by loops.

        Parameters
        ----------
        across : int
            Without effect: the sheets have no thickness.
        along : int
            Loops along the axis, on each side wall.

        Returns
        -------
        radii : ndarray, shape (n,)
            Radius of each loop [m].
        heights : ndarray, shape (n,)
            Height on the axis [m].
        currents : ndarray, shape (n,)
            Current of each [A].
        """
        nodes, weights = gauss_legendre(along)
        currents = self.polarization / MU0 * 0.5 * self.length * weights
        radii = np.repeat([self.outer_radius, self.inner_radius], along)
        return radii, np.tile(0.5 * self.length * nodes, 2), np.concatenate([currents, -currents])


# --------------------------------------------------------------------------------------------------
# Magnetised ring as magnetic charge on its two end faces, and the wrench of a point dipole on it.
#
# Uniform axial magnetisation M = Br/μ0 has no charge inside and ±M per area on the faces. The force on it in a field B
# is therefore the sum of q B over the faces, exactly, wherever B is free of curl and divergence. The faces are annuli:
# Gauss nodes in ρ² and uniform steps in azimuth integrate every harmonic function on them to a known degree, and 32
# points give the ring of Zárate 2020 (12/5 × 24 mm) at 50 mm to 7e-7 in any pose. The published dipole model neglects
# this finite size: 15.6 % at 50 mm (erratum E16).


@kernel
def charge_field(rows: Array, x: float, y: float, z: float, out: Array) -> None:
    """Add to out (3,) [T] the field at (x, y, z) [m] of point charges: rows (4, n), x y z [m] and q [A·m]."""
    bx, by, bz = 0.0, 0.0, 0.0
    for n in range(rows.shape[1]):
        ax, ay, az = x - rows[0, n], y - rows[1, n], z - rows[2, n]
        inverse = 1.0 / (ax * ax + ay * ay + az * az)
        c = rows[3, n] * inverse * np.sqrt(inverse)
        bx += c * ax
        by += c * ay
        bz += c * az
    out[0] += MU0_OVER_4PI * bx
    out[1] += MU0_OVER_4PI * by
    out[2] += MU0_OVER_4PI * bz


@kernel
def dipole_on_charges(rows: Array, R: Array, p: Array, out: Array) -> None:
    """out (6, 3): force [N] and torque about p [N·m] per moment [A·m²] of a point dipole at the origin.

    rows (4, n) are the charges in the mover's frame, at R ρ + p in the dipole's. F = Σ q G m, T = Σ (R ρ) × q G m,
    with G = μ0/4π (3 r̂ r̂ᵀ − 1)/r³, which is symmetric and free of trace: five sums for F, nine for T.
    """
    fxx, fxy, fxz, fyy, fyz = 0.0, 0.0, 0.0, 0.0, 0.0
    txx, txy, txz, tyx, tyy, tyz, tzx, tzy, tzz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    rxx, rxy, rxz = R[0, 0], R[0, 1], R[0, 2]
    ryx, ryy, ryz = R[1, 0], R[1, 1], R[1, 2]
    rzx, rzy, rzz = R[2, 0], R[2, 1], R[2, 2]
    px, py, pz = p[0], p[1], p[2]
    for n in range(rows.shape[1]):
        a, b, c = rows[0, n], rows[1, n], rows[2, n]
        ax = rxx * a + rxy * b + rxz * c
        ay = ryx * a + ryy * b + ryz * c
        az = rzx * a + rzy * b + rzz * c
        x, y, z = px + ax, py + ay, pz + az
        inverse = 1.0 / (x * x + y * y + z * z)
        s = rows[3, n] * inverse * np.sqrt(inverse)
        x3, y3, z3 = 3.0 * s * inverse * x, 3.0 * s * inverse * y, 3.0 * s * inverse * z
        gxx, gxy, gxz = x3 * x - s, x3 * y, x3 * z
        gyy, gyz, gzz = y3 * y - s, y3 * z, z3 * z - s
        fxx += gxx
        fxy += gxy
        fxz += gxz
        fyy += gyy
        fyz += gyz
        txx += ay * gxz - az * gxy
        txy += ay * gyz - az * gyy
        txz += ay * gzz - az * gyz
        tyx += az * gxx - ax * gxz
        tyy += az * gxy - ax * gyz
        tyz += az * gxz - ax * gzz
        tzx += ax * gxy - ay * gxx
        tzy += ax * gyy - ay * gxy
        tzz += ax * gyz - ay * gxz
    out[0, 0], out[0, 1], out[0, 2] = MU0_OVER_4PI * fxx, MU0_OVER_4PI * fxy, MU0_OVER_4PI * fxz
    out[1, 0], out[1, 1], out[1, 2] = MU0_OVER_4PI * fxy, MU0_OVER_4PI * fyy, MU0_OVER_4PI * fyz
    out[2, 0], out[2, 1], out[2, 2] = MU0_OVER_4PI * fxz, MU0_OVER_4PI * fyz, -MU0_OVER_4PI * (fxx + fyy)
    out[3, 0], out[3, 1], out[3, 2] = MU0_OVER_4PI * txx, MU0_OVER_4PI * txy, MU0_OVER_4PI * txz
    out[4, 0], out[4, 1], out[4, 2] = MU0_OVER_4PI * tyx, MU0_OVER_4PI * tyy, MU0_OVER_4PI * tyz
    out[5, 0], out[5, 1], out[5, 2] = MU0_OVER_4PI * tzx, MU0_OVER_4PI * tzy, MU0_OVER_4PI * tzz


@kernel
def _fields(rows: Array, points: Array, out: Array) -> None:
    for n in range(points.shape[0]):
        charge_field(rows, points[n, 0], points[n, 1], points[n, 2], out[n])


class ChargedRing(Source):
    """Ring magnet (inner_radius = 0: cylinder) in its own frame, polarised along +z, as charges on its faces.

    outer_radius, inner_radius, length [m]; remanence [T], negative for the other polarity; `radial` Gauss nodes in ρ²
    and `azimuth` steps on each face. The moment is exact for any number of points; the field nearer to a face than its
    own radius wants more of them than the default.

    Raises GeometryError for radii or a length that make no ring, InputError for too few nodes.

    >>> ring = ChargedRing(6e-3, 2.5e-3, 24e-3, 1.348)
    >>> round(float(ring.moment[2]), 2)      # 48 mN/A at 50 mm needs 2.41 A·m²
    2.41
    >>> ring.points.shape
    (32, 3)
    """

    def __init__(
        self,
        outer_radius: float,
        inner_radius: float,
        length: float,
        remanence: float,
        *,
        radial: int = 2,
        azimuth: int = 8,
    ) -> None:
        for value, what in ((outer_radius, "outer_radius"), (inner_radius, "inner_radius"), (length, "length")):
            check_finite(value, what)
        check_finite(remanence, "remanence")
        if not (outer_radius > inner_radius >= 0.0) or length <= 0.0:
            raise GeometryError(
                "a ring needs outer_radius > inner_radius ≥ 0 and length > 0; got "
                f"{outer_radius} m, {inner_radius} m, {length} m"
            )
        if radial < 1 or azimuth < 3:
            raise InputError(f"a face needs at least 1 radial node and 3 azimuth steps; got {radial} and {azimuth}")
        self.outer_radius, self.inner_radius, self.length = float(outer_radius), float(inner_radius), float(length)
        self.remanence = float(remanence)
        node, weight = gauss_legendre(radial)
        inner, outer = self.inner_radius**2, self.outer_radius**2
        rho = np.sqrt(inner + (outer - inner) * (node + 1) / 2)
        face = np.pi * (outer - inner)
        angle = 2 * np.pi * (np.arange(azimuth) + 0.5) / azimuth
        x, y = np.outer(rho, np.cos(angle)).ravel(), np.outer(rho, np.sin(angle)).ravel()
        q = np.repeat(weight / 2, azimuth) * face * self.remanence / MU0 / azimuth
        z = np.full(len(x), self.length / 2)
        self.rows: Array = np.ascontiguousarray(
            np.hstack([np.array([x, y, z, q]), np.array([x, y, -z, -q])])
        )  #: (4, n) x, y, z [m] and charge [A·m]: memory layout of the kernels

    @property
    def points(self) -> Array:
        """(n, 3) positions of the charges [m]."""
        return np.ascontiguousarray(self.rows[:3].T)

    @property
    def charges(self) -> Array:
        """(n,) [A·m]; they add up to zero."""
        charges: Array = self.rows[3].copy()
        return charges

    @property
    def moment(self) -> Array:
        """(3,) [A·m²]: Br/μ0 times the volume."""
        return np.array([0.0, 0.0, float(self.rows[3] @ self.rows[2])])

    @property
    def bounding_radius(self) -> float:
        """Radius of the smallest enclosing sphere about the centre [m]."""
        return float(np.hypot(self.outer_radius, self.length / 2))

    def field(self, points: ArrayLike) -> Array:
        """Flux density (..., 3) [T] outside the magnet at `points` (..., 3) [m]."""
        at = vectors(points, "points")
        flat = np.ascontiguousarray(at.reshape(-1, 3))
        out = np.zeros_like(flat)
        _fields(self.rows, flat, out)
        return out.reshape(at.shape)

    def field_gradient(self, points: ArrayLike) -> Array:
        """(..., 3, 3) [T/m], [i, j] = ∂B_i/∂x_j, outside the magnet at `points` (..., 3) [m]."""
        at = vectors(points, "points")
        arm = at[..., None, :] - self.points
        square = (arm**2).sum(axis=-1)
        spread = np.einsum("...n,...ni,...nj->...ij", self.rows[3] / square**2.5, arm, arm)
        gradient: Array = MU0_OVER_4PI * (
            (self.rows[3] / square**1.5).sum(axis=-1)[..., None, None] * np.eye(3) - 3 * spread
        )
        return gradient

    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """(...,) whether `points` (..., 3) [m] are in the magnet, where the faces' charges alone do not give its
        field."""
        at = vectors(points, "points")
        rho = np.hypot(at[..., 0], at[..., 1])
        held: NDArray[np.bool_] = (
            (rho <= self.outer_radius) & (rho >= self.inner_radius) & (np.abs(at[..., 2]) <= self.length / 2)
        )
        return held

    def place(self, R_SR: ArrayLike, p: ArrayLike) -> tuple[Array, Array]:
        """Points (n, 3) [m] and charges (n,) [A·m] of the ring rotated by `R_SR` (3, 3) with its centre at `p` (3,)."""
        return self.points @ rotation(R_SR, "R_SR").T + vectors(p, "p"), self.charges

    def wrench_map(self, R_SR: ArrayLike, p: ArrayLike) -> Array:
        """(6, 3) force [N] and torque about the ring's centre [N·m] per A·m² of a point dipole at the origin.

        Valid while no part of the ring reaches the dipole. The core's own magnetisation by the ring is not in it.

        >>> ring = ChargedRing(6e-3, 2.5e-3, 24e-3, 1.348)
        >>> point = 6e-7 * 2.407 / 0.05**4                       # the dipole's force on axis, per A·m²
        >>> bool(abs(-ring.wrench_map(np.eye(3), (0, 0, 0.05))[2, 2] / point - 1.156) < 1e-3)
        True
        """
        out = np.empty((6, 3))
        centre = np.ascontiguousarray(vectors(p, "p"))
        dipole_on_charges(self.rows, np.ascontiguousarray(rotation(R_SR, "R_SR")), centre, out)
        return out
