"""The force map: radial force that the device would give at many positions, limits included.

This is not the map that the world defines. The world's wrench goes through the controller model, the allocation and
the current limits; the resulting force is that of the exact magnets and the core's own pull.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, vectors
from haptorb.control.allocation import Allocator, WrenchChoice
from haptorb.devices.base import Device, State
from haptorb.devices.loader import find_device
from haptorb.worlds import find_world
from haptorb.worlds.base import World, WrenchPart

__all__ = ["force_map"]


def force_map(
    device: Device | str | Path,
    world: World | str,
    points: ArrayLike,
    *,
    model: str | None = None,
    allocator: Allocator | None = None,
    render: WrenchPart | None = None,
) -> tuple[Array, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    """Radial force (n,) [N], outward positive, and where currents saturate (n,); radial tool at `points` (n, 3) [m].

    `device` and `world` may be names in their catalogues, or `device` a file. The device must support force, torque or
    both on a tool. `model` is the controller model (None: the device's first
    model); the core's pull is compensated as far as the model includes it. `render` is the part of the wrench to
    render, by default the part that the world defines; for a torque, the result is the accompanying force. The
    force given follows from the device's exact model. At rest: no inductance, no heat.

    >>> force, saturated = force_map("omni", "dome", [[0.0, 0.0, 0.055]])
    >>> bool(force[0] > 0.1), bool(saturated[0])
    (True, False)
    """
    known, at = find_device(device), vectors(points, "points").reshape(-1, 3)
    fitted = (find_world(world)() if isinstance(world, str) else world).for_device(known)
    choose = known.kind.require_part("wrench_choice", known.name, "a force map")
    choice: WrenchChoice = choose(known, render, None)
    allocate = (allocator or choice.allocators[choice.choose_part(fitted)]).allocate
    inverted = known.check_model(model or known.models[0])
    radial = np.empty(len(at))
    saturated = np.empty(len(at), dtype=np.bool_)
    for n, p in enumerate(at):
        state = State.at(p)
        allocation = allocate(known.wrench_map(state, inverted), fitted.wrench(state))
        given = known.wrench_map(state, "exact").wrench(allocation.currents)
        radial[n] = given[:3] @ state.axis
        saturated[n] = allocation.saturated.is_limit
    return radial, saturated
