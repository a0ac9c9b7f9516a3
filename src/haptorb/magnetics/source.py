"""Sources of magnetic field: the abstract source, sources placed and summed, and bodies of revolution."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from haptorb.arrays import Array, check_finite, rotation, vectors
from haptorb.compiled import kernel
from haptorb.errors import GeometryError, InputError
from haptorb.magnetics.current_sheets import SERIES_RADII, coefficients, sheet, sheet_gradient, zonal, zonal_gradient

__all__ = ["PlacedSource", "RoundBody", "SheetStack", "Source", "length", "tensor"]


# --------------------------------------------------------------------------------------------------
# Abstract source of magnetic field: common interface of magnets and coils.


class Source(ABC):
    """Magnet, coil or dipole with a magnetic field; base class of every shape.

    In its own frame: centre at the origin, axis along +z. Values of coils are per ampere. A subclass implements
    `field`, `field_gradient` and `moment`.
    """

    @abstractmethod
    def field(self, points: ArrayLike) -> Array:
        """Compute the flux density.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            Points in the source's frame [m].

        Returns
        -------
        ndarray, shape (..., 3)
            Flux density [T]; of a coil per ampere [T/A].

        Raises
        ------
        GeometryError
            At a point where the field is not defined.
        """

    @abstractmethod
    def field_gradient(self, points: ArrayLike) -> Array:
        """Compute the gradient of the flux density.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            Points in the source's frame [m].

        Returns
        -------
        ndarray, shape (..., 3, 3)
            Element [i, j] is ∂B_i/∂x_j [T/m]; of a coil per ampere [T/m/A].

        Raises
        ------
        GeometryError
            At a point where the gradient is not defined.
        """

    @property
    @abstractmethod
    def moment(self) -> Array:
        """(3,) magnetic moment [A·m²] (coils: per ampere)."""

    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Find points inside the material of the body.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            Points in the source's frame [m].

        Returns
        -------
        ndarray of bool, shape (...)
            True inside the material; a source without a volume contains no point.
        """
        return np.zeros(np.asarray(points).shape[:-1], dtype=bool)


# --------------------------------------------------------------------------------------------------
# Placed and summed sources: both are sources again.


@final
class PlacedSource(Source):
    """Source at a position and orientation; it is a source again.

    Parameters
    ----------
    source : Source
        Source in its own frame.
    position : array_like, shape (3,)
        Position of its centre in the common frame [m].
    turn : array_like, shape (3, 3)
        Rotation from the source's frame to the common frame.

    Raises
    ------
    InputError
        If a shape is wrong, or `turn` is not a rotation.

    Examples
    --------
    >>> from haptorb.magnetics.dipole import Dipole
    >>> turned = PlacedSource(Dipole((0, 0, 1.0)), (0, 0, 0.1), [[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    >>> turned.moment.tolist()
    [1.0, 0.0, 0.0]
    """

    def __init__(self, source: Source, position: ArrayLike, turn: ArrayLike) -> None:
        self.source = source
        self.position = vectors(position, "position")
        self.turn = rotation(turn, "turn")
        if self.position.shape != (3,) or self.turn.shape != (3, 3):
            raise InputError(f"one place needs shapes (3,) and (3, 3); got {self.position.shape}, {self.turn.shape}")

    @property
    def moment(self) -> Array:
        """(3,) [A·m²] in the common frame."""
        moment: Array = self.turn @ self.source.moment
        return moment

    def field(self, points: ArrayLike) -> Array:
        """Flux density (..., 3) [T] at `points` (..., 3) [m], both in the common frame."""
        field: Array = self.source.field(self._to_own_frame(points)) @ self.turn.T
        return field

    def field_gradient(self, points: ArrayLike) -> Array:
        """(..., 3, 3) [T/m], [i, j] = ∂B_i/∂x_j, in the common frame."""
        gradient: Array = self.turn @ self.source.field_gradient(self._to_own_frame(points)) @ self.turn.T
        return gradient

    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """(...,) whether `points` (..., 3) [m] are inside the source's material."""
        return self.source.contains(self._to_own_frame(points))

    def _to_own_frame(self, points: ArrayLike) -> Array:
        own: Array = (vectors(points, "points") - self.position) @ self.turn
        return own


# --------------------------------------------------------------------------------------------------
# Common part of cylinder, ring and winding: bodies of revolution about z, symmetric about their middle plane.
#
# All currents circulate about the axis, so a body is also a bundle of coaxial current filaments, from which the forces
# on it are computed. The kernels convert (ρ, z) components to Cartesian ones without dividing by ρ, so the axis is not
# a singular case.


def length(value: ArrayLike, what: str) -> float:
    """`value` as a positive length [m], or InputError naming `what`.

    A single number, shape ().

    >>> length(0.01, "radius")
    0.01
    """
    number = check_finite(value, what)
    if number.ndim or number <= 0:
        raise InputError(f"{what} must be one positive length in metres; got {value!r}")
    return float(number)


@kernel
def tensor(x: float, y: float, over: float, stretch: float, shear: float, out: Array) -> None:
    """∂B_i/∂x_j from B_ρ/ρ, ∂B_z/∂z and (1/ρ)∂B_z/∂ρ: div B = 0 and curl B = 0 give the rest."""
    rho2 = x * x + y * y
    across = -stretch - 2.0 * over  # ∂B_ρ/∂ρ − B_ρ/ρ, which vanishes on the axis
    xx, xy, yy = (x * x / rho2, x * y / rho2, y * y / rho2) if rho2 > 0.0 else (0.0, 0.0, 0.0)
    out[0, 0] = over + across * xx
    out[1, 1] = over + across * yy
    out[2, 2] = stretch
    out[0, 1] = out[1, 0] = across * xy
    out[0, 2] = out[2, 0] = shear * x
    out[1, 2] = out[2, 1] = shear * y


@kernel
def _field(points: Array, radii: Array, half: float, densities: Array, c: Array, far2: float, out: Array) -> None:
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        rho2 = x * x + y * y
        if rho2 + z * z > far2:
            over, b_z = zonal(c, rho2, z)
        else:
            over, b_z = 0.0, 0.0
            rho = np.sqrt(rho2)
            for i in range(radii.shape[0]):
                o, b = sheet(radii[i], half, rho, z)
                over += densities[i] * o
                b_z += densities[i] * b
        out[n, 0] = over * x
        out[n, 1] = over * y
        out[n, 2] = b_z


@kernel
def _gradient(points: Array, radii: Array, half: float, densities: Array, c: Array, far2: float, out: Array) -> None:
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        rho2 = x * x + y * y
        if rho2 + z * z > far2:
            over, stretch, shear = zonal_gradient(c, rho2, z)
        else:
            over, stretch, shear = 0.0, 0.0, 0.0
            rho = np.sqrt(rho2)
            for i in range(radii.shape[0]):
                o, t, s = sheet_gradient(radii[i], half, rho, z)
                over += densities[i] * o
                stretch += densities[i] * t
                shear += densities[i] * s
        tensor(x, y, over, stretch, shear, out[n])


class SheetStack:
    """Concentric current sheets of one half-length: radii [m] and μ0·current per length [T], evaluated in a batch."""

    def __init__(self, radii: ArrayLike, half: float, densities: ArrayLike) -> None:
        self.radii = np.ascontiguousarray(radii, dtype=np.float64)
        self.half = half
        self.densities = np.ascontiguousarray(densities, dtype=np.float64)
        self.series = coefficients(self.radii, half, self.densities)
        self.far2 = SERIES_RADII**2 * (float(self.radii.max()) ** 2 + half**2)

    def field(self, points: ArrayLike) -> Array:
        """Flux density (..., 3) [T] at `points` (..., 3) [m]; GeometryError on an edge, where it is infinite."""
        at = vectors(points, "points")
        flat = np.ascontiguousarray(at.reshape(-1, 3))
        out = np.empty_like(flat)
        _field(flat, self.radii, self.half, self.densities, self.series, self.far2, out)
        return _check_edge(out, flat).reshape(at.shape)

    def field_gradient(self, points: ArrayLike) -> Array:
        """(..., 3, 3) [T/m], [i, j] = ∂B_i/∂x_j; GeometryError on an edge."""
        at = vectors(points, "points")
        flat = np.ascontiguousarray(at.reshape(-1, 3))
        out = np.empty((len(flat), 3, 3))
        _gradient(flat, self.radii, self.half, self.densities, self.series, self.far2, out)
        return _check_edge(out, flat).reshape(*at.shape, 3)


def _check_edge(out: Array, points: Array) -> Array:
    if not np.isfinite(out).all():
        bad = points[~np.isfinite(out.reshape(len(points), -1)).all(axis=1)][0]
        raise GeometryError(f"the field is infinite on the edge of the body; point {bad.tolist()} m lies on it")
    return out


class RoundBody(Source):
    """Body of revolution in its own frame: axis along +z, centre at the origin."""

    outer_radius: float  #: [m]
    inner_radius: float  #: [m], 0 for a solid body
    length: float  #: along the axis [m]

    @abstractmethod
    def filaments(self, across: int, along: int) -> tuple[Array, Array, Array]:
        """The body as coaxial current loops: radii [m], heights [m], currents [A] (coils: turns, for one ampere).

        `across` and `along` are Gauss points over each wall's thickness and over the length; sums over smooth
        integrands converge exponentially in both.

        Three arrays (loops,).
        """

    @property
    def bounding_radius(self) -> float:
        """Radius of the smallest enclosing sphere about the centre [m]."""
        return float(np.hypot(self.outer_radius, 0.5 * self.length))

    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """(...,) whether `points` (..., 3) [m] are inside the body's material (its surface counts as outside)."""
        at = vectors(points, "points")
        rho = np.hypot(at[..., 0], at[..., 1])
        inside = (rho < self.outer_radius) & (np.abs(at[..., 2]) < 0.5 * self.length)
        return np.asarray(inside & ((rho > self.inner_radius) | (self.inner_radius == 0.0)))
