"""Independent formulations of force and torque between two bodies, which share only the fields with `wrench`."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, vectors
from haptorb.magnetics.coil import Coil
from haptorb.magnetics.dipole import MU0
from haptorb.magnetics.interaction import BoundedValue, _check_outside, _pose, _refine
from haptorb.magnetics.magnets import CylinderMagnet, RingMagnet
from haptorb.magnetics.source import Source

__all__ = ["flux_linkage", "wrench_on_charges"]


def wrench_on_charges(
    source: Source,
    magnet: CylinderMagnet | RingMagnet,
    position: ArrayLike,
    turn: ArrayLike,
    *,
    about: ArrayLike | None = None,
    precision: float = 1e-8,
) -> BoundedValue:
    """The wrench of `source` on a magnet, from magnetic charges ±M on its faces: dF = ±M B dA, a second formulation.

    Arguments, result and errors are those of `wrench`. It costs more where the source is a coil, whose field is itself
    an integral; it shares nothing with `wrench` but the fields.

    Value (6,) [N, N·m] with its error bound.
    """
    place, R = _pose(position, turn)
    pivot = place if about is None else vectors(about, "about")
    lift, density = np.array([0.0, 0.0, 0.5 * magnet.length]), magnet.polarization / MU0

    def integral(level: tuple[int, int, int]) -> tuple[Array, Array]:
        disc, area = _disc(magnet.inner_radius, magnet.outer_radius, 3 * level[0], level[2])
        faces = np.concatenate([disc + lift, disc - lift])
        points = faces @ R.T + place
        _check_outside(source, points)
        charge = density * np.concatenate([area, -area])
        df = charge[:, None] * source.field(points)
        dt = np.cross(points - pivot, df)
        gross = np.array([np.linalg.norm(df, axis=1).sum(), np.linalg.norm(dt, axis=1).sum()])
        return np.concatenate([df.sum(axis=0), dt.sum(axis=0)]), gross

    return _refine(integral, precision, "wrench on charges")


def flux_linkage(
    source: Source, coil: Coil, position: ArrayLike, turn: ArrayLike, *, precision: float = 1e-8
) -> BoundedValue:
    """Flux (1,) [Wb] of `source` linked with all turns of `coil`, whose pose is given as for `wrench`.

    Every point of the bore is encircled by all turns, a point of the winding by those outside it. Its derivative by a
    displacement or a rotation of the source is the force or torque on the source at one ampere (virtual work).
    """
    place, R = _pose(position, turn)
    ri, ro = coil.inner_radius, coil.outer_radius
    lift = np.array([0.0, 0.0, 0.5 * coil.length])

    def integral(level: tuple[int, int, int]) -> tuple[Array, Array]:
        y, v = np.polynomial.legendre.leggauss(level[1])
        bore, bore_area = _disc(0.0, ri, 2 * level[0], level[2])
        wire, wire_area = _disc(ri, ro, 2 * level[0], level[2])
        turns = (ro - np.hypot(wire[:, 0], wire[:, 1])) / (ro - ri)
        disc, area = np.concatenate([bore, wire]), np.concatenate([bore_area, wire_area * turns])
        layers = np.concatenate([disc + height * lift for height in y])
        weight = 0.5 * coil.turns * np.concatenate([share * area for share in v])
        points = layers @ R.T + place
        _check_outside(source, points)
        flux = weight * (source.field(points) @ R[:, 2])
        return np.array([flux.sum()]), np.array([np.abs(flux).sum()])

    return _refine(integral, precision, "flux linkage")


def _disc(inner: float, outer: float, rings: int, steps: int) -> tuple[Array, Array]:
    """Points (n, 3) of a ring-shaped face at z = 0, and the area (n,) that each stands for."""
    x, w = np.polynomial.legendre.leggauss(rings)
    radii = 0.5 * (outer + inner) + 0.5 * (outer - inner) * x
    angles = 2 * np.pi * (np.arange(steps) + 0.5) / steps
    points = np.zeros((rings, steps, 3))
    points[..., 0] = radii[:, None] * np.cos(angles)
    points[..., 1] = radii[:, None] * np.sin(angles)
    area = np.repeat(0.5 * (outer - inner) * w * radii * (2 * np.pi / steps), steps)
    return points.reshape(-1, 3), area
