"""What a device is made of: sizes, gaps, masses, copper, magnets, and what they cost roughly."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from haptorb.design.candidate import DesignCandidate
from haptorb.design.objectives import array_parts
from haptorb.design.objectives.motor_torque import motor_of
from haptorb.design.objectives.registry import describe, option
from haptorb.design.objectives.tool_force import electromagnet_of
from haptorb.devices.device import Device, require
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.electromagnet.windings import Windings
from haptorb.devices.motor.layouts import Layout
from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.physics.sources.coil import COPPER_DENSITY, COPPER_RESISTIVITY

__all__ = ["QUANTITIES", "windings_of"]

_MOTOR, _ELECTROMAGNET, _ARRAY = "spherical-motor", "spherical-electromagnet", "coil-array"
_MAGNET_DENSITY = 7.5e3  #: sintered NdFeB [kg/m³]
_COPPER_AT = 293.15  #: temperature of COPPER_RESISTIVITY [K]
#: EUR, assumed: retail prices of small numbers in 2024; a design file's [evaluation] may say others
_PRICES = {"magnet_price": 120.0, "copper_price": 30.0, "channel_price": 40.0, "sensor_price": 3.0}


def windings_of(candidate: DesignCandidate) -> Windings:
    """The windings of a spherical electromagnet; InputError where its file does not give their sizes."""
    device = electromagnet_of(candidate)
    if device.windings is None:
        raise InputError(f"'{candidate.base.name}' has no [windings]: their sizes are needed for this quantity")
    return device.windings


def _rotor_magnets(device: Device) -> float:
    """[m³]"""
    motor = require(device, SphericalMotor, "this quantity")
    return float(np.abs(motor.polarity).sum() * np.pi * motor.magnet.radius**2 * motor.magnet.length)


def _tool_magnet(device: Device) -> float:
    """[m³]"""
    tool = require(device, SphericalElectromagnet, "this quantity").tool
    return float(np.pi * (tool.outer_radius**2 - tool.inner_radius**2) * tool.length)


def _rotor_mass(candidate: DesignCandidate) -> float:
    base = require(candidate.base, SphericalMotor, "this quantity")
    return _mass(candidate, motor_of(candidate).rotor.mass, base.rotor.mass, _rotor_magnets)


def _tool_mass(candidate: DesignCandidate) -> float:
    base = require(candidate.base, SphericalElectromagnet, "this quantity")
    return _mass(candidate, electromagnet_of(candidate).tool.mass, base.tool.mass, _tool_magnet)


def _array_mass(candidate: DesignCandidate) -> float:
    mass, before = array_parts.array_mass(candidate.device), array_parts.array_mass(candidate.base)
    return _mass(candidate, mass, before, array_parts.array_magnets)


def _mass(candidate: DesignCandidate, mass: float, before: float, magnets: Callable[[Device], float]) -> float:
    """What the file says; magnets that differ from the base's while the mass does not are counted by their volume."""
    if mass != before:
        return mass
    return mass + _MAGNET_DENSITY * (magnets(candidate.device) - magnets(candidate.base))


def _motor_copper(candidate: DesignCandidate) -> float:
    motor = motor_of(candidate)
    coil, coils = motor.electromagnet, motor.coils
    warm = 1 + coils.temperature_coefficient * (coils.reference_temperature - _COPPER_AT)
    in_series = np.abs(motor.groups).sum(axis=0)
    fill = in_series[0] * coil.resistance(1.0, COPPER_RESISTIVITY * warm) / coils.resistance[0]
    volume = np.pi * (coil.outer_radius**2 - coil.inner_radius**2) * coil.length
    return float(COPPER_DENSITY * fill * volume * len(motor.electromagnets))


def _winding_copper(candidate: DesignCandidate) -> float:
    device, windings = electromagnet_of(candidate), windings_of(candidate)
    coils = device.coils
    warm = 1 + coils.temperature_coefficient * (coils.reference_temperature - _COPPER_AT)
    fill = windings.fill(coils.resistance, COPPER_RESISTIVITY * warm)
    volume = np.pi * (windings.outer_radius**2 - windings.inner_radius**2) * windings.length
    return float(COPPER_DENSITY * (fill * volume).sum())


def _motor_cost(candidate: DesignCandidate) -> float:
    return _cost(candidate, _rotor_magnets(candidate.device), _motor_copper(candidate))


def _electromagnet_cost(candidate: DesignCandidate) -> float:
    return _cost(candidate, _tool_magnet(candidate.device), _winding_copper(candidate))


def _array_cost(candidate: DesignCandidate) -> float:
    return _cost(candidate, array_parts.array_magnets(candidate.device), array_parts.array_copper(candidate))


def _cost(candidate: DesignCandidate, magnet_volume: float, copper: float) -> float:
    price = {key: option(candidate, key, default) for key, default in _PRICES.items()}
    return (
        price["magnet_price"] * _MAGNET_DENSITY * magnet_volume
        + price["copper_price"] * copper
        + price["channel_price"] * candidate.device.channels
        + price["sensor_price"] * candidate.device.sensors
    )


def _corner(distance: float, length: float, radius: float) -> float:
    return float(np.hypot(distance + 0.5 * length, radius))


def _motor_envelope(candidate: DesignCandidate) -> float:
    motor = motor_of(candidate)
    coil, magnet = motor.electromagnet, motor.magnet
    return max(
        _corner(motor.magnets.distance, magnet.length, magnet.radius),
        _corner(motor.electromagnets.distance, coil.length, coil.outer_radius),
    )


def _electromagnet_envelope(candidate: DesignCandidate) -> float:
    return electromagnet_of(candidate).dome_radius


def _gap(candidate: DesignCandidate) -> float:
    """Between the outermost of the inner parts and the innermost of the outer ones."""
    motor = motor_of(candidate)
    coil, magnet = motor.electromagnet, motor.magnet
    sizes = [
        (motor.electromagnets.distance, float(coil.length), float(coil.outer_radius)),
        (motor.magnets.distance, float(magnet.length), float(magnet.radius)),
    ]
    inner, outer = sorted(sizes)
    return outer[0] - 0.5 * outer[1] - _corner(*inner)


def _air(candidate: DesignCandidate) -> float:
    device, windings = electromagnet_of(candidate), windings_of(candidate)
    corners = np.hypot(windings.outer_radius, windings.length / 2)
    return float(min(device.dome_radius - corners.max(), windings.inner_radius.min() - device.core_radius))


def _spacing(candidate: DesignCandidate) -> float:
    motor = motor_of(candidate)
    return min(
        _neighbours(motor.electromagnets, motor.electromagnet.outer_radius, motor.electromagnet.length),
        _neighbours(motor.magnets, motor.magnet.radius, motor.magnet.length),
    )


def _neighbours(layout: Layout, radius: float, length: float) -> float:
    """Width of the gap between the inner rims of the two nearest parts; negative where they overlap."""
    cosine: Array = layout.directions @ layout.directions.T - 2 * np.eye(len(layout))
    inner = layout.distance - 0.5 * length
    half = 0.5 * float(np.arccos(np.clip(cosine.max(), -1.0, 1.0)))
    # two rims meet on the plane that halves the angle; inner·sin(half) is how far the axis is from it
    return 2.0 * float(inner * np.sin(half) - radius * np.cos(half))


def _nesting(candidate: DesignCandidate) -> float:
    """How far each winding stays inside the next: as far as its corner, where the two cross, leaves room; negative
    where a wire of the outer one must go over the edge of the inner one."""
    windings = windings_of(candidate)
    order = np.argsort(windings.inner_radius)
    corners = np.hypot(windings.outer_radius, windings.length / 2)[order]
    return float((windings.inner_radius[order][1:] - corners[:-1]).min())


_BOTH = "of the copper, from resistance and dimensions of the windings."
QUANTITIES = (
    describe("envelope_radius", "m", "minimise",
             "Distance of the farthest corner of magnets and coils from the centre; of a spherical electromagnet, its "
             "dome; of a coil array, its dome or the farthest winding.",
             {_MOTOR: _motor_envelope, _ELECTROMAGNET: _electromagnet_envelope, _ARRAY: array_parts.array_envelope}),
    describe("clearance", "m", "maximise",
             "Gap between rotor and stator; of a spherical electromagnet, smallest gap between windings and core or "
             "dome; "
             "of a coil array also plate.",
             {_MOTOR: _gap, _ELECTROMAGNET: _air, _ARRAY: array_parts.array_air}),
    describe("spacing", "m", "maximise",
             "Gap between neighbouring parts: of magnets or coils on their spheres, at the inner rims; of nested "
             "windings, where two cross. Negative: they overlap. Of a coil array, smallest gap between two windings.",
             {_MOTOR: _spacing, _ELECTROMAGNET: _nesting, _ARRAY: array_parts.array_spacing}),
    describe("magnet_volume", "m³", "minimise", "Volume of all magnets of rotor or tool, without the regulator.",
             {_MOTOR: lambda one: _rotor_magnets(one.device), _ELECTROMAGNET: lambda one: _tool_magnet(one.device),
              _ARRAY: lambda one: array_parts.array_magnets(one.device)}),
    describe("moving_mass", "kg", "minimise",
             "Mass of rotor or tool from the file; if only its magnets differ from the base device, corrected by "
             "their volume.", {_MOTOR: _rotor_mass, _ELECTROMAGNET: _tool_mass, _ARRAY: _array_mass}),
    describe("copper", "kg", "minimise", f"Mass {_BOTH}",
             {_MOTOR: _motor_copper, _ELECTROMAGNET: _winding_copper, _ARRAY: array_parts.array_copper}),
    describe("cost", "EUR", "minimise",
             "Magnets and copper by mass, channels and field sensors by number, at the prices of [evaluation] "
             "(magnet_price, copper_price, channel_price, sensor_price); assumed prices otherwise.",
             {_MOTOR: _motor_cost, _ELECTROMAGNET: _electromagnet_cost, _ARRAY: _array_cost}),
)  # fmt: skip
