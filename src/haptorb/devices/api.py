"""Public functions of this package: the wrench map of a device, by name of device and model."""

from __future__ import annotations

from pathlib import Path

from haptorb.devices.base import Device, State, WrenchMap
from haptorb.devices.loader import find_device

__all__ = ["wrench_map"]


def wrench_map(device: Device | str | Path, state: State, model: str | None = None) -> WrenchMap:
    """Compute the wrench per ampere of every channel of a device at one pose.

    Parameters
    ----------
    device : Device, str or Path
        Device, or its name in the catalogue, or path of its file.
    state : State
        Pose of the mover.
    model : str, optional
        One of `device.models`; None: the first.

    Returns
    -------
    WrenchMap
        `matrix` (6, m) [N/A, N·m/A] and `passive` (6,) [N, N·m]; stator frame, torque about the mover's origin.

    Raises
    ------
    UnknownName
        If the device has no such model.
    GeometryError
        If a magnet would be inside a coil or the core at this pose.

    Examples
    --------
    >>> per_ampere = wrench_map("omni", State.at((0, 0, 0.05)), model="published").matrix
    >>> round(float(-1e3 * per_ampere[2, 2]), 1)        # pull of the z coil [mN/A]
    50.5
    """
    known = find_device(device)
    return known.wrench_map(state, model or known.models[0])
