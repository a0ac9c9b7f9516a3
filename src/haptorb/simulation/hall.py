"""Three-axis Hall sensors as they come: gain, offset, cross-axis, noise, quantum, range, and some that fail.

Every sensor reads along its own axes (ϑ̂, φ̂, r̂) and what it reads is turned into the stator frame, as a driver does. The
errors that stay (gain, offset, cross-axis) are drawn once from the seed; the noise is drawn with every reading.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from haptorb.devices.handle import HallQuality
from haptorb.physics.arrays import Array
from haptorb.physics.compiled import kernel
from haptorb.simulation.noise import Noise, fill_normal, stepped

__all__ = ["FAILURES", "HallFaults", "Halls", "halls", "read_halls"]

#: how a sensor can fail, and the number that stands for it
FAILURES = {"none": 0, "dead": 1, "stuck": 2, "saturated": 3}


class Halls(NamedTuple):
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


def halls(frames: Array, quality: HallQuality, noise: float, step: float, seed: int) -> Halls:
    """Sensors with `frames` (k, 3, 3) whose lasting errors are those of `seed`. Fields in [T]."""
    count = len(frames)
    draw = np.random.Generator(np.random.PCG64(seed))
    errors = draw.standard_normal((count, 3, 3))
    scale = np.where(np.eye(3, dtype=bool), quality.gain, quality.cross)
    reach = 32767 * step if step > 0 else np.inf  # 16 bits
    return Halls(
        np.ascontiguousarray(frames),
        np.eye(3) + errors * scale,
        quality.offset * draw.standard_normal((count, 3)),
        float(noise),
        float(step),
        float(reach),
    )


@kernel
def read_halls(halls: Halls, faults: HallFaults, noise: Noise, field: Array) -> None:
    """Turn the true `field` (k, 3) [T], stator frame, into what is read of it, in place."""
    count = field.shape[0]
    draws = np.empty(3 * count)
    fill_normal(noise, draws)
    own, seen = np.empty(3), np.empty(3)
    for k in range(count):
        for i in range(3):
            own[i] = 0.0
            for j in range(3):
                own[i] += halls.frames[k, j, i] * field[k, j]
        kind = faults.kind[k]
        for i in range(3):
            value = halls.offset[k, i] + halls.noise * draws[3 * k + i]
            if kind == 0.0:
                for j in range(3):
                    value += halls.mixing[k, i, j] * own[j]
            elif kind == 2.0:
                value = faults.held[k, i]
            elif kind == 3.0:
                value = halls.reach if own[i] >= 0.0 else -halls.reach
            seen[i] = stepped(min(max(value, -halls.reach), halls.reach), halls.step)
            if kind == 0.0:
                faults.held[k, i] = seen[i]
        for i in range(3):
            field[k, i] = 0.0
            for j in range(3):
                field[k, i] += halls.frames[k, i, j] * seen[j]
