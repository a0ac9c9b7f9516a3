"""Public functions of this package: the wrench map of a device, by name of device and model."""

from __future__ import annotations

from pathlib import Path

from haptorb.devices.base import Device, State, WrenchMap
from haptorb.devices.loader import find_device

__all__ = ["wrench_map"]


def wrench_map(device: Device | str | Path, state: State, model: str | None = None) -> WrenchMap:
    """The wrench map of `device` at `state`: `.matrix` (6, m) [N/A, N·m/A], `.passive` (6,).

    `device` is a Device, its name, or its file; `model` is one of its `models`, by default the first. Stator frame,
    torque about the mover's origin. Raises UnknownName for an unknown model.

    >>> per_ampere = wrench_map("omni", State.at((0, 0, 0.05)), model="published").matrix
    >>> round(float(-1e3 * per_ampere[2, 2]), 1)        # pull of the z coil [mN/A]
    50.5
    """
    known = find_device(device)
    return known.wrench_map(state, model or known.models[0])
