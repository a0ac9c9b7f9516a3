"""The record of spherical electromagnets: a magnet in a tool over a dome, moved by the force of coils."""

from __future__ import annotations

from haptorb.devices.kind import DeviceKind

__all__ = ["ELECTROMAGNET"]

ELECTROMAGNET = DeviceKind(
    name="spherical-electromagnet",
    title="spherical electromagnet",
    world="dome",
    allocator="haptorb.control.allocation.for_device:force_allocator",
    wrench_choice="haptorb.control.allocation.for_device:tool_choice",
    part_remarks="haptorb.control.allocation.part_remarks:part_remarks",
    estimators="haptorb.sensing.tool.tool_estimators:tool_estimators",
    simulation="haptorb.simulation.electromagnet.electromagnet:SimulatedElectromagnet",
    guide="haptorb.runtime.pointer.guide:dome_guide",
    file="haptorb.devices.electromagnet.schema:ElectromagnetFile",
    geometry="haptorb.devices.electromagnet.geometry:electromagnet_geometry",
    scene="haptorb.apps.console.scenes:dome_scene",
    force_map="haptorb.apps.console.force_map_process:ForceMapProcess",
    card="haptorb.apps.inspect.electromagnet:ElectromagnetCard",
    errors="haptorb.control.budget.tool_sources:tool_errors",
    workspace="haptorb.apps.check.workspace:shell_workspace",
    hold="haptorb.control.stability.held_mover:hold_tool",
    boundary="haptorb.apps.check.stability_trial:boundary",
)
