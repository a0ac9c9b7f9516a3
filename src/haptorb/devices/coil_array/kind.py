"""The record of coil arrays: a tool or plate with magnets in a hand, moved by the forces of coils that are anywhere."""

from __future__ import annotations

from haptorb.devices.kind import DeviceKind

__all__ = ["COIL_ARRAY"]

COIL_ARRAY = DeviceKind(
    name="coil-array",
    title="coil array",
    world="wall",
    allocator="haptorb.control.allocation.array.for_array:array_allocator",
    wrench_choice="haptorb.control.allocation.array.for_array:array_choice",
    part_remarks="haptorb.control.allocation.array.for_array:array_remarks",
    simulation="haptorb.simulation.coil_array.coil_array:SimulatedCoilArray",
    file="haptorb.devices.coil_array.schema:CoilArrayFile",
    geometry="haptorb.devices.coil_array.geometry:array_geometry",
    scene="haptorb.apps.console.scenes:array_scene",
    force_map="haptorb.apps.console.force_map_process:ForceMapProcess",
    card="haptorb.apps.inspect.coil_array:CoilArrayCard",
    errors="haptorb.control.budget.array_sources:array_errors",
    workspace="haptorb.apps.check.workspace:array_workspace",
    hold="haptorb.control.stability.held_mover:hold_tool",
)
