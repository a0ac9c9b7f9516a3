"""A motor's physics in compiled code: some steps of rotor and coils, and one reading of every sensor."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from haptorb.devices.tables.table_kernels import sensor_field, torque_characteristic
from haptorb.numerics.arrays import Array, Record, Records, fields
from haptorb.numerics.compiled import kernel
from haptorb.numerics.packing import pack, part
from haptorb.simulation.motor.rotor import ROTOR, angular_velocity, kick, turn
from haptorb.simulation.parts.coils import coil_step
from haptorb.simulation.parts.hall import read_halls
from haptorb.simulation.parts.noise import fill_normal, quantise
from haptorb.simulation.parts.tool import matrix

__all__ = ["MOTOR", "STRIDE", "Magnetics", "advance", "pack_magnetics", "sense"]

STRIDE = 5e-3  #: turn [rad] over which one torque characteristic holds: K changes over tenths of a radian

#: All that a simulated motor remembers but its coils and field sensors, and the numbers that it goes by.
MOTOR = fields(
    ("rotor", ROTOR),
    ("dt", "f8"),  # of a step [s]
    ("steps", "i8"),  # in one call
    ("heat", "f8", (2, 3)),  # `TwoNode.step` of a step
    ("torque", "f8", (3,)),  # of coils, weight and regulator on the rotor, mean of the last call [N·m]
    ("pressed", "f8"),  # how far the end stop gives way [rad]
    ("current_noise", "f8"),  # [A]
    ("current_step", "f8"),  # [A]
    ("warming", "f8"),  # rise of the sensors' temperature as a share of the coils' at their boundary
    ("heat_noise", "f8"),  # [K]
    ("heat_step", "f8"),  # [K]
    ("generator", "u8", (4,)),  # of the sensors' noise
)


class Magnetics(NamedTuple):
    """Magnets, coils and sensors for compiled code."""

    torque_cells: Array
    torque_scale: float
    field_cells: Array
    field_scale: float
    magnets: Array  #: (p, 3) rotor frame
    coils: Array  #: (c, 3)
    sensors: Array  #: (k, 3)
    groups: Array  #: (c, m)
    coil_field: Array  #: (m, 3 k) field of the coils at the sensors [T/A]
    tilt_torque: Array  #: (n,) coefficients of weight and regulator, as `regulator.torque_over_sine` takes them [N·m]


def pack_magnetics(m: Magnetics) -> Array:
    """(n,) `m` as compiled code takes it, each number in the unit [..] of its field."""
    return pack(
        (m.torque_scale, m.field_scale), m.torque_cells, m.field_cells, m.magnets, m.coils, m.sensors, m.groups,
        m.coil_field, m.tilt_torque,
    )  # fmt: skip


@kernel
def _unpack_magnetics(blob: Array) -> Magnetics:
    one = part(blob, 0)
    return Magnetics(
        part(blob, 1), one[0, 0], part(blob, 2), one[0, 1], part(blob, 3), part(blob, 4), part(blob, 5), part(blob, 6),
        part(blob, 7), part(blob, 8)[0],
    )  # fmt: skip


@kernel
def advance(motor: Records, coils: Records, magnetics: Array, strength: Array, duties: Array, wish: Array) -> None:
    """Some steps of rotor and coils: `motor` (1,) MOTOR and `coils` (m,) COIL advance.

    The torque characteristic changes with the pose, and little from step to step: it is looked up once for as many
    steps as the rotor needs for STRIDE, in their middle.

    magnetics as `pack_magnetics` made them; strength (p,) of the magnets; duties (m,); the hand goes to wish (4,) if
    that is a quaternion, else to where it went.
    """
    m, parts = motor[0], _unpack_magnetics(magnetics)
    rotor, truth, dt, steps, channels = m.rotor, m.torque, m.dt, m.steps, coils.size
    R, w, K = np.empty((3, 3)), np.empty(3), np.empty((3, channels))
    passive, given, mean = np.empty(3), np.empty(3), np.empty(channels)
    size = wish[0] * wish[0] + wish[1] * wish[1] + wish[2] * wish[2] + wish[3] * wish[3]
    if 0.0 < size < 1e12:  # false for NaN as well
        for i in range(4):
            rotor.goal[i] = wish[i] / math.sqrt(size)
    for k in range(channels):
        coils[k].duty = duties[k]
    for i in range(3):
        truth[i] = 0.0
    held = 0
    for step in range(steps):
        if held == 0:
            held = _stride(rotor, dt, steps - step)
            _characteristic(rotor, 0.5 * held * dt, parts, strength, K)
        held -= 1
        turn(rotor.q[:], rotor.momentum[:], rotor.inertia[:], 0.5 * dt)
        matrix(rotor.q[:], R)
        angular_velocity(rotor.momentum[:], rotor.inertia[:], R, w)
        for k in range(channels):  # the power that leaves the coil's circuit is the power that the rotor gets
            coils[k].emf = K[0, k] * w[0] + K[1, k] * w[1] + K[2, k] * w[2]
        coil_step(coils, m.heat, dt)
        for k in range(channels):
            mean[k] = coils[k].mean
        for i in range(3):
            given[i] = 0.0
            for k in range(channels):
                given[i] += K[i, k] * mean[k]
        m.pressed = kick(rotor, parts.tilt_torque, R, passive, given, dt)
        for i in range(3):
            truth[i] += (given[i] + passive[i]) / steps
        turn(rotor.q[:], rotor.momentum[:], rotor.inertia[:], 0.5 * dt)


@kernel
def _stride(rotor: Record, dt: float, most: int) -> int:
    """How many steps of `dt` [s], 1 to `most`, the rotor may take until it has turned by STRIDE."""
    momentum, inertia = rotor.momentum, rotor.inertia
    a, b, c = momentum[0] / inertia[0], momentum[1] / inertia[1], momentum[2] / inertia[2]
    turned = dt * math.sqrt(a * a + b * b + c * c)
    if not turned * most > STRIDE:  # also where it is nowhere
        return most
    return max(int(STRIDE / turned), 1)


@kernel
def _characteristic(rotor: Record, ahead: float, parts: Magnetics, strength: Array, K: Array) -> None:
    """Fill K (3, m) [N·m/A] as it will be `ahead` [s] from now if the rotor turns freely until then."""
    q, momentum, R = rotor.q.copy(), rotor.momentum.copy(), np.empty((1, 3, 3))
    turn(q, momentum, rotor.inertia[:], ahead)
    matrix(q, R[0])
    places, groups = parts.coils, parts.groups
    single = np.empty((1, 3, places.shape[0]))
    torque_characteristic(parts.torque_cells, parts.torque_scale, parts.magnets, strength, places, R, single)
    for i in range(3):
        for k in range(K.shape[1]):
            K[i, k] = 0.0
        for j in range(places.shape[0]):
            for k in range(K.shape[1]):
                K[i, k] += single[0, i, j] * groups[j, k]


@kernel
def _is_finite(rotor: Record) -> bool:
    """Whether pose and momentum of a ROTOR are numbers."""
    total = rotor.q[3]
    for i in range(3):
        total += rotor.q[i] + rotor.momentum[i]
    return bool(np.isfinite(total))


@kernel
def sense(
    motor: Records, coils: Records, halls: Records, magnetics: Array, strength: Array, pose: Array, read: Array,
    field: Array,
) -> bool:  # fmt: skip
    """One reading of every sensor, and the rotor's true motion; False, and nothing read, if the rotor is nowhere.

    motor, coils, magnetics and strength as in `advance`; halls (k,) HALL; pose (4, 3) becomes R and w; read (2 m,)
    currents [A], then temperatures [K]; field (k, 3) [T].
    """
    m, parts, channels = motor[0], _unpack_magnetics(magnetics), coils.size
    rotor = m.rotor
    if not _is_finite(rotor):
        return False
    matrix(rotor.q[:], pose[:3])
    angular_velocity(rotor.momentum[:], rotor.inertia[:], pose[:3], pose[3])
    draws = np.empty(2 * channels)
    fill_normal(m.generator, draws)
    for k in range(channels):
        read[k] = quantise(coils[k].current + m.current_noise * draws[k], m.current_step)
        read[channels + k] = quantise(coils[k].body + m.heat_noise * draws[channels + k], m.heat_step)
    sensor_field(
        parts.field_cells, parts.field_scale, parts.magnets, strength, parts.sensors, pose[:3].reshape(1, 3, 3),
        field.reshape(1, -1, 3),
    )  # fmt: skip
    total_field, coil_field = field.reshape(-1), parts.coil_field
    for j in range(channels):
        ampere = coils[j].current
        for r in range(total_field.shape[0]):
            total_field[r] += coil_field[j, r] * ampere
    warmth = 0.0
    for j in range(channels):
        warmth += m.warming * (coils[j].body - coils[j].ambient) / channels
    read_halls(halls, m.generator, warmth, field)
    return True
