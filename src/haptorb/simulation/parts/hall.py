"""Three-axis Hall sensors as they come: gain, offset, cross-axis, drift, noise, quantum, range, and some that fail.

Every sensor reads along its own axes, the columns of its frame, and what it reads is turned into the stator frame, as a
driver does. The errors that stay are those of a SensorSpecimen; the noise is drawn with every reading. Where a sensor
really is, is up to who computes the field that it reads.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from haptorb.devices.sensor_errors import SensorSpecimen
from haptorb.errors import InputError, UnknownName
from haptorb.numerics.arrays import Array, Records, fields
from haptorb.numerics.compiled import kernel
from haptorb.simulation.parts.noise import Noise, fill_normal, quantise

__all__ = ["FAILURES", "HALL", "greatest_reading", "let_fail", "make_halls", "read_halls"]

#: how a sensor can fail, and the number that stands for it
FAILURES = {"none": 0, "dead": 1, "stuck": 2, "saturated": 3}


#: Of each sensor.
HALL = fields(
    ("frame", "f8", (3, 3)),  # columns ϑ̂, φ̂, r̂
    ("mixing", "f8", (3, 3)),  # reading per field along the sensor's own axes
    ("offset", "f8", (3,)),  # [T]
    ("gain_drift", "f8", (3,)),  # [1/K]
    ("offset_drift", "f8", (3,)),  # [T/K]
    ("noise", "f8"),  # [T]
    ("step", "f8"),  # [T]
    ("reach", "f8"),  # greatest reading of an axis [T]
    ("failure", "i8"),  # a number of FAILURES
    ("held", "f8", (3,)),  # last good reading, own axes: what a stuck one says [T]
)


def greatest_reading(step: float) -> float:
    """Of an axis of a converter of 16 bits with quantum `step` [T]; inf for an ideal one."""
    return 32767 * step if step > 0 else np.inf


def make_halls(frames: Array, specimen: SensorSpecimen, noise: float, step: float) -> Records:
    """(k,) HALL with `frames` (k, 3, 3) and the lasting errors of `specimen`; none fails. Fields in [T]."""
    made = np.zeros(len(frames), dtype=HALL)
    made["frame"] = frames
    for name in ("mixing", "offset", "gain_drift", "offset_drift"):
        made[name] = getattr(specimen, name)
    made["noise"], made["step"], made["reach"] = noise, step, greatest_reading(step)
    return made


def let_fail(halls: Records, sensors: Iterable[int], kind: str) -> None:
    """Let those of `halls` (k,) with these numbers, from 0, fail: "dead" (nothing but offset and noise), "stuck" at the
    last reading, "saturated"; "none" repairs them.

    Raises UnknownName for another kind, InputError for a sensor that is not there; then nothing has changed.
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
    """What an axis of a sensor that fails says: held, its greatest, or nothing but offset and noise (`quiet`) [T]."""
    if failure == 2:
        return held
    if failure == 3:
        return reach if own >= 0.0 else -reach
    return quiet


@kernel
def read_halls(halls: Records, noise: Noise, warmth: float, field: Array) -> None:
    """Turn the true `field` (k, 3) [T], stator frame, into what `halls`, (k,) HALL, read of it, in place.

    warmth [K]: by how much the sensors are warmer than when they were calibrated.
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
