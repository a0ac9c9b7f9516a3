"""Distributed multipole model (DMP): a round body as pole pairs on concentric loops, Bai 2012 eqs. (7) and (8).

k loops of n pole pairs each at radii a_j = a j/(k + 1), and one pair on the axis (j = 0) that counts once (erratum E1);
all poles at z = ±l̄/2. Cheap and differentiable, and what the paper's controller computed with; how well it holds is a
matter of the strengths and the region: see `multipole_fit` and `published`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, check_finite, vectors
from haptorb.compiled import kernel
from haptorb.errors import GeometryError, InputError, UnknownName
from haptorb.magnetics import source
from haptorb.magnetics.coil import Coil
from haptorb.magnetics.dipole import MU0_OVER_4PI
from haptorb.magnetics.magnets import CylinderMagnet
from haptorb.magnetics.source import RoundBody, Source

__all__ = ["PUBLISHED", "MultipoleSource", "PublishedModel", "load_published"]


@kernel
def _field(poles: Array, charges: Array, points: Array, out: Array) -> None:
    """B = μ0/4π Σ q R/|R|³; poles (3, p) as a structure of arrays."""
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        bx, by, bz = 0.0, 0.0, 0.0
        for i in range(charges.shape[0]):
            dx, dy, dz = x - poles[0, i], y - poles[1, i], z - poles[2, i]
            d2 = dx * dx + dy * dy + dz * dz
            q = charges[i] / (d2 * np.sqrt(d2))
            bx += q * dx
            by += q * dy
            bz += q * dz
        out[n, 0], out[n, 1], out[n, 2] = MU0_OVER_4PI * bx, MU0_OVER_4PI * by, MU0_OVER_4PI * bz


@kernel
def _gradient(poles: Array, charges: Array, points: Array, out: Array) -> None:
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        xx, yy, zz, xy, xz, yz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(charges.shape[0]):
            dx, dy, dz = x - poles[0, i], y - poles[1, i], z - poles[2, i]
            d2 = dx * dx + dy * dy + dz * dz
            q = MU0_OVER_4PI * charges[i] / (d2 * d2 * np.sqrt(d2))
            xx += q * (d2 - 3.0 * dx * dx)
            yy += q * (d2 - 3.0 * dy * dy)
            zz += q * (d2 - 3.0 * dz * dz)
            xy -= 3.0 * q * dx * dy
            xz -= 3.0 * q * dx * dz
            yz -= 3.0 * q * dy * dz
        out[n, 0, 0], out[n, 1, 1], out[n, 2, 2] = xx, yy, zz
        out[n, 0, 1], out[n, 0, 2], out[n, 1, 2] = xy, xz, yz
        out[n, 1, 0], out[n, 2, 0], out[n, 2, 1] = xy, xz, yz


@final
class MultipoleSource(Source):
    """Pole pairs on loops in a body of `radius` a [m], sources and sinks `pole_distance` l̄ [m] apart.

    `loop_strengths` (k + 1,) are the pole strengths m_j [A·m] (coils: per ampere) of each single pair on loop j, the
    axis first; `per_loop` is n. Curl and divergence vanish everywhere off the poles, where the field is infinite.

    Raises InputError for strengths that are no list, or pairs that are no whole number.

    >>> pair = MultipoleSource(radius=0.01, pole_distance=0.002, loop_strengths=[5.0, 1.0], per_loop=10)
    >>> float(pair.moment[2].round(6))      # (5 + 10·1) l̄
    0.03
    """

    def __init__(self, radius: float, pole_distance: float, loop_strengths: ArrayLike, per_loop: int) -> None:
        self.radius = source.length(radius, "radius")
        self.pole_distance = source.length(pole_distance, "pole_distance")
        self.loop_strengths = check_finite(loop_strengths, "loop_strengths")
        if self.loop_strengths.ndim != 1 or not len(self.loop_strengths):
            raise InputError(f"loop_strengths must be m_0 … m_k, shape (k + 1,); got {self.loop_strengths.shape}")
        if int(per_loop) != per_loop or per_loop < 1:
            raise InputError(f"per_loop must be a whole number of pole pairs, 1 or more; got {per_loop!r}")
        self.per_loop = int(per_loop)
        upper, strengths = loop_poles(self.radius, len(self.loop_strengths) - 1, self.per_loop), self.loop_strengths
        each = np.concatenate([strengths[:1], np.repeat(strengths[1:], self.per_loop)])
        lift = np.array([0.0, 0.0, 0.5 * self.pole_distance])
        self.poles = np.concatenate([upper + lift, upper - lift])  #: (p, 3) [m], all sources, then all sinks
        self.strengths = np.concatenate([each, -each])  #: (p,) [A·m], signed
        self._soa = np.ascontiguousarray(self.poles.T)

    def __repr__(self) -> str:
        return (
            f"MultipoleSource(radius={self.radius}, pole_distance={self.pole_distance}, "
            f"loop_strengths={self.loop_strengths.tolist()}, per_loop={self.per_loop})"
        )

    @property
    def dipoles(self) -> int:
        """Number of pole pairs."""
        return len(self.strengths) // 2

    @property
    def moment(self) -> Array:
        """(3,) [A·m²]: (m_0 + n Σ m_j) l̄."""
        moment: Array = self.strengths @ self.poles
        return moment

    def field(self, points: ArrayLike) -> Array:
        """Flux density (..., 3) [T] at `points` (..., 3) [m], Bai 2012 eq. (8); GeometryError on a pole."""
        at = vectors(points, "points")
        flat = np.ascontiguousarray(at.reshape(-1, 3))
        out = np.empty_like(flat)
        _field(self._soa, self.strengths, flat, out)
        return _check_poles(out).reshape(at.shape)

    def field_gradient(self, points: ArrayLike) -> Array:
        """(..., 3, 3) [T/m], [i, j] = ∂B_i/∂x_j."""
        at = vectors(points, "points")
        flat = np.ascontiguousarray(at.reshape(-1, 3))
        out = np.empty((len(flat), 3, 3))
        _gradient(self._soa, self.strengths, flat, out)
        return _check_poles(out).reshape(*at.shape, 3)


def loop_poles(radius: float, loops: int, per_loop: int) -> Array:
    """(1 + k n, 3) pole positions at z = 0 [m], Bai 2012 eq. (7): the axis, then loop by loop from the inside.

    >>> loop_poles(0.03, 2, 4)[[0, 1, 5]].round(3).tolist()
    [[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.02, 0.0, 0.0]]
    """
    radii = radius * np.arange(1, loops + 1) / (loops + 1)
    angle = 2 * np.pi * np.arange(per_loop) / per_loop
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(per_loop)], axis=1)
    return np.concatenate([np.zeros((1, 3)), (radii[:, None, None] * circle).reshape(-1, 3)])


def _check_poles(out: Array) -> Array:
    if not np.isfinite(out).all():
        raise GeometryError(
            "the field of a multipole model is infinite at its poles, and one of the points is a pole; move the point"
        )
    return out


# --------------------------------------------------------------------------------------------------
# Multipole models of Bai 2012, Table 1, in the interpretations that its missing units allow (erratum E1).
#
# Strengths are printed in "μA/m", lengths without a unit. A pole strength is in A·m, and only one interpretation of the
# lengths gives consistent moments: l = 0.2 and 0.3 inch (a = 15.875 mm is 0.625 inch) and l̄/l = 0.2 for the magnet
# instead of the printed 0.3. The other interpretations are available by name, for comparison only.


MAGNET_RADIUS = 15.875e-3  #: [m]
COIL_RADIUS = 15.88e-3  #: [m]
MAGNET_STRENGTHS = (33.5, 24.5, 57.6, 52.0, 276.1)  #: m_0 … m_4 [A·m]
COIL_STRENGTHS = (1.476, 0.547, 1.618, 1.644, 1.654, 1.325, 0.592)  #: m_0 … m_6 [A·m per A]


@dataclass(frozen=True, slots=True)
class PublishedModel:
    """One interpretation of one column of Table 1: the body and its multipole model."""

    body: RoundBody
    model: MultipoleSource
    reading: str  #: description of the interpretation


def _magnet(length: float, ratio: float, reading: str) -> PublishedModel:
    body = CylinderMagnet(MAGNET_RADIUS, length, 1.31)
    return PublishedModel(body, MultipoleSource(MAGNET_RADIUS, ratio * length, MAGNET_STRENGTHS, 10), reading)


def _coil(length: float, reading: str) -> PublishedModel:
    body = Coil(1000, 0.3 * COIL_RADIUS, COIL_RADIUS, length)
    return PublishedModel(body, MultipoleSource(COIL_RADIUS, 0.442 * length, COIL_STRENGTHS, 16), reading)


#: by name, the recommended interpretation first
PUBLISHED = {
    "bai2012-pm": _magnet(5.08e-3, 0.2, "l = 0.2 inch, l̄/l = 0.2 (printed 0.3): moments agree to 0.2 %"),
    "bai2012-em": _coil(7.62e-3, "l = 0.3 inch, l̄/l = 0.442 as printed"),
    "bai2012-pm-printed": _magnet(5.08e-3, 0.3, "l = 0.2 inch, l̄/l = 0.3 as printed: the moment is 50 % too large"),
    "bai2012-em-aspect": _coil(9.525e-3, "l/2a = 0.3 instead of inches: torque about 30 % too large"),
}


def load_published(name: str) -> PublishedModel:
    """A model of `PUBLISHED` by name, or UnknownName.

    >>> load_published("bai2012-pm").model.dipoles
    41
    """
    if name not in PUBLISHED:
        raise UnknownName("published multipole model", name, PUBLISHED)
    return PUBLISHED[name]
