"""Three-axis Hall sensors as they come: gain, offset, cross-axis, noise, quantum, range, and some that fail.

Every sensor reads along its own axes (ϑ̂, φ̂, r̂) and what it reads is turned into the stator frame, as a driver does. The
errors that stay (gain, offset, cross-axis) are drawn once from the seed; the noise is drawn with every reading.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from haptorb.devices.motor.handle import HallQuality
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.simulation.parts.noise import Noise, fill_normal, quantise

__all__ = ["FAILURES", "HallArray", "HallFaults", "halls", "read_halls"]

#: how a sensor can fail, and the number that stands for it
FAILURES = {"none": 0, "dead": 1, "stuck": 2, "saturated": 3}


class HallArray(NamedTuple):
    """The sensors of one device, for compiled code."""

    frames: Array  #: (k, 3, 3) columns ϑ̂, φ̂, r̂
    mixing: Array  #: (k, 3, 3) reading per field along the sensor's own axes
    offset: Array  #: (k, 3) [T]
    noise: float  #: [T]
    step: float  #: [T]
    reach: float  #: greatest reading of an axis [T]


class HallFaults(NamedTuple):
    """Which sensors fail, and what the stuck ones say."""

    kind: Array  #: (k,) numbers of FAILURES
    held: Array  #: (k, 3) last good reading, own axes [T]


def halls(frames: Array, quality: HallQuality, noise: float, step: float, seed: int) -> HallArray:
    """Sensors with `frames` (k, 3, 3) whose lasting errors are those of `seed`. Fields in [T]."""
    count = len(frames)
    draw = np.random.Generator(np.random.PCG64(seed))
    errors = draw.standard_normal((count, 3, 3))
    scale = np.where(np.eye(3, dtype=bool), quality.gain, quality.cross)
    reach = 32767 * step if step > 0 else np.inf  # 16 bits
    return HallArray(
        np.ascontiguousarray(frames),
        np.eye(3) + errors * scale,
        quality.offset * draw.standard_normal((count, 3)),
        float(noise),
        float(step),
        float(reach),
    )


@kernel
def _convert(value: float, reach: float, step: float) -> float:
    return quantise(min(max(value, -reach), reach), step)


@kernel
def _fault_value(kind: float, held: float, own: float, quiet: float, reach: float) -> float:
    """What an axis of a sensor that fails says: held, its greatest, or nothing but offset and noise (`quiet`) [T]."""
    if kind == 2.0:
        return held
    if kind == 3.0:
        return reach if own >= 0.0 else -reach
    return quiet


@kernel
def read_halls(halls: HallArray, faults: HallFaults, noise: Noise, field: Array) -> None:
    """Turn the true `field` (k, 3) [T], stator frame, into what is read of it, in place."""
    count = field.shape[0]
    draws = np.empty(3 * count)
    fill_normal(noise, draws)
    F, M, offset, held = halls.frames, halls.mixing, halls.offset, faults.held
    sigma, reach, step = halls.noise, halls.reach, halls.step
    for k in range(count):
        kind = faults.kind[k]
        x, y, z = field[k, 0], field[k, 1], field[k, 2]
        a = F[k, 0, 0] * x + F[k, 1, 0] * y + F[k, 2, 0] * z  # along its own axes
        b = F[k, 0, 1] * x + F[k, 1, 1] * y + F[k, 2, 1] * z
        c = F[k, 0, 2] * x + F[k, 1, 2] * y + F[k, 2, 2] * z
        u = offset[k, 0] + sigma * draws[3 * k]
        v = offset[k, 1] + sigma * draws[3 * k + 1]
        w = offset[k, 2] + sigma * draws[3 * k + 2]
        if kind == 0.0:
            u = _convert(u + (M[k, 0, 0] * a + M[k, 0, 1] * b + M[k, 0, 2] * c), reach, step)
            v = _convert(v + (M[k, 1, 0] * a + M[k, 1, 1] * b + M[k, 1, 2] * c), reach, step)
            w = _convert(w + (M[k, 2, 0] * a + M[k, 2, 1] * b + M[k, 2, 2] * c), reach, step)
            held[k, 0], held[k, 1], held[k, 2] = u, v, w
        else:
            u = _convert(_fault_value(kind, held[k, 0], a, u, reach), reach, step)
            v = _convert(_fault_value(kind, held[k, 1], b, v, reach), reach, step)
            w = _convert(_fault_value(kind, held[k, 2], c, w, reach), reach, step)
        field[k, 0] = F[k, 0, 0] * u + F[k, 0, 1] * v + F[k, 0, 2] * w
        field[k, 1] = F[k, 1, 0] * u + F[k, 1, 1] * v + F[k, 1, 2] * w
        field[k, 2] = F[k, 2, 0] * u + F[k, 2, 1] * v + F[k, 2, 2] * w
