"""What a coil array is made of: copper, magnets, how far it reaches, and the air between its parts."""

from __future__ import annotations

import numpy as np

from haptorb.design.candidate import DesignCandidate
from haptorb.design.objectives.array_force import array_of
from haptorb.devices.coil_array.coil_array import CoilArray
from haptorb.devices.coil_array.winding_gaps import find_farthest, find_spacing
from haptorb.devices.device import Device, require
from haptorb.physics.sources.coil import COPPER_DENSITY

__all__ = ["array_air", "array_copper", "array_envelope", "array_magnets", "array_mass", "array_spacing"]


def array_magnets(device: Device) -> float:
    """[m³] of all magnets in the tool."""
    tool = require(device, CoilArray, "this quantity").tool
    return float(sum(np.pi * (one.outer_radius**2 - one.inner_radius**2) * one.length for one in tool.magnets))


def array_mass(device: Device) -> float:
    """[kg] of the tool, as the file has it."""
    return require(device, CoilArray, "this quantity").tool.mass


def array_copper(candidate: DesignCandidate) -> float:
    """[kg] of the copper, from resistance and dimensions of the windings."""
    device = array_of(candidate)
    coils = device.windings
    volume = np.pi * (coils.outer_radius**2 - coils.inner_radius**2) * coils.length
    return float(COPPER_DENSITY * (coils.fill(device.coils) * volume).sum())


def array_envelope(candidate: DesignCandidate) -> float:
    """[m] from the origin to the dome, or to the farthest corner of a winding, whichever is farther."""
    device = array_of(candidate)
    return max(device.surface.dome_radius, float(find_farthest(device.windings).max()))


def array_air(candidate: DesignCandidate) -> float:
    """[m] least air between a winding and the core, the dome or the plate."""
    device = array_of(candidate)
    coils, surface = device.windings, device.surface
    if surface.is_dome:
        over = surface.dome_radius - find_farthest(coils)
    else:
        axis = coils.axis[:, 2]
        tops = coils.position[:, 2] + np.abs(axis) * coils.length / 2 + np.sqrt(1 - axis**2) * coils.outer_radius
        over = surface.height - tops
    core = np.inf if device.core is None else float(coils.nearest.min()) - device.core.radius
    return min(core, float(over.min()))


def array_spacing(candidate: DesignCandidate) -> float:
    """[m] least air between two windings; 0 where they touch or overlap."""
    return find_spacing(array_of(candidate).windings)
