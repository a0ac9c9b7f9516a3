"""Force map: radial force of the device at many positions, limits included.

This is not the force field of the world: the world's wrench goes through the controller model, the allocation and
the current limits; the resulting force is that of the exact magnets and the core's own pull.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, vectors
from haptorb.control.allocation import Allocator
from haptorb.control.registry import make_choice
from haptorb.devices.base import Device, State, unsupported
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
    """Compute the radial force that a device renders of a world at many positions, limits included.

    The tool is at rest, its axis radial. The world's wrench goes through the controller model, the allocation and the
    current limits; the resulting force follows from the exact model.

    Parameters
    ----------
    device : Device, str or Path
        Device that renders force, torque or both on a tool; or its name, or path of its file.
    world : World or str
        World to be rendered, or its name in the catalogue.
    points : array_like, shape (n, 3)
        Positions of the tool's magnet in the stator frame [m].
    model : str, optional
        Controller model; None: the device's first.
    allocator : Allocator, optional
        Allocator of the currents; None: that of the device.
    render : str, optional
        Part of the wrench to render, "force", "torque" or "both"; None: the part that the world defines. For a torque,
        the result is the accompanying force.

    Returns
    -------
    force : ndarray, shape (n,)
        Radial force [N], outward positive.
    saturated : ndarray of bool, shape (n,)
        Whether a limit of current or power is reached.

    Raises
    ------
    UnknownName
        If there is no such device, world or model.
    InputError
        If the kind of device has no force map, or a shape is wrong.

    Notes
    -----
    The attraction of the core is compensated as far as the controller model includes it. Inductance and heat are
    neglected.

    Examples
    --------
    >>> force, saturated = force_map("omni", "dome", [[0.0, 0.0, 0.055]])
    >>> bool(force[0] > 0.1), bool(saturated[0])
    (True, False)
    """
    known, at = find_device(device), vectors(points, "points").reshape(-1, 3)
    fitted = (find_world(world)() if isinstance(world, str) else world).for_device(known)
    choice = make_choice(known, render)
    if choice is None:
        raise unsupported(known, "a force map", make_choice)
    allocate = (allocator or choice.allocators[choice.choose_part(fitted)]).allocate
    inverted = known.check_model(model or known.models[0])
    radial = np.empty(len(at))
    saturated = np.empty(len(at), dtype=np.bool_)
    for n, p in enumerate(at):
        state = State.at(p)
        allocation = allocate(known.wrench_map(state, inverted), fitted.wrench(state))
        given = known.wrench_map(state, known.models[0]).wrench(allocation.currents)
        radial[n] = given[:3] @ state.axis
        saturated[n] = allocation.saturated.is_limit
    return radial, saturated
