"""Components of the simulated devices: chopped supply, coils with R, L and heat, noise, Hall sensors.

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
from haptorb.devices.base import Device
from haptorb.devices.field_sensors import FieldSensors, SensorSpecimen
from haptorb.errors import InputError, UnknownName
from haptorb.thermal import heat_step, network_step, warm_ratio

__all__ = [
    "COIL",
    "FAILURES",
    "HALL",
    "Noise",
    "chop",
    "coil_step",
    "cold_coils",
    "fill_normal",
    "find_share",
    "is_elsewhere",
    "let_fail",
    "make_halls",
    "network_coil_step",
    "quantise",
    "read_halls",
    "seed_noise",
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
