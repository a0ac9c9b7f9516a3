"""Field of a coil centred on a soft sphere, with the sphere's, outside both: zonal harmonics about the coil's axis.

A loop at (ρ, z), s = √(ρ² + z²) from the centre, c = z/s, has on its axis the field Σ b_l x^(l−1) inside s, and
Σ b_l s^(2l+1)/x^(l+2) outside, with b_l = μ0 N (1 − c²) P_l'(c)/(2 s^l) per ampere. The sphere of radius a responds to
the first with Σ b_l β_l (l+1)/l a^(2l+1)/x^(l+2) (`soft_sphere`). Off the axis e, at x r̂ from the centre,

    B = Σ k_l (P_(l+1)'(r̂·e) r̂ − P_l'(r̂·e) e)/x^(l+2),    (l+1) k_l = coefficient of 1/x^(l+2) on the axis

Source: Smythe, Static and Dynamic Electricity, §7.13. A winding is a Gauss sum of loops; of one that is symmetric
about the centre the even degrees vanish. Terms fall as (s/x)^l.
"""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import ArrayLike

from haptorb.errors import GeometryError
from haptorb.numerics.arrays import Array, vectors
from haptorb.physics.sources.coil import Coil
from haptorb.physics.sources.dipole import MU0
from haptorb.physics.sources.soft_sphere import SoftSphere

__all__ = ["CentredCoil"]

_NODES = 12  #: of the Gauss sums over the winding's section, each way
_LEFT_OUT = 1e-6  #: relative, of the first neglected term
_MOST = 151  #: degrees


@final
class CentredCoil:
    """`coil` about the centre of `core`, its axis along z, for points at least `nearest` [m] from the centre.

    Raises GeometryError unless `nearest` is outside coil and core.

    >>> from haptorb.physics.sources.dipole import Dipole
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
        order = int(min(_MOST, 3 + np.log(_LEFT_OUT) / np.log(reach / nearest)))
        degrees = np.arange(1, order + 1, 2)
        radii, heights, turns = coil.filaments(_NODES, _NODES)
        far = np.hypot(radii, heights)
        c = heights / far
        slopes = _list_slopes(c, order)[degrees]
        loops = 0.5 * MU0 * turns * (1 - c * c) * slopes  # b_l s^l of each
        answers = core.response(order)[degrees - 1] * (degrees + 1) / degrees
        own = (loops * (far / reach) ** (degrees[:, None] + 1)).sum(axis=1)
        core_part = answers * (loops * (core.radius / far) ** degrees[:, None]).sum(axis=1)
        core_part *= (core.radius / reach) ** (degrees + 1)
        self._reach, self._order = reach, order
        self._strengths: Array = (own + core_part) / (degrees + 1)  # k_l/reach^(l+1) [T·m]

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


def _list_slopes(c: Array, order: int) -> Array:
    """(order + 1, …) P_l'(c) of the Legendre polynomials to degree `order`."""
    out = np.zeros((order + 1, *np.shape(c)))
    value, before = np.asarray(c), np.ones_like(c)
    out[1] = 1.0
    for degree in range(2, order + 1):  # P_l' = c P_(l−1)' + l P_(l−1)
        out[degree] = c * out[degree - 1] + degree * value
        value, before = ((2 * degree - 1) * c * value - (degree - 1) * before) / degree, value
    return out
