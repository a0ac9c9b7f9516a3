"""Point dipoles: field, its gradients, and the force and torque between two moments, batched and compiled.

The far field of everything here, and Zárate 2020's published model (eqs. 1–2 are the radial case). All of it is in the
frame in which positions and moments are given. Valid away from r = 0; a body of size a is a point dipole only to order
(a/r)²: a 24 mm ring at 50 mm errs by 15.6 % (erratum E16).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, vectors
from haptorb.compiled import kernel
from haptorb.errors import GeometryError
from haptorb.magnetics.source import Source

__all__ = [
    "MU0",
    "MU0_OVER_4PI",
    "Dipole",
    "dipole_per_ampere",
    "field",
    "field_gradient",
    "fill_per_ampere",
    "force",
    "point_field",
    "torque",
]

MU0 = 4e-7 * np.pi  #: Vacuum permeability μ0 [T·m/A], the rounded value 4π·10⁻⁷ that both papers use.
MU0_OVER_4PI = MU0 / (4 * np.pi)  #: of every field in here [T·m/A]


@kernel
def _field(m: Array, r: Array, out: Array) -> None:
    for n in range(r.shape[0]):
        x, y, z = r[n, 0], r[n, 1], r[n, 2]
        q = 1.0 / (x * x + y * y + z * z)
        c = MU0_OVER_4PI * q * np.sqrt(q)
        s = 3.0 * (m[n, 0] * x + m[n, 1] * y + m[n, 2] * z) * q
        out[n, 0] = c * (s * x - m[n, 0])
        out[n, 1] = c * (s * y - m[n, 1])
        out[n, 2] = c * (s * z - m[n, 2])


@kernel
def _gradient(m: Array, r: Array, out: Array) -> None:
    for n in range(r.shape[0]):
        q = 1.0 / (r[n, 0] ** 2 + r[n, 1] ** 2 + r[n, 2] ** 2)
        c = 3.0 * MU0_OVER_4PI * q * q * np.sqrt(q)
        s = m[n, 0] * r[n, 0] + m[n, 1] * r[n, 1] + m[n, 2] * r[n, 2]
        for i in range(3):
            for j in range(3):
                g = m[n, j] * r[n, i] + m[n, i] * r[n, j] - 5.0 * s * q * r[n, i] * r[n, j]
                if i == j:
                    g += s
                out[n, i, j] = c * g


def _flatten(*arrays: ArrayLike, names: tuple[str, ...]) -> tuple[tuple[int, ...], list[Array]]:
    checked = [vectors(array, name) for array, name in zip(arrays, names, strict=True)]
    shape = np.broadcast_shapes(*(array.shape for array in checked))
    flat = [np.ascontiguousarray(np.broadcast_to(array, shape).reshape(-1, 3)) for array in checked]
    if not (flat[-1] ** 2).sum(axis=1).all():
        raise GeometryError("the field of a point dipole is not defined at the dipole itself (r = 0)")
    return shape[:-1], flat


def field(moment: ArrayLike, r: ArrayLike) -> Array:
    """Compute the flux density of point dipoles.

    Parameters
    ----------
    moment : array_like, shape (..., 3)
        Magnetic moments m [A·m²].
    r : array_like, shape (..., 3)
        Vectors from the dipole to the point [m]; the two shapes broadcast together.

    Returns
    -------
    ndarray, shape (..., 3)
        Flux density [T] in the frame of `moment` and `r`.

    Raises
    ------
    GeometryError
        At r = 0, where the field is not defined.

    Notes
    -----
    B = μ0/4π [3 (m·r̂) r̂ − m] / r³. The field of a body of size a is that of a point dipole only to order (a/r)²: a 24
    mm ring magnet at 50 mm differs by 15.6 % (erratum E16).

    Examples
    --------
    >>> bool(abs(field((0, 0, 1.0), (0, 0, 0.1))[2] - 2e-4) < 1e-12)
    True
    """
    shape, (m, at) = _flatten(moment, r, names=("moment", "r"))
    out = np.empty_like(at)
    _field(m, at, out)
    return out.reshape(*shape, 3)


def field_gradient(moment: ArrayLike, r: ArrayLike) -> Array:
    """Compute the gradient of the flux density of point dipoles.

    Parameters
    ----------
    moment : array_like, shape (..., 3)
        Magnetic moments [A·m²].
    r : array_like, shape (..., 3)
        Vectors from the dipole to the point [m].

    Returns
    -------
    ndarray, shape (..., 3, 3)
        Element [i, j] is ∂B_i/∂x_j [T/m]; symmetric and without trace, as curl B = 0 and div B = 0.

    Raises
    ------
    GeometryError
        At r = 0, where the field is not defined.

    Examples
    --------
    >>> bool(abs(np.trace(field_gradient((1.0, 2, 3), (0.1, 0, 0.2)))) < 1e-15)
    True
    """
    shape, (m, at) = _flatten(moment, r, names=("moment", "r"))
    out = np.empty((len(at), 3, 3))
    _gradient(m, at, out)
    return out.reshape(*shape, 3, 3)


def force(moment_1: ArrayLike, moment_2: ArrayLike, r: ArrayLike) -> Array:
    """Compute the force between two point dipoles.

    Parameters
    ----------
    moment_1 : array_like, shape (..., 3)
        Moment of the dipole that makes the field [A·m²].
    moment_2 : array_like, shape (..., 3)
        Moment of the dipole on which the force acts [A·m²].
    r : array_like, shape (..., 3)
        Vector from the first dipole to the second [m].

    Returns
    -------
    ndarray, shape (..., 3)
        Force on the second dipole [N].

    Raises
    ------
    GeometryError
        At r = 0.

    Notes
    -----
    F = ∇(m₂·B₁). Zárate 2020, eqs. (1)–(2) are the radial case.

    Examples
    --------
    >>> pull = force((0, 0, 2.0), (0, 0, 3.0), (0, 0, 0.05))    # aligned, one above the other: they attract
    >>> bool(abs(pull[2] + 6 * MU0 * 6 / (4 * np.pi * 0.05**4)) < 1e-12)
    True
    """
    shape, (m1, m2, at) = _flatten(moment_1, moment_2, r, names=("moment_1", "moment_2", "r"))
    gradient = np.empty((len(at), 3, 3))
    _gradient(m1, at, gradient)
    out: Array = np.einsum("nij,nj->ni", gradient, m2)
    return out.reshape(*shape, 3)


def torque(moment_1: ArrayLike, moment_2: ArrayLike, r: ArrayLike) -> Array:
    """Compute the torque of one point dipole on another, about the other's own centre.

    Parameters
    ----------
    moment_1 : array_like, shape (..., 3)
        Moment of the dipole that makes the field [A·m²].
    moment_2 : array_like, shape (..., 3)
        Moment of the dipole on which the torque acts [A·m²].
    r : array_like, shape (..., 3)
        Vector from the first dipole to the second [m].

    Returns
    -------
    ndarray, shape (..., 3)
        Torque on the second dipole [N·m].

    Raises
    ------
    GeometryError
        At r = 0.

    Notes
    -----
    T = m₂ × B₁.

    Examples
    --------
    >>> torque((0, 0, 1.0), (1.0, 0, 0), (0, 0, 0.1)).round(7).tolist()        # towards the first moment
    [0.0, -0.0002, 0.0]
    """
    shape, (m1, m2, at) = _flatten(moment_1, moment_2, r, names=("moment_1", "moment_2", "r"))
    b = np.empty_like(at)
    _field(m1, at, b)
    return np.cross(m2, b).reshape(*shape, 3)


class Dipole(Source):
    """Point dipole as a source of field.

    Parameters
    ----------
    moment : array_like, shape (3,)
        Magnetic moment [A·m²].
    position : array_like, shape (3,)
        Position [m].

    Examples
    --------
    >>> Dipole((0, 0, 1.0)).field((0, 0, 0.1)).round(7).tolist()
    [0.0, 0.0, 0.0002]
    """

    def __init__(self, moment: ArrayLike, position: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        self._moment = vectors(moment, "moment")
        self.position = vectors(position, "position")

    @property
    def moment(self) -> Array:
        """(3,) [A·m²]."""
        return self._moment

    def field(self, points: ArrayLike) -> Array:
        """Flux density (..., 3) [T] at `points` (..., 3) [m]."""
        return field(self._moment, vectors(points, "points") - self.position)

    def field_gradient(self, points: ArrayLike) -> Array:
        """(..., 3, 3) [T/m], [i, j] = ∂B_i/∂x_j."""
        return field_gradient(self._moment, vectors(points, "points") - self.position)


# --------------------------------------------------------------------------------------------------
# Force and torque per ampere of coils as one dipole each at the centre: what model "published" of a device runs.


@kernel
def _dipole_map(p: Array, axis: Array, moment: float, out: Array) -> None:
    x, y, z = p[0], p[1], p[2]
    q = 1.0 / (x * x + y * y + z * z)
    near = MU0_OVER_4PI * moment * q * np.sqrt(q)
    c = 3.0 * near * q
    s = x * axis[0] + y * axis[1] + z * axis[2]
    for i in range(3):
        for j in range(3):
            g = axis[j] * p[i] + axis[i] * p[j] - 5.0 * s * q * p[i] * p[j]
            if i == j:
                g += s
            out[i, j] = c * g  # ∇(m_p · B): symmetric in i and j
    for j in range(3):
        bx, by, bz = 3.0 * near * q * p[j] * x, 3.0 * near * q * p[j] * y, 3.0 * near * q * p[j] * z
        if j == 0:
            bx -= near
        elif j == 1:
            by -= near
        else:
            bz -= near
        out[3, j] = axis[1] * bz - axis[2] * by  # m_p × B
        out[4, j] = axis[2] * bx - axis[0] * bz
        out[5, j] = axis[0] * by - axis[1] * bx


@kernel
def fill_per_ampere(per_moment: Array, moment_per_current: Array, out: Array) -> None:
    """out (6, m) = per_moment (6, 3) times moment_per_current (3, m)."""
    for i in range(6):
        for k in range(out.shape[1]):
            total = 0.0
            for j in range(3):
                total += per_moment[i, j] * moment_per_current[j, k]
            out[i, k] = total


@kernel
def dipole_per_ampere(moment: float, moment_per_current: Array, p: Array, R: Array, out: Array) -> None:
    """Fill out (6, m) [N/A, N·m/A] for a point dipole of `moment` [A·m²] along the z axis of R, at p.

    The model of Zárate 2020: equations (1) and (2) are its case of a tool on the axis of m_e (sign of e_t as in
    erratum E12).

    >>> K = np.empty((6, 1))
    >>> dipole_per_ampere(2.407, np.array([[0.0], [0.0], [0.2077]]), np.array([0.0, 0.0, 0.05]), np.eye(3), K)
    >>> round(-1e3 * float(K[2, 0]), 1)          # the printed 48 mN/A, averaged over the coils
    48.0
    """
    axis, per_moment = np.empty(3), np.empty((6, 3))
    for i in range(3):
        axis[i] = R[i, 2]
    _dipole_map(p, axis, moment, per_moment)
    fill_per_ampere(per_moment, moment_per_current, out)


def point_field(points: Array) -> Array:
    """(n, 3, 3) [T/(A·m²)] of unit moments along x, y, z at the centre, at `points` (n, 3) [m]."""
    away = np.linalg.norm(points, axis=1)[:, None, None]
    unit = points / away[:, 0]
    found: Array = MU0_OVER_4PI * (3 * unit[:, :, None] * unit[:, None, :] - np.eye(3)) / away**3
    return found
