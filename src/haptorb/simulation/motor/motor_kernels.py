"""A motor's physics in compiled code: some steps of rotor and coils, and one reading of every sensor."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from haptorb.devices.tables.table_kernels import sensor_field, torque_characteristic
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.simulation.motor.hall import HallArray, HallFaults, read_halls
from haptorb.simulation.motor.rotor import Joint, angular_velocity, kick, turn
from haptorb.simulation.parts.coils import BODY, CURRENT, CoilConstants, coil_step
from haptorb.simulation.parts.noise import Noise, fill_normal, quantise
from haptorb.simulation.parts.tool import matrix

__all__ = ["STRIDE", "MeterNoise", "Parts", "advance", "sense"]

STRIDE = 5e-3  #: turn [rad] over which one torque characteristic holds: K changes over tenths of a radian


class Parts(NamedTuple):
    """The magnetics for compiled code."""

    torque_cells: Array
    torque_scale: float
    field_cells: Array
    field_scale: float
    magnets: Array  #: (p, 3) rotor frame
    strength: Array  #: (p,)
    coils: Array  #: (c, 3)
    sensors: Array  #: (k, 3)
    groups: Array  #: (c, m)
    coil_field: Array  #: (m, 3 k) field of the coils at the sensors [T/A]


class MeterNoise(NamedTuple):
    """Current and heat sensors: standard deviation and step."""

    current_noise: float
    current_step: float
    heat_noise: float
    heat_step: float


@kernel
def advance(
    state: Array, coils: Array, duties: Array, wish: Array, goal: Array, numbers: Array, resistance: Array,
    inductance: Array, heat: Array, inertia: Array, damping: Array, lean: Array, torque_cells: Array, magnets: Array,
    strength: Array, places: Array, groups: Array, dt: float, steps: int, truth: Array,
) -> float:  # fmt: skip
    """`steps` steps of `dt` [s]; fills truth (3,) with the mean torque; returns how far the stop is pressed [rad].

    The torque characteristic changes with the pose, and little from step to step: it is looked up once for as many
    steps as the rotor needs for STRIDE, in their middle.

    goal (4,) is where the hand goes: wish (4,) if that is a quaternion, else what it was. numbers (11,): what is one
    number of wires, joint and parts; a call with tuples takes twice as long.
    """
    n = numbers
    wires = CoilConstants(resistance, inductance, n[0], n[1], n[2], n[3])
    joint = Joint(inertia, damping, n[4], n[5], lean, n[6], n[7], n[8], n[9])
    channels = duties.shape[0]
    R, w, K = np.empty((3, 3)), np.empty(3), np.empty((3, channels))
    emf, mean = np.empty(channels), np.empty(channels)
    passive, given = np.empty(3), np.empty(3)
    size = wish[0] * wish[0] + wish[1] * wish[1] + wish[2] * wish[2] + wish[3] * wish[3]
    if 0.0 < size < 1e12:  # false for NaN as well
        for i in range(4):
            goal[i] = wish[i] / math.sqrt(size)
    for i in range(3):
        truth[i] = 0.0
    pressed, held = 0.0, 0
    for step in range(steps):
        if held == 0:
            held = _stride(state, inertia, dt, steps - step)
            _characteristic(state, inertia, 0.5 * held * dt, torque_cells, n[10], magnets, strength, places, groups, K)
        held -= 1
        turn(state, inertia, 0.5 * dt)
        matrix(state[:4], R)
        angular_velocity(state, inertia, R, w)
        for k in range(channels):  # the power that leaves the coil's circuit is the power that the rotor gets
            emf[k] = K[0, k] * w[0] + K[1, k] * w[1] + K[2, k] * w[2]
        coil_step(coils, wires, heat, duties, emf, dt, mean)
        for i in range(3):
            given[i] = 0.0
            for k in range(channels):
                given[i] += K[i, k] * mean[k]
        pressed = kick(state, R, joint, goal, passive, given, dt)
        for i in range(3):
            truth[i] += (given[i] + passive[i]) / steps
        turn(state, inertia, 0.5 * dt)
    return pressed


@kernel
def _stride(state: Array, inertia: Array, dt: float, most: int) -> int:
    """How many steps of `dt` [s], 1 to `most`, the rotor may take until it has turned by STRIDE."""
    a, b, c = state[4] / inertia[0], state[5] / inertia[1], state[6] / inertia[2]
    turned = dt * math.sqrt(a * a + b * b + c * c)
    if not turned * most > STRIDE:  # also where it is nowhere
        return most
    return max(int(STRIDE / turned), 1)


@kernel
def _characteristic(
    state: Array, inertia: Array, ahead: float, cells: Array, scale: float, magnets: Array, strength: Array,
    places: Array, groups: Array, K: Array,
) -> None:  # fmt: skip
    """Fill K (3, m) [N·m/A] as it will be `ahead` [s] from now if the rotor turns freely until then."""
    then, R = state.copy(), np.empty((1, 3, 3))
    turn(then, inertia, ahead)
    matrix(then[:4], R[0])
    single = np.empty((1, 3, places.shape[0]))
    torque_characteristic(cells, scale, magnets, strength, places, R, single)
    for i in range(3):
        for k in range(K.shape[1]):
            K[i, k] = 0.0
        for j in range(places.shape[0]):
            for k in range(K.shape[1]):
                K[i, k] += single[0, i, j] * groups[j, k]


@kernel
def sense(
    state: Array, coils: Array, numbers: Array, inertia: Array, field_cells: Array, magnets: Array, strength: Array,
    sensors: Array, coil_field: Array, frames: Array, mixing: Array, offset: Array, failed: Array, held: Array,
    noise: Noise, pose: Array, read: Array, field: Array,
) -> bool:  # fmt: skip
    """One reading of every sensor, and the rotor's true motion; False, and nothing read, if the rotor is nowhere.

    pose (4, 3) becomes R and w; read (2 m,) currents [A], then temperatures [K]; field (k, 3) [T].
    numbers (8,): what is one number of meters, sensors and table.
    """
    total = 0.0
    for i in range(state.shape[0]):
        total += state[i]
    if not np.isfinite(total):
        return False
    n = numbers
    meters = MeterNoise(n[0], n[1], n[2], n[3])
    halls = HallArray(frames, mixing, offset, n[4], n[5], n[6])
    matrix(state[:4], pose[:3])
    angular_velocity(state, inertia, pose[:3], pose[3])
    channels = coils.shape[1]
    draws = np.empty(2 * channels)
    fill_normal(noise, draws)
    for k in range(channels):
        read[k] = quantise(coils[CURRENT, k] + meters.current_noise * draws[k], meters.current_step)
        read[channels + k] = quantise(coils[BODY, k] + meters.heat_noise * draws[channels + k], meters.heat_step)
    sensor_field(field_cells, n[7], magnets, strength, sensors, pose[:3].reshape(1, 3, 3), field.reshape(1, -1, 3))
    total_field = field.reshape(-1)
    for j in range(channels):
        ampere = coils[CURRENT, j]
        for r in range(total_field.shape[0]):
            total_field[r] += coil_field[j, r] * ampere
    read_halls(halls, HallFaults(failed, held), noise, field)
    return True
