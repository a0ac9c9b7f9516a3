"""The record of spherical motors: a rotor with a handle, whose torque moves a target through two modes."""

from __future__ import annotations

from haptorb.devices.kind import DeviceKind

__all__ = ["MOTOR"]

MOTOR = DeviceKind(
    name="spherical-motor",
    title="spherical motor",
    world="outlet",
    allocator="haptorb.control.allocation.for_device:torque_allocator",
    estimators="haptorb.sensing.registry:motor_estimators",
    linkage="haptorb.control.clutch.moded_linkage:make_moded_linkage",
    modes=("translate", "rotate"),
    contacts=2,
    simulation="haptorb.simulation.motor.motor:SimulatedMotor",
    guide="haptorb.runtime.pointer.guided_handle:handle_guide",
    file="haptorb.devices.motor.schema:MotorFile",
    tables="haptorb.devices.motor.tables:motor_tables",
    geometry="haptorb.devices.motor.geometry:motor_geometry",
    scene="haptorb.apps.console.scenes:motor_scene",
    card="haptorb.apps.inspect.motor:MotorCard",
    errors="haptorb.control.budget.motor_sources:motor_errors",
    hold="haptorb.control.stability.held_mover:hold_rotor",
    workspace="haptorb.apps.check.workspace:tilt_workspace",
)
