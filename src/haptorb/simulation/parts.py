"""Components of the simulated devices: chopped supply, coils with R, L and heat, Hall sensors, hand and tool.

Every step is exact for constant duty, back-EMF and resistance: the current is an exponential with a known mean square,
and the heat a matrix, of two nodes per coil or of all coils with the core. Neglected: the chopper's ripple (its period
is short compared with L/R), mutual inductance between the nearly orthogonal coils, and eddy currents in the core.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from haptorb.arrays import Array, Record, Records, fields
from haptorb.compiled import kernel, tick_kernel
from haptorb.devices.base import Device, State
from haptorb.devices.coil_array import ArrayMover
from haptorb.devices.electromagnet import DomeContact, Hand, Tool
from haptorb.devices.field_sensors import FieldSensors, SensorSpecimen
from haptorb.errors import InputError, UnknownName
from haptorb.thermal import heat_step, network_step, warm_ratio

__all__ = [
    "COIL",
    "DOME",
    "FAILURES",
    "GRAVITY",
    "GRIP",
    "HALL",
    "TOOL",
    "Noise",
    "chop",
    "coil_step",
    "cold_coils",
    "contact",
    "fill_normal",
    "fill_remaining_rotation",
    "fill_tool",
    "find_share",
    "is_elsewhere",
    "let_fail",
    "make_halls",
    "matrix",
    "move",
    "network_coil_step",
    "plate_contact",
    "quantise",
    "read_halls",
    "read_tool",
    "seed_noise",
    "set_goal",
]


#: One record per coil: parameters and state.
COIL = fields(
    ("resistance", "f8"),  # at the reference temperature [Ω]
    ("inductance", "f8"),  # [H]
    ("voltage", "f8"),  # of the supply [V]
    ("coefficient", "f8"),  # of the resistance [1/K]
    ("reference", "f8"),  # temperature [K]
    ("ambient", "f8"),  # temperature [K]
    ("duty", "f8"),  # −1 to 1
    ("emf", "f8"),  # back-EMF of the moving mover [V]
    ("current", "f8"),  # [A]
    ("winding", "f8"),  # temperature [K]
    ("body", "f8"),  # temperature [K]
    ("mean", "f8"),  # current of the last step [A]
)


def cold_coils(device: Device) -> Records:
    """(m,) COIL of `device`: no current, all temperatures ambient."""
    coils = device.coils
    made = np.zeros(device.channels, dtype=COIL)
    made["resistance"], made["inductance"] = coils.resistance, coils.inductance
    made["voltage"] = device.supply.voltage
    made["coefficient"], made["reference"] = coils.temperature_coefficient, coils.reference_temperature
    made["ambient"] = made["winding"] = made["body"] = coils.heat.ambient
    return made


@tick_kernel
def chop(duties: Array, steps: float, out: Array) -> None:
    """Clip `duties` (m,) to −1…1 and round their magnitudes to 1/steps; non-finite values become zero."""
    for k in range(duties.shape[0]):
        duty = duties[k]
        if not np.isfinite(duty):
            duty = 0.0
        out[k] = np.rint(min(max(duty, -1.0), 1.0) * steps) / steps


@kernel
def _drive(c: Record, dt: float) -> float:
    """Advance the current of a COIL by `dt` [s] under its duty and emf; returns the mean heating power [W]."""
    resistance = c.resistance * warm_ratio(c.coefficient, c.reference, c.winding)
    end = (c.duty * c.voltage - c.emf) / resistance
    gap = c.current - end
    x = resistance * dt / c.inductance
    gone = -np.expm1(-x)
    share = gone / x if x > 0.0 else 1.0  # mean of the decaying part, and of its square
    c.mean = end + gap * share
    square = end * end + 2.0 * end * gap * share + gap * gap * share * (1.0 - 0.5 * gone)
    c.current = end + gap * (1.0 - gone)
    return float(resistance * square)


@kernel
def coil_step(coils: Records, heat: Array, dt: float) -> None:
    """Advance uncoupled `coils`, (m,) COIL, by `dt` [s] under their duties and emf.

    heat (2, 3) is `TwoNode.step(dt)`.
    """
    for k in range(coils.size):
        c = coils[k]
        power = _drive(c, dt)
        c.winding, c.body = heat_step(heat, c.winding, c.body, c.ambient, power)


@kernel
def network_coil_step(coils: Records, heat: Array, core: float, dt: float) -> float:
    """Advance `coils`, (m,) COIL, by `dt` [s] under their duties and emf; returns the core's new temperature [K].

    heat (2 m + 1, 3 m + 1) is the step of a `ThermalNetwork` of windings, bodies and a core, which is at `core` [K].
    """
    m = coils.size
    rises, after, power = np.empty(2 * m + 1), np.empty(2 * m + 1), np.empty(m)
    ambient = coils[0].ambient
    for k in range(m):
        c = coils[k]
        rises[k], rises[m + k] = c.winding - ambient, c.body - ambient
        power[k] = _drive(c, dt)
    rises[2 * m] = core - ambient
    network_step(heat, rises, power, after)
    for k in range(m):
        coils[k].winding, coils[k].body = ambient + after[k], ambient + after[m + k]
    return float(ambient + after[2 * m])


# --------------------------------------------------------------------------------------------------
# Reproducible noise, equal on every machine for a seed: xoshiro256++ (Blackman and Vigna 2019), in compiled code.


Noise: TypeAlias = NDArray[np.uint64]

_TO_MIDDLE = 0x3FF0000000000000 - 0x3FE6A09E667F3BCD  #: in bits, from 1/√2 to 1: rounds to the nearest power of two
_LN2 = math.log(2.0)
_U17, _U19, _U23, _U41, _U45, _U11 = (np.uint64(n) for n in (17, 19, 23, 41, 45, 11))


def seed_noise(seed: int) -> Noise:
    """(4,) state of a generator for `seed`, any integer from 0.

    Raises InputError for an invalid seed.

    >>> bool((seed_noise(1) == seed_noise(1)).all() and (seed_noise(1) != seed_noise(2)).any())
    True
    """
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed must be an integer, 0 or more; got {seed!r}")
    state: Noise = np.random.SeedSequence(int(seed)).generate_state(4, np.uint64).astype(np.uint64)
    return state


@kernel
def _uniform(s: Noise) -> float:
    """Uniform number in (0, 1]: 53 bits, never zero, so that its logarithm exists."""
    mixed = s[0] + s[3]
    mixed = ((mixed << _U23) | (mixed >> _U41)) + s[0]
    shift = s[1] << _U17
    s[2] ^= s[0]
    s[3] ^= s[1]
    s[1] ^= s[2]
    s[0] ^= s[3]
    s[2] ^= shift
    s[3] = (s[3] << _U45) | (s[3] >> _U19)
    return (np.float64(mixed >> _U11) + 1.0) * (1.0 / 9007199254740992.0)


@kernel
def _fill_uniform(s: Noise, first: Array, second: Array) -> None:
    """Fill both arrays alternately with uniform numbers in (0, 1]."""
    for i in range(first.shape[0]):
        first[i] = _uniform(s)
        second[i] = _uniform(s)


@kernel
def _radii(u: Array) -> None:
    """u (n,) becomes √(−2 ln u): ln m for the mantissa m from 1/√2 to √2 as 2 artanh((m − 1)/(m + 1)), by its series.

    Plain arithmetic is vectorised by the compiler, the library's logarithm is not; likewise below.
    """
    bits = u.view(np.int64)
    for i in range(u.shape[0]):
        exponent = np.float64(np.int32((bits[i] + _TO_MIDDLE) >> 52) - 1023)
        bits[i] = bits[i] - (np.int64(np.int32((bits[i] + _TO_MIDDLE) >> 52) - 1023) << 52)  # mantissa only
        f = (u[i] - 1.0) / (u[i] + 1.0)
        g = f * f  # at most 0.0295
        series = 1.0 / 19.0 + g * (1.0 / 21.0)
        series = 1.0 / 17.0 + g * series
        series = 1.0 / 15.0 + g * series
        series = 1.0 / 13.0 + g * series
        series = 1.0 / 11.0 + g * series
        series = 1.0 / 9.0 + g * series
        series = 1.0 / 7.0 + g * series
        series = 1.0 / 5.0 + g * series
        series = 1.0 / 3.0 + g * series
        u[i] = math.sqrt(max(-2.0 * (exponent * _LN2 + 2.0 * f * (1.0 + g * series)), 0.0))


@kernel
def _fill_cos_sin(turns: Array, radius: Array, across: Array) -> None:
    """radius (n,) becomes radius · cos, across (n,) radius · sin of 2π `turns` (n,), from 0 to 1: Taylor over ±45°."""
    for i in range(turns.shape[0]):
        quarter = np.rint(4.0 * turns[i])
        r = (4.0 * turns[i] - quarter) * (0.5 * math.pi)
        g = r * r  # at most 0.617
        s = -1.0 / 1307674368000.0 + g * (1.0 / 355687428096000.0)
        s = 1.0 / 6227020800.0 + g * s
        s = -1.0 / 39916800.0 + g * s
        s = 1.0 / 362880.0 + g * s
        s = -1.0 / 5040.0 + g * s
        s = 1.0 / 120.0 + g * s
        s = -1.0 / 6.0 + g * s
        s = r * (1.0 + g * s)
        c = -1.0 / 87178291200.0 + g * (1.0 / 20922789888000.0)
        c = 1.0 / 479001600.0 + g * c
        c = -1.0 / 3628800.0 + g * c
        c = 1.0 / 40320.0 + g * c
        c = -1.0 / 720.0 + g * c
        c = 1.0 / 24.0 + g * c
        c = 1.0 + g * (-0.5 + g * c)
        # after so many quarter turns (cos, sin) is (c, s), (−s, c), (−c, −s), (s, −c) and (c, s) again
        odd = quarter == 1.0 or quarter == 3.0
        x = s if odd else c
        y = c if odd else s
        size = radius[i]
        radius[i] = -size * x if quarter == 1.0 or quarter == 2.0 else size * x
        across[i] = -size * y if quarter == 2.0 or quarter == 3.0 else size * y


@kernel
def fill_normal(s: Noise, out: Array) -> None:
    """Fill out (n,) with independent standard normals (Box and Muller 1958), advancing `s` (4,)."""
    pairs = (out.shape[0] + 1) // 2
    radius, turns, across = np.empty(pairs), np.empty(pairs), np.empty(pairs)
    _fill_uniform(s, radius, turns)
    _radii(radius)
    _fill_cos_sin(turns, radius, across)
    for i in range(out.shape[0] // 2):
        out[2 * i] = radius[i]
        out[2 * i + 1] = across[i]
    if out.shape[0] % 2:
        out[out.shape[0] - 1] = radius[pairs - 1]


@kernel
def quantise(value: float, step: float) -> float:
    """Round `value` like a converter with quantum `step`; step 0: ideal."""
    return np.rint(value / step) * step if step > 0.0 else value


# --------------------------------------------------------------------------------------------------
# Wrench maps that are expensive are not computed in every step: between two evaluations they are extrapolated with the
# mover's change from the last to the newest. The error is then of second order in that displacement.


_MAP_DISTANCE_M = 2e-5  #: the map is computed again when the mover has moved by this [m] …
_MAP_ROTATION = 1e-3  #: … or an entry of its rotation has changed by this
_LEVER_ARM_M = 0.02  #: lever arm that converts rotation to displacement [m]
_MAX_MAP_DISPLACEMENT_M = 4e-3  #: a larger displacement between two maps gives no valid slope [m]
_MIN_CONTINUATION, _MAX_CONTINUATION = -1.0, 4.0  #: extrapolation limits, relative to that displacement


@kernel
def is_elsewhere(pose: Array, R: Array, p: Array) -> bool:
    """Whether a map computed at `pose` (4, 3), R above p, is outdated for the mover at R (3, 3) and p (3,) [m]."""
    square, turn = 0.0, 0.0
    for i in range(3):
        square += (pose[3, i] - p[i]) ** 2
        for j in range(3):
            turn = max(turn, abs(pose[i, j] - R[i, j]))
    return not (square <= _MAP_DISTANCE_M * _MAP_DISTANCE_M and turn <= _MAP_ROTATION)


@kernel
def find_share(pose: Array, change: Array, R: Array, p: Array) -> float:
    """Displacement of the mover, at R (3, 3) and p (3,) [m], from `pose` (4, 3), relative to its `change` (4, 3) before
    that."""
    along, square = 0.0, 0.0
    for j in range(3):
        along += (p[j] - pose[3, j]) * change[3, j]
        square += change[3, j] * change[3, j]
        for i in range(3):
            along += _LEVER_ARM_M * _LEVER_ARM_M * (R[i, j] - pose[i, j]) * change[i, j]
            square += _LEVER_ARM_M * _LEVER_ARM_M * change[i, j] * change[i, j]
    if not (1e-18 < square < _MAX_MAP_DISPLACEMENT_M * _MAX_MAP_DISPLACEMENT_M):
        return 0.0
    return float(min(max(along / square, _MIN_CONTINUATION), _MAX_CONTINUATION))


# --------------------------------------------------------------------------------------------------
# Three-axis Hall sensors with errors: gain, offset, cross-axis, drift, noise, quantum, range, and failures.
#
# Every sensor reads along its own axes, the columns of its frame, and its reading is rotated to the stator frame, as a
# driver does. Constant errors are those of a SensorSpecimen; the noise is drawn with every reading. The caller computes
# the field at the true position of a sensor.


#: failure modes of a sensor, with their numbers
FAILURES = {"none": 0, "dead": 1, "stuck": 2, "saturated": 3}


#: One record per sensor.
HALL = fields(
    ("frame", "f8", (3, 3)),  # columns ϑ̂, φ̂, r̂
    ("mixing", "f8", (3, 3)),  # reading per field along the sensor's own axes
    ("offset", "f8", (3,)),  # [T]
    ("gain_drift", "f8", (3,)),  # [1/K]
    ("offset_drift", "f8", (3,)),  # [T/K]
    ("noise", "f8"),  # [T]
    ("step", "f8"),  # [T]
    ("reach", "f8"),  # maximum reading of an axis [T]
    ("failure", "i8"),  # a number of FAILURES
    ("held", "f8", (3,)),  # last good reading, own axes: output of a stuck sensor [T]
)


def make_halls(frames: Array, specimen: SensorSpecimen, sensors: FieldSensors) -> Records:
    """(k,) HALL with `frames` (k, 3, 3) and the constant errors of `specimen`; none fails. Fields in [T]."""
    made = np.zeros(len(frames), dtype=HALL)
    made["frame"] = frames
    for name in ("mixing", "offset", "gain_drift", "offset_drift"):
        made[name] = getattr(specimen, name)
    made["noise"], made["step"], made["reach"] = sensors.noise, sensors.step, sensors.greatest_reading
    return made


def let_fail(halls: Records, sensors: Iterable[int], kind: str) -> None:
    """Make those of `halls` (k,) with these numbers, from 0, fail: "dead" (offset and noise only), "stuck" at the
    last reading, "saturated"; "none" repairs them.

    Raises UnknownName for another kind, InputError for a sensor that does not exist; then nothing is changed.
    """
    if kind not in FAILURES:
        raise UnknownName("failure of a field sensor", kind, FAILURES)
    numbers = list(sensors)
    for number in numbers:
        if not 0 <= number < len(halls):
            raise InputError(f"sensor must be 0 to {len(halls) - 1}; got {number}")
    halls["failure"][numbers] = FAILURES[kind]


@kernel
def _convert(value: float, reach: float, step: float) -> float:
    return quantise(min(max(value, -reach), reach), step)


@kernel
def _fault_value(failure: int, held: float, own: float, quiet: float, reach: float) -> float:
    """Output of an axis of a failed sensor: held, its maximum, or offset and noise only (`quiet`) [T]."""
    if failure == 2:
        return held
    if failure == 3:
        return reach if own >= 0.0 else -reach
    return quiet


@kernel
def read_halls(halls: Records, noise: Noise, warmth: float, field: Array) -> None:
    """Replace the true `field` (k, 3) [T], stator frame, by the readings of `halls`, (k,) HALL.

    warmth [K]: temperature of the sensors relative to their calibration.
    """
    draws = np.empty(3 * halls.size)
    fill_normal(noise, draws)
    for k in range(halls.size):
        hall = halls[k]
        F, M, offset, held = hall.frame, hall.mixing, hall.offset, hall.held
        gain_drift, offset_drift = hall.gain_drift, hall.offset_drift
        sigma, reach, step, failure = hall.noise, hall.reach, hall.step, hall.failure
        x, y, z = field[k, 0], field[k, 1], field[k, 2]
        a = F[0, 0] * x + F[1, 0] * y + F[2, 0] * z  # along its own axes
        b = F[0, 1] * x + F[1, 1] * y + F[2, 1] * z
        c = F[0, 2] * x + F[1, 2] * y + F[2, 2] * z
        u = offset[0] + warmth * offset_drift[0] + sigma * draws[3 * k]
        v = offset[1] + warmth * offset_drift[1] + sigma * draws[3 * k + 1]
        w = offset[2] + warmth * offset_drift[2] + sigma * draws[3 * k + 2]
        if failure == 0:
            u = _convert(u + warmth * gain_drift[0] * a + (M[0, 0] * a + M[0, 1] * b + M[0, 2] * c), reach, step)
            v = _convert(v + warmth * gain_drift[1] * b + (M[1, 0] * a + M[1, 1] * b + M[1, 2] * c), reach, step)
            w = _convert(w + warmth * gain_drift[2] * c + (M[2, 0] * a + M[2, 1] * b + M[2, 2] * c), reach, step)
            held[0], held[1], held[2] = u, v, w
        else:
            u = _convert(_fault_value(failure, held[0], a, u, reach), reach, step)
            v = _convert(_fault_value(failure, held[1], b, v, reach), reach, step)
            w = _convert(_fault_value(failure, held[2], c, w, reach), reach, step)
        field[k, 0] = F[0, 0] * u + F[0, 1] * v + F[0, 2] * w
        field[k, 1] = F[1, 0] * u + F[1, 1] * v + F[1, 2] * w
        field[k, 2] = F[2, 0] * u + F[2, 1] * v + F[2, 2] * w


# --------------------------------------------------------------------------------------------------
# Hand on the tool: springs and dampers towards the hand's goal, in position and orientation.
#
# The hand moves with the tool (its effective mass is added) and carries the tool's weight: the observed deflection is
# caused by the device alone. The dampers act against the stator. Grips from the literature range from 0.1 kg, 2 N·s/m,
# 100 N/m (a pen, held lightly) to 0.8 kg, 10 N·s/m, 500 N/m.


#: Impedance of the grip; zeros: no hand.
GRIP = fields(
    ("stiffness", "f8"),  # [N/m]
    ("damping", "f8"),  # [N·s/m]
    ("turn_stiffness", "f8"),  # [N·m/rad]
    ("turn_damping", "f8"),  # [N·m·s/rad]
)


@kernel
def fill_remaining_rotation(q: Array, goal: Array, out: Array) -> None:
    """out (3,) [rad], stator frame: shortest rotation from the unit quaternion q to `goal` (both (x, y, z, w))."""
    x = -goal[3] * q[0] + goal[0] * q[3] - goal[1] * q[2] + goal[2] * q[1]
    y = -goal[3] * q[1] + goal[1] * q[3] - goal[2] * q[0] + goal[0] * q[2]
    z = -goal[3] * q[2] + goal[2] * q[3] - goal[0] * q[1] + goal[1] * q[0]
    w = goal[3] * q[3] + goal[0] * q[0] + goal[1] * q[1] + goal[2] * q[2]
    if w < 0.0:
        x, y, z, w = -x, -y, -z, -w
    s = np.sqrt(x * x + y * y + z * z)
    scale = 2.0 * np.arctan2(s, w) / s if s > 1e-12 else 2.0
    out[0], out[1], out[2] = scale * x, scale * y, scale * z


# --------------------------------------------------------------------------------------------------
# The tool as a rigid body over the dome: pose, motion, and contact along its shaft.
#
# Pose and motion are in the stator frame. Steps are linearly implicit in the hand's springs and dampers (stable for any
# step), explicit otherwise.


GRAVITY = 9.80665  #: [m/s²], along −z of the stator

#: Sphere under the tip; or a level plate, with its height in place of the radius.
DOME = fields(
    ("radius", "f8"),  # [m]
    ("stiffness", "f8"),  # [N/m]
    ("damping", "f8"),  # [N·s/m]
    ("friction", "f8"),  # [1]
)

#: Tool with the effective mass of the hand, dome in contact with it, and the hand's goal.
TOOL = fields(
    ("mass", "f8"),  # tool and hand [kg]
    ("weight", "f8"),  # of the tool, if no hand carries it [N]
    ("inertia", "f8", (3,)),  # principal moments about the magnet's centre, mover frame [kg·m²]
    ("tip", "f8"),  # distance of the tip from the magnet's centre, along −z of the mover [m]
    ("tail", "f8"),  # extent of the shaft behind the magnet's centre that can touch, along +z [m]
    ("dome", DOME),
    ("grip", GRIP),
    ("goal", "f8", (3,)),  # position goal of the hand [m]
    ("goal_q", "f8", (4,)),  # orientation goal of the hand, quaternion
    ("p", "f8", (3,)),  # [m]
    ("q", "f8", (4,)),  # quaternion of R_SR
    ("v", "f8", (3,)),  # [m/s]
    ("w", "f8", (3,)),  # angular velocity [rad/s]
)


def fill_tool(state: Records, tool: Tool | ArrayMover, hand: Hand | None, surface: DomeContact) -> None:
    """Fill `state`, (1,) TOOL, with tool, hand and surface of the device file; without a hand the tool falls.

    A hand carries the tool's weight.
    """
    state["mass"] = tool.mass + (0.0 if hand is None else hand.mass)
    state["weight"] = tool.mass * GRAVITY if hand is None else 0.0
    state["inertia"], state["tip"] = tool.inertia, tool.tip_distance
    for name in ("stiffness", "damping", "friction"):
        state["dome"][name] = getattr(surface, name)
    if hand is not None:
        for name in ("stiffness", "damping", "turn_stiffness", "turn_damping"):
            state["grip"][name] = getattr(hand, name)


def read_tool(state: Records, t: float) -> State:
    """Pose and motion at `t` [s] of the tool in `state`, (1,) TOOL."""
    R = np.empty((3, 3))
    p, q, v, w = (state[name][0].copy() for name in "pqvw")
    matrix(q, R)
    return State(t, R, p, w, v)


@kernel
def matrix(q: Array, R: Array) -> None:
    """Fill R (3, 3) from the unit quaternion q (4,), (x, y, z, w)."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    R[0, 0], R[0, 1], R[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    R[1, 0], R[1, 1], R[1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    R[2, 0], R[2, 1], R[2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)


@kernel
def _inverse_mass(tool: Record, R: Array, rx: float, ry: float, rz: float, ux: float, uy: float, uz: float) -> float:
    """Inverse of the effective mass at arm r along the unit vector u [1/kg]: 1/m + (r×u)·I⁻¹(r×u)."""
    cx, cy, cz = ry * uz - rz * uy, rz * ux - rx * uz, rx * uy - ry * ux
    bx = R[0, 0] * cx + R[1, 0] * cy + R[2, 0] * cz
    by = R[0, 1] * cx + R[1, 1] * cy + R[2, 1] * cz
    bz = R[0, 2] * cx + R[1, 2] * cy + R[2, 2] * cz
    turning: float = bx * bx / tool.inertia[0] + by * by / tool.inertia[1] + bz * bz / tool.inertia[2]
    yielding: float = 1.0 / tool.mass + turning
    return yielding


@kernel
def set_goal(tool: Record, goal_p: Array, goal_q: Array) -> None:
    """Set the hand's goal; non-finite values and invalid quaternions leave the last one."""
    square = 0.0
    for i in range(4):
        square += goal_q[i] * goal_q[i]
    if 0.0 < square < 1e12:  # false for NaN as well
        for i in range(4):
            tool.goal_q[i] = goal_q[i] / np.sqrt(square)
    if np.isfinite(goal_p[0] + goal_p[1] + goal_p[2]):
        for i in range(3):
            tool.goal[i] = goal_p[i]


@kernel
def contact(tool: Record, R: Array, dt: float, out: Array) -> float:
    """Add to out (6,) the contact wrench on `tool`, a TOOL at R (3, 3): force [N] and torque about p [N·m]; returns the
    depth [m].

    The shaft is a line from the tip to behind the magnet; its point nearest to the centre is in contact. So a tool
    lying on the dome rests on its side, and no tilt brings the magnet into the dome. The contact is a spring with a
    damper that never pulls; friction opposes sliding and, within one step, can stop it but not reverse it.
    """
    nx, ny, nz = R[0, 2], R[1, 2], R[2, 2]
    px, py, pz = tool.p[0], tool.p[1], tool.p[2]
    s = min(max(-(px * nx + py * ny + pz * nz), -tool.tip), tool.tail)
    x, y, z = px + s * nx, py + s * ny, pz + s * nz
    distance = np.sqrt(x * x + y * y + z * z)
    depth: float = tool.dome.radius - distance
    if depth <= 0.0:
        return 0.0
    ux, uy, uz = 0.0, 0.0, 1.0
    if distance > 1e-9:
        ux, uy, uz = x / distance, y / distance, z / distance
    _push_back(tool, R, s, (ux, uy, uz), depth, dt, out)
    return depth


@kernel
def plate_contact(tool: Record, R: Array, dt: float, out: Array) -> float:
    """Contact with a level plate at z = `dome.radius`, as `contact`: the lower end of the shaft touches."""
    s = -tool.tip if R[2, 2] >= 0.0 else tool.tail
    depth: float = tool.dome.radius - (tool.p[2] + s * R[2, 2])
    if depth <= 0.0:
        return 0.0
    _push_back(tool, R, s, (0.0, 0.0, 1.0), depth, dt, out)
    return depth


@kernel
def _push_back(
    tool: Record, R: Array, s: float, normal: tuple[float, float, float], depth: float, dt: float, out: Array
) -> None:
    """Add to out (6,) the contact wrench at `s` [m] along the shaft's axis from p, at penetration `depth` [m]."""
    dome, v, w = tool.dome, tool.v, tool.w
    ux, uy, uz = normal
    rx, ry, rz = s * R[0, 2], s * R[1, 2], s * R[2, 2]
    vx = v[0] + w[1] * rz - w[2] * ry
    vy = v[1] + w[2] * rx - w[0] * rz
    vz = v[2] + w[0] * ry - w[1] * rx
    speed = vx * ux + vy * uy + vz * uz
    # A damper that would reverse the motion within a step is limited to one that stops it.
    damping = min(dome.damping, 1.0 / (dt * _inverse_mass(tool, R, rx, ry, rz, ux, uy, uz)))
    push = max(dome.stiffness * depth - damping * speed, 0.0)
    fx, fy, fz = push * ux, push * uy, push * uz
    sx, sy, sz = vx - speed * ux, vy - speed * uy, vz - speed * uz
    slide = np.sqrt(sx * sx + sy * sy + sz * sz)
    if slide > 1e-12:
        sx, sy, sz = sx / slide, sy / slide, sz / slide
        stopping = slide / (dt * _inverse_mass(tool, R, rx, ry, rz, sx, sy, sz))
        drag = min(dome.friction * push, stopping)
        fx -= drag * sx
        fy -= drag * sy
        fz -= drag * sz
    out[0] += fx
    out[1] += fy
    out[2] += fz
    out[3] += ry * fz - rz * fy
    out[4] += rz * fx - rx * fz
    out[5] += rx * fy - ry * fx


@kernel
def move(tool: Record, R: Array, turn: Array, wrench: Array, dt: float) -> None:
    """Advance by one step of `dt` [s] under `wrench` (6,), gravity and grip; `turn` (3,) is the rotation to the goal.

    Velocities first, then the pose with the new velocities; the grip is taken at the step's end:
    v' = [m v + dt (F + k (g − p))] / (m + dt c + dt² k), and so about every principal axis.
    """
    grip, p, v, w = tool.grip, tool.p, tool.v, tool.w
    stiff, damp = grip.stiffness, grip.damping
    for i in range(3):
        force = wrench[i] - (tool.weight if i == 2 else 0.0)
        speed = tool.mass * v[i] + dt * (force + stiff * (tool.goal[i] - p[i]))
        v[i] = speed / (tool.mass + dt * damp + dt * dt * stiff)
        p[i] += dt * v[i]
    ix, iy, iz = tool.inertia[0], tool.inertia[1], tool.inertia[2]
    wx = R[0, 0] * w[0] + R[1, 0] * w[1] + R[2, 0] * w[2]
    wy = R[0, 1] * w[0] + R[1, 1] * w[1] + R[2, 1] * w[2]
    wz = R[0, 2] * w[0] + R[1, 2] * w[1] + R[2, 2] * w[2]
    tx, ty, tz = (
        wrench[3] + grip.turn_stiffness * turn[0],
        wrench[4] + grip.turn_stiffness * turn[1],
        wrench[5] + grip.turn_stiffness * turn[2],
    )
    bx = R[0, 0] * tx + R[1, 0] * ty + R[2, 0] * tz - (iz - iy) * wy * wz  # Euler's equations
    by = R[0, 1] * tx + R[1, 1] * ty + R[2, 1] * tz - (ix - iz) * wz * wx
    bz = R[0, 2] * tx + R[1, 2] * ty + R[2, 2] * tz - (iy - ix) * wx * wy
    held = dt * grip.turn_damping + dt * dt * grip.turn_stiffness
    wx = (ix * wx + dt * bx) / (ix + held)
    wy = (iy * wy + dt * by) / (iy + held)
    wz = (iz * wz + dt * bz) / (iz + held)
    for i in range(3):
        w[i] = R[i, 0] * wx + R[i, 1] * wy + R[i, 2] * wz
    _turn(tool.q, wx, wy, wz, dt)


@kernel
def _turn(q: Array, wx: float, wy: float, wz: float, dt: float) -> None:
    """Rotate the quaternion q (4,) by the mover-frame rate w over dt, exact for a constant rate."""
    rate = np.sqrt(wx * wx + wy * wy + wz * wz)
    half = 0.5 * rate * dt
    s = np.sin(half) / rate if half > 1e-8 else 0.5 * dt
    a, b, c, d = s * wx, s * wy, s * wz, np.cos(half)
    x, y, z, w = q[0], q[1], q[2], q[3]
    nx = w * a + x * d + y * c - z * b
    ny = w * b - x * c + y * d + z * a
    nz = w * c + x * b - y * a + z * d
    nw = w * d - x * a - y * b - z * c
    scale = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz + nw * nw)
    q[0], q[1], q[2], q[3] = nx * scale, ny * scale, nz * scale, nw * scale
