"""Heat, supply and stress of the windings while a device holds a load, or carries its full current.

The load is `load` of the design file's table [evaluation], in N or N·m. It is applied continuously in the direction,
and at the place or orientation, where it takes the most heat; resistances are those at the derating temperature.
"""

from __future__ import annotations

import numpy as np

from haptorb.design.candidate import DesignCandidate
from haptorb.design.objectives import array_force, motor_torque, tool_force
from haptorb.design.objectives.motor_torque import motor_of
from haptorb.design.objectives.parts import windings_of
from haptorb.design.objectives.registry import describe, option
from haptorb.design.objectives.tool_force import electromagnet_of
from haptorb.numerics.arrays import Array
from haptorb.physics.sources.coil import Coil

__all__ = ["QUANTITIES"]

_MOTOR, _ELECTROMAGNET, _ARRAY = "spherical-motor", "spherical-electromagnet", "coil-array"
_LOADS = {_MOTOR: 0.1, _ELECTROMAGNET: 0.05, _ARRAY: 0.05}  #: N·m and N
_FIND_HEAVIEST = {
    _MOTOR: motor_torque.find_heaviest,
    _ELECTROMAGNET: tool_force.find_heaviest,
    _ARRAY: array_force.find_heaviest,
}


def _channel_powers(candidate: DesignCandidate) -> Array:
    """(m,) heat [W] of the channels that hold the load."""
    device = candidate.device
    load = option(candidate, "load", _LOADS[device.kind.name])
    warm = device.coils.resistance_at(np.full(device.channels, device.coils.heat.derate))
    powers: Array = _FIND_HEAVIEST[device.kind.name](candidate)[1] * load**2 * warm
    return powers


def _temperature(candidate: DesignCandidate) -> float:
    device = candidate.device
    rise = device.coils.heat.network(device.channels).rise_per_watt @ _channel_powers(candidate)
    return float(device.coils.heat.ambient + rise.max())


def _power(candidate: DesignCandidate) -> float:
    return float(_channel_powers(candidate).sum())


def _hoop(coil: Coil, current: float, extra: float = 0.0) -> float:
    """J B r [Pa] at the inner radius, with the coil's own field there and `extra` [T]."""
    density = coil.turns * current / (coil.length * (coil.outer_radius - coil.inner_radius))
    own = float(coil.field((coil.inner_radius, 0.0, 0.0))[2]) * current
    return abs(density * (abs(own) + extra) * coil.inner_radius)


def _motor_stress(candidate: DesignCandidate) -> float:
    motor = motor_of(candidate)
    # a magnet that stands before the coil adds its own field; half its polarization is more than it has outside
    return _hoop(motor.electromagnet, float(motor.driven_current.max()), 0.5 * motor.magnet.polarization)


def _winding_stress(candidate: DesignCandidate) -> float:
    device, windings = electromagnet_of(candidate), windings_of(candidate)
    fields = 2e-7 * windings.parts(device.core)[:, 1] / windings.inner_radius**3  # of the core, on the coil's axis
    both = zip(windings.coils, device.driven_current.tolist(), fields.tolist(), strict=True)
    return max(_hoop(coil, current, field * current) for coil, current, field in both)


_LOAD = "with the load of [evaluation] applied continuously in the worst direction and position"
QUANTITIES = (
    describe("temperature", "K", "minimise", f"Temperature of the hottest winding {_LOAD}.",
             {_MOTOR: _temperature, _ELECTROMAGNET: _temperature, _ARRAY: _temperature}),
    describe("supply_power", "W", "minimise", f"Heat of all windings {_LOAD}: power from the supply.",
             {_MOTOR: _power, _ELECTROMAGNET: _power, _ARRAY: _power}),
    describe("coil_stress", "Pa", "minimise",
             "Hoop stress of a free turn at the inner radius, J B r, at full current, with an upper bound of the "
             "field there.",
             {_MOTOR: _motor_stress, _ELECTROMAGNET: _winding_stress}),
)  # fmt: skip
