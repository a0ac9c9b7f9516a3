"""Which readings of field sensors are plausible, and what remains of them without the coils' field."""

from __future__ import annotations

import numpy as np

from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel

__all__ = ["magnet_field", "reading_limit"]


def reading_limit(motor: SphericalMotor, orientations: Array, field: Array) -> float:
    """A magnitude [T] that no sensor can read unless it is broken: 1.5 times the most that magnets and coils give.

    Over orientations (n, 3, 3), whose field (n, k, 3) [T] is given. Raises InputError where there are none.
    """
    if not len(orientations):
        raise InputError("the field's range needs at least one orientation; got none")
    most = float(np.sqrt((field**2).sum(axis=2).max()))
    coils = motor.coils.current_limit @ np.abs(motor.sensor_field_per_ampere)
    return 1.5 * (most + float(np.sqrt((coils.reshape(-1, 3) ** 2).sum(axis=1).max())))


@kernel
def magnet_field(field: Array, currents: Array, per_ampere: Array, limit: float, out: Array, usable: Array) -> int:
    """out (k, 3) [T] = field − the coils' part; usable (k,) 1.0 or 0.0; returns how many sensors are usable.

    Not usable is what is not finite and what is longer than `limit` [T]; it becomes zero in `out`. A reading of zero
    may be true: between four magnets of a checkerboard there is no field.
    """
    read, rest = field.reshape(-1), out.reshape(-1)
    for r in range(rest.shape[0]):
        rest[r] = read[r]
    for j in range(currents.shape[0]):
        ampere = currents[j]
        for r in range(rest.shape[0]):
            rest[r] -= per_ampere[j, r] * ampere
    count = 0
    for k in range(field.shape[0]):
        square = field[k, 0] * field[k, 0] + field[k, 1] * field[k, 1] + field[k, 2] * field[k, 2]
        total = out[k, 0] + out[k, 1] + out[k, 2]
        # safety: readings-possible
        if square <= limit * limit and np.isfinite(total):  # NaN fails the first
            usable[k] = 1.0
            count += 1
        else:
            usable[k] = 0.0
            out[k, 0], out[k, 1], out[k, 2] = 0.0, 0.0, 0.0
    return count
