"""Three-axis Hall sensors with errors: gain, offset, cross-axis, drift, noise, quantum, range, and failures.

Every sensor reads along its own axes, the columns of its frame, and its reading is rotated to the stator frame, as a
driver does. Constant errors are those of a SensorSpecimen; the noise is drawn with every reading. The caller computes
the field at the true position of a sensor.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from haptorb.arrays import Array, Records, fields
from haptorb.compiled import kernel
from haptorb.devices.field_sensors import FieldSensors, SensorSpecimen
from haptorb.errors import InputError, UnknownName
from haptorb.simulation.noise_generator import Noise, fill_normal

__all__ = ["FAILURES", "HALL", "let_fail", "make_halls", "quantise", "read_halls"]


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
def quantise(value: float, step: float) -> float:
    """Round `value` like a converter with quantum `step`; step 0: ideal."""
    return np.rint(value / step) * step if step > 0.0 else value


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
