"""Does a coil carry its set current? Measured currents against those that the applied voltages must give.

A current sensor that reads nothing, a tenth or ten times as much makes everything behind it wrong: the heat that is
observed, the resistance that is learned, the limit that is kept. So the readings are compared with a model of the coil
that does not come from them: resistance at the observed winding temperature, inductance, applied voltage, induced
voltage. What remains of a difference after 10 ms of smoothing must stay small.

A supply that sags and a wire that was forgotten look like a little more resistance. That is learned, slowly, and
trusted up to a quarter: beyond it the sensor, or the coil, is not what the device file says.
"""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Record, Records
from haptorb.numerics.compiled import kernel

__all__ = ["check_currents"]

_SMOOTH = 0.010  #: time constant of the residual [s]
_LEARN = 2.0  #: time constant of the resistance that is learned [s]
_SHARE_OF_LIMIT = 0.04  #: of the greatest current: what noise and offset of a sensor may be
_SHARE_OF_CURRENT = 0.10  #: of the present current: what gain of a sensor and resistance may be off at once
_SHARE_OF_CHANGE = 0.3  #: of the change per tick: what an unknown delay of the reading may be off
_TRUSTED = 0.1  #: of the greatest current, from which on the resistance is learned
_LOWEST, _HIGHEST = 0.75, 1.0 / 0.75  #: learned over expected resistance


@kernel
def check_currents(clock: Record, coils: Records, age: float) -> bool:
    """Whether the currents measured in this tick, `age` [s] old, match the duties applied since the last one.

    clock is a CLOCK, after a restart of which the comparison restarts; of `coils` (m,) current, applied, emf (from
    now on) and winding are read.
    """
    elapsed, restart = clock.elapsed, clock.restart
    keep, slow = np.exp(-elapsed / _SMOOTH), np.exp(-elapsed / _LEARN)
    plausible = True
    for j in range(coils.size):
        c = coils[j]
        i = c.current
        if not np.isfinite(i):
            continue
        expected = c.cold * (1.0 + c.coefficient * (c.winding - c.reference))
        resistance = expected * c.ratio
        rate = resistance / c.inductance if c.inductance > 0.0 else np.inf
        volts = c.applied * c.voltage - c.model_emf
        end = volts / resistance
        now = end + (c.model - end) * np.exp(-rate * elapsed)
        if age <= elapsed:
            then = end + (c.model - end) * np.exp(-rate * (elapsed - max(age, 0.0)))
        else:
            since = max(c.model_time - (age - elapsed), 0.0)
            then = c.model_end + (c.model_before - c.model_end) * np.exp(-rate * since)
        if restart or not np.isfinite(now + then):
            c.residual = c.level = c.change = 0.0
            now = end = then = i
        c.residual = keep * c.residual + (1.0 - keep) * (i - then)
        c.level = keep * c.level + (1.0 - keep) * abs(now)
        c.change = keep * c.change + (1.0 - keep) * abs(now - c.model)
        if abs(i) > _TRUSTED * c.limit and abs(now - end) < 0.05 * abs(end) and abs(then - end) < 0.05 * abs(end):
            ratio = min(max(volts / (i * expected), 0.0), 4.0)
            c.ratio = slow * c.ratio + (1.0 - slow) * ratio
        allowed = _SHARE_OF_LIMIT * c.limit + _SHARE_OF_CURRENT * c.level + _SHARE_OF_CHANGE * c.change
        if not (abs(c.residual) <= allowed and _LOWEST <= c.ratio <= _HIGHEST):  # safety: low-sensor-is-found
            plausible = False
        c.model_before, c.model_end, c.model_time = c.model, end, elapsed
        c.model = now
        c.model_emf = c.emf if np.isfinite(c.emf) else 0.0
    return plausible
