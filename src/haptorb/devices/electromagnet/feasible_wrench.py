"""Which wrenches a spherical electromagnet can give at a pose: the image of the box of its currents.

Three coils and two limits each make a box; the wrench map turns it into a zonotope: for the force a parallelepiped with
eight corners, moved by the core's pull, for the torque a flat hexagon, because no torque about the magnet's own axis
can be given. Force and torque are not independent of each other: one choice of currents makes both.

A supply that cannot give all coils their limits at once rounds the box's corners off; what remains is taken as the
polytope of some hundreds of points on its surface, less than 1 % within it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.state import State
from haptorb.devices.wrench_map import WrenchMap
from haptorb.numerics.arrays import Array

__all__ = ["FeasibleWrench", "feasible_wrench"]

_GRID = 13  #: points along an edge of the currents' box


@dataclass(frozen=True)
class FeasibleWrench:
    """What can be given at one pose, stator frame.

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


def feasible_wrench(device: SphericalElectromagnet, state: State, model: str = "exact") -> FeasibleWrench:
    """The polytopes of `device` at `state` within its current limits and its supply's power.

    Raises GeometryError inside the core.

    >>> from dataclasses import replace
    >>> from haptorb.devices.loader import load
    >>> strong = replace(load("omni"), supply=replace(load("omni").supply, power=np.inf))
    >>> able = feasible_wrench(strong, State.at((0, 0, 0.05)))
    >>> able.force.shape, len(able.torque), (able.unreachable.round(6) + 0.0).tolist()
    ((8, 3), 6, [0.0, 0.0, 1.0])
    """
    known = device.wrench_map(state, model)
    limit = device.coils.current_limit
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
    currents = box * device.coils.current_limit
    power = currents**2 @ device.greatest_resistance
    currents *= np.minimum(1.0, np.sqrt(device.supply.power / power))[:, None]
    wrench = currents @ known.matrix.T + known.passive
    hull = ConvexHull(wrench[:, :3])
    torque, flat = np.empty((0, 3)), 0.0
    if plane is not None:
        outline = ConvexHull(wrench[:, 3:] @ plane)
        torque, flat = wrench[outline.vertices, 3:], float(-outline.equations[:, 2].max())
    corners = hull.vertices
    inside = float(-hull.equations[:, 3].max())
    return FeasibleWrench(currents[corners], wrench[corners, :3], torque, lost, inside, flat)


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
