"""Which wrenches a spherical electromagnet can give at a pose: the image of the box of its currents.

Three coils and two limits each make a box; the wrench map turns it into a zonotope: for the force a parallelepiped
with eight corners, moved by the core's pull, for the torque a flat hexagon, because no torque about the magnet's own
axis can be given. Force and torque are not independent of each other: one choice of currents makes both.

A supply that cannot give all coils their limits at once rounds the box's corners off: the corners are then those of
the polytope of some hundreds of points on the surface, and what can be given in every direction is the least of the
support function of box and ellipsoid, refined from the polytope's weakest faces.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.base import (
    State,
    WrenchMap,
)
from haptorb.devices.electromagnet import SphericalElectromagnet

__all__ = ["FeasibleWrench", "feasible_wrench"]


_GRID = 17  #: points along an edge of the currents' box


_ROUNDS, _MEET = 100, 1e-9  #: of the search for the weakest direction: at the most, and where its bounds meet


@dataclass(frozen=True)
class FeasibleWrench:
    """Feasible forces and torques at one pose, stator frame.

    currents          (n, 3) [A] the corners of what currents there can be: eight where the supply gives them all
    force             (n, 3) [N] the force at each of them, core's pull included: the polytope's corners
    torque            (v, 3) [N·m] corners of the torque's polygon, in order around it; about the magnet's centre
    unreachable       (3,) unit vector: the axis about which no torque can be given
    guaranteed_force  [N] the greatest force that can be given in every direction; negative if not even none can
    guaranteed_torque [N·m] the same for torques across the unreachable axis
    """

    currents: Array
    force: Array
    torque: Array
    unreachable: Array
    guaranteed_force: float
    guaranteed_torque: float


def feasible_wrench(device: SphericalElectromagnet, state: State, model: str | None = None) -> FeasibleWrench:
    """The polytopes of `device` at `state` within its current limits and its supply's power, by its `model`; None: the
    first.

    Raises GeometryError inside the core.

    >>> from dataclasses import replace
    >>> from haptorb.devices.loader import load
    >>> strong = replace(load("omni"), supply=replace(load("omni").supply, power=np.inf))
    >>> able = feasible_wrench(strong, State.at((0, 0, 0.05)))
    >>> able.force.shape, len(able.torque), (able.unreachable.round(6) + 0.0).tolist()
    ((8, 3), 6, [0.0, 0.0, 1.0])
    """
    known = device.wrench_map(state, model or device.models[0])
    limit = device.driven_current
    rank, lost, plane = _torque_plane(known.torque * limit, state)
    if device.supply.power < device.greatest_resistance @ limit**2:
        return _with_supply(device, known, lost, plane if rank == 2 else None)
    corners = np.array(list(product((-1.0, 1.0), repeat=device.channels))) * limit
    force = corners @ known.force.T + known.passive[:3]
    edges = (known.force * limit).T  # one generator per coil, half an edge
    normals = np.array([np.cross(edges[i], edges[j]) for i, j in ((0, 1), (1, 2), (2, 0))])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    reach = np.abs(normals @ edges.T).sum(axis=1)
    inside = np.concatenate([reach + normals @ known.passive[:3], reach - normals @ known.passive[:3]])
    torque, flat = np.empty((0, 3)), 0.0
    if rank == 2:
        torque, flat = _polygon((known.torque * limit).T, plane, known.passive[3:])
    return FeasibleWrench(corners, force, torque, lost, float(inside.min()), flat)


def _torque_plane(torque: Array, state: State) -> tuple[int, Array, Array]:
    """Rank of `torque` (3, m), the axis about which nothing can be given, and (3, 2) the plane of what can."""
    axes, sizes, _ = np.linalg.svd(torque)
    rank = int((sizes > 1e-6 * sizes[0]).sum()) if sizes[0] > 0.0 else 0
    lost = axes[:, -1] * (1.0 if axes[:, -1] @ state.axis >= 0.0 else -1.0)
    return rank, lost, axes[:, :2]


def _with_supply(device: SphericalElectromagnet, known: WrenchMap, lost: Array, plane: Array | None) -> FeasibleWrench:
    """The hulls of the wrenches on the surface of the currents that coils and supply allow."""
    from scipy.spatial import ConvexHull  # a tenth of a second that only a card should wait

    grid = np.linspace(-1.0, 1.0, _GRID)
    box = np.array([u for u in product(grid, repeat=device.channels) if max(map(abs, u)) == 1.0])
    currents = box * device.driven_current
    power = currents**2 @ device.greatest_resistance
    currents *= np.minimum(1.0, np.sqrt(device.supply.power / power))[:, None]
    wrench = currents @ known.matrix.T + known.passive
    hull = ConvexHull(wrench[:, :3])
    torque, flat = np.empty((0, 3)), 0.0
    if plane is not None:
        outline = ConvexHull(wrench[:, 3:] @ plane)
        torque = wrench[outline.vertices, 3:]
        flat = _least_support(device, known.torque.T @ plane, known.passive[3:] @ plane, wrench[:, 3:] @ plane)
    corners = hull.vertices
    inside = _least_support(device, known.force.T, known.passive[:3], wrench[:, :3])
    return FeasibleWrench(currents[corners], wrench[corners, :3], torque, lost, inside, flat)


def _strongest_currents(device: SphericalElectromagnet, gains: Array) -> Array:
    """(n, m) the currents within the coils' limits and the supply's power that make the most of `gains` (n, m) @
    currents: each is its gain over its resistance by one factor, cut at its limit."""
    limit, resistance, power = device.driven_current, device.greatest_resistance, device.supply.power
    per_factor = np.maximum(np.abs(gains) / resistance, 1e-30)
    # Coil after coil reaches its limit as the factor grows; the supply ends that at one of these factors, or before.
    cut_at = limit / per_factor
    order = np.argsort(cut_at, axis=-1)
    cut = np.take_along_axis(np.broadcast_to(resistance * limit**2, gains.shape), order, axis=-1)
    free = np.take_along_axis(resistance * per_factor**2, order, axis=-1)
    spent = np.cumsum(cut, axis=-1) - cut  # by the coils that are at their limits, before each of them
    left = np.cumsum(free[:, ::-1], axis=-1)[:, ::-1]  # of the others, per factor squared
    factors = np.sqrt(np.maximum(power - spent, 0.0) / left)
    ends = factors <= np.take_along_axis(cut_at, order, axis=-1)
    ended = np.take_along_axis(factors, ends.argmax(axis=-1)[:, None], axis=-1)
    factor = np.where(ends.any(axis=-1)[:, None], ended, np.inf)
    currents: Array = np.sign(gains) * np.minimum(factor * per_factor, limit)
    return currents


def _least_support(device: SphericalElectromagnet, gains: Array, passive: Array, points: Array) -> float:
    """The least that can be given in any direction; gains (m, d) per direction and ampere, from `points` (n, d) that
    can be given. Negative if nothing in some directions: the distance from 0 to what can be given.

    What the hull of known points gives is a lower bound, what can be given in its weakest directions an upper one; the
    points that are reached there join the hull until the two meet.
    """
    from scipy.optimize import nnls
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points, incremental=True)
    scale = float(np.abs(points).max())
    upper = np.inf
    for _ in range(_ROUNDS):
        inside = -hull.equations[:, -1]
        lower = float(inside.min())
        ways = hull.equations[np.argsort(inside)[:6], :-1]
        if lower < 0.0:
            corners = hull.points[hull.vertices] / scale
            shares = nnls(np.vstack([corners.T, np.ones(len(corners))]), np.append(np.zeros(points.shape[1]), 1.0))[0]
            nearest = scale * (shares @ corners) / shares.sum()
            lower = -float(np.linalg.norm(nearest))
            ways = -nearest[None] / np.linalg.norm(nearest)
        reached = _strongest_currents(device, ways @ gains.T) @ gains + passive
        upper = min(upper, float(np.einsum("nd,nd->n", ways, reached).min()))
        if upper - lower <= _MEET * scale:
            break
        hull.add_points(reached)
    return upper


def _polygon(spins: Array, plane: Array, passive: Array) -> tuple[Array, float]:
    """Corners of the planar zonotope in order: its edges are twice its generators, sorted by direction."""
    flat = spins @ plane
    flat = np.where((flat[:, 1] < 0) | ((flat[:, 1] == 0) & (flat[:, 0] < 0)), -1.0, 1.0)[:, None] * flat
    flat = flat[np.argsort(np.arctan2(flat[:, 1], flat[:, 0]))]
    half = -flat.sum(axis=0) + 2 * np.vstack([np.zeros(2), np.cumsum(flat, axis=0)[:-1]])
    corners = np.vstack([half, -half])
    middle = passive @ plane
    normals = np.column_stack([-flat[:, 1], flat[:, 0]])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    reach = np.abs(normals @ flat.T).sum(axis=1)
    inside = np.concatenate([reach + normals @ middle, reach - normals @ middle])
    return corners @ plane.T + passive, float(inside.min())
