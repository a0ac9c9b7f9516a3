"""The wrench of coils anywhere around a soft core that is no ball, without anything of the product's.

Loops by elliptic integrals, the magnet by charges on its faces, and the core by charges on both sides of its surface
that make the field continuous there (the method of fundamental solutions), as in `second_coils`, but for any source,
place, direction and ellipsoid.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from haptorb.simulation.electromagnet_specimen import ElectromagnetSpecimen
from haptorb_papers.reproduce.zarate2020.second_coils import charge_field, list_loops, loop_field, spread_points

__all__ = ["read_fields", "read_wrench"]

Array = NDArray[np.float64]
MU0 = 4e-7 * np.pi
SURFACE, CHARGES = 700, 300


def coil_field(built: ElectromagnetSpecimen, number: int, points: Array, *, near: bool) -> Array:
    """(n, 3) [T/A] of the winding alone, in many even loops where the points may be close to it."""
    coils = built.coils
    assert coils is not None
    axis = coils.axis[number]
    first = np.cross(axis, [0.3, -0.5, 0.8])
    first /= np.linalg.norm(first)
    frame = np.column_stack([first, np.cross(axis, first), axis])
    if near:
        node, share = (2 * np.arange(25) + 1) / 25 - 1, np.full(25, 0.04)
    else:
        node, share = np.polynomial.legendre.leggauss(5)
        share = share / 2
    inner, outer, length, turns = (
        float(one[number]) for one in (coils.inner_radius, coils.outer_radius, coils.length, coils.turns)
    )
    loops = list_loops(inner, outer, length, turns, node, share)
    field: Array = loop_field(*loops, (points - coils.position[number]) @ frame) @ frame.T
    return field


def answer(built: ElectromagnetSpecimen, own: list[Array], surface: Array) -> tuple[Array, Array]:
    """Places of charges in the core, and (sources, n) their strength: its answer to fields `own` on its surface."""
    shape = built.core_axes @ np.diag(built.core.radius * (1 + built.core_stretch)) @ built.core_axes.T
    normal = spread_points(SURFACE) @ np.linalg.inv(shape)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    points = spread_points(CHARGES) @ shape.T
    within, beyond = built.core_place + 0.8 * points, built.core_place + points / 0.8
    share = 1 / built.core.permeability

    def split(field: Array) -> tuple[Array, Array]:
        across = (field * normal[:, None]).sum(axis=2)
        return across, field - across[..., None] * normal[:, None]

    inside, outside = (
        split((apart := surface[:, None] - places) / np.linalg.norm(apart, axis=2)[..., None] ** 3)
        for places in (within, beyond)
    )
    along = np.concatenate([np.moveaxis(one[1], 2, 1).reshape(3 * SURFACE, -1) for one in (inside, outside)], axis=1)
    along[:, CHARGES:] *= -1
    across = np.concatenate([share * inside[0], -outside[0]], axis=1)
    none = np.repeat([1e3 * np.abs(along).max(), 0.0], CHARGES)[None]
    sides = np.stack(
        [np.concatenate([np.zeros(3 * SURFACE), (1 - share) * (one * normal).sum(axis=1), [0.0]]) for one in own],
        axis=1,
    )
    matrix = np.vstack([along, across, none])
    found = np.linalg.lstsq(matrix, sides, rcond=1e-12)[0]
    assert np.linalg.norm(matrix @ found - sides) < 1e-2 * np.linalg.norm(np.stack(own)), "no charges fit"
    return within, found[:CHARGES].T


def on_surface(built: ElectromagnetSpecimen) -> Array:
    shape = built.core_axes @ np.diag(built.core.radius * (1 + built.core_stretch)) @ built.core_axes.T
    return built.core_place + spread_points(SURFACE) @ shape.T


def magnet(built: ElectromagnetSpecimen, R: Array, p: Array) -> tuple[Array, Array, Array]:
    """Places, arms and strengths of charges on the faces of the magnet at R and p."""
    ring = built.ring
    node, weight = np.polynomial.legendre.leggauss(4)
    inner, outer = ring.inner_radius**2, ring.outer_radius**2
    rho, turn = np.sqrt(inner + (outer - inner) * (node + 1) / 2), 2 * np.pi * np.arange(14) / 14
    face = np.pi * (outer - inner) * ring.remanence / MU0
    x, y = np.outer(rho, np.cos(turn)).ravel(), np.outer(rho, np.sin(turn)).ravel()
    q = np.repeat(weight / 2, len(turn)) * face / len(turn)
    up = np.column_stack([x, y, np.full(len(x), ring.length / 2)])
    arms = np.vstack([up, up * [1, 1, -1]]) @ R.T
    return p + arms, arms, np.concatenate([q, -q])


def read_fields(built: ElectromagnetSpecimen, points: Array) -> Array:
    """(n, 3, 3) [T/A] of each coil with the core."""
    surface = on_surface(built)
    within, charges = answer(built, [coil_field(built, k, surface, near=True) for k in range(3)], surface)
    return np.stack(
        [coil_field(built, k, points, near=False) + charge_field(within, charges[k], points) for k in range(3)], axis=2
    )


def read_wrench(built: ElectromagnetSpecimen, R: Array, p: Array) -> tuple[Array, Array]:
    """(6, 3) [N/A, N·m/A] on the magnet at R and p, torque about its centre, and (6,) without currents."""
    surface = on_surface(built)
    at, arms, q = magnet(built, R, p)
    own = [coil_field(built, k, surface, near=True) for k in range(3)]
    own += [MU0 / (4 * np.pi) * charge_field(at, q, surface), np.tile(built.earth, (SURFACE, 1))]
    within, charges = answer(built, own, surface)
    fields = [coil_field(built, k, at, near=False) + charge_field(within, charges[k], at) for k in range(3)]
    fields.append(charge_field(within, charges[3] + charges[4], at) + built.earth)

    def wrench(field: Array) -> Array:
        forces = q[:, None] * field
        return np.concatenate([forces.sum(axis=0), np.cross(arms, forces).sum(axis=0)])

    return np.stack([wrench(one) for one in fields[:3]], axis=1), wrench(fields[3])
