"""Does a coil carry what it was told to carry? Measured currents against those that the applied voltages must give.

A current sensor that reads nothing, a tenth or ten times as much makes everything behind it wrong: the heat that is
observed, the resistance that is learned, the limit that is kept. So the readings are compared with a model of the coil
that does not come from them: resistance at the observed winding temperature, inductance, applied voltage, induced
voltage. What remains of a difference after 10 ms of smoothing must stay small.

A supply that sags and a wire that was forgotten look like a little more resistance. That is learned, slowly, and
trusted up to a quarter: beyond it the sensor, or the coil, is not what the device file says.
"""

from __future__ import annotations

from typing import final

import numpy as np

from haptorb.devices.device import Device
from haptorb.numerics.arrays import Array, Records
from haptorb.numerics.compiled import kernel

__all__ = ["COIL", "CurrentCheck", "check_currents"]

_SMOOTH = 0.010  #: time constant of the residual [s]
_LEARN = 2.0  #: time constant of the resistance that is learned [s]
_SHARE_OF_LIMIT = 0.04  #: of the greatest current: what noise and offset of a sensor may be
_SHARE_OF_CURRENT = 0.10  #: of the present current: what gain of a sensor and resistance may be off at once
_SHARE_OF_CHANGE = 0.3  #: of the change per tick: what an unknown delay of the reading may be off
_TRUSTED = 0.1  #: of the greatest current, from which on the resistance is learned
_LOWEST, _HIGHEST = 0.75, 1.0 / 0.75  #: learned over expected resistance

#: of each coil. cold [Ω] at the reference temperature [K], coefficient [1/K], inductance [H], limit [A], voltage [V] of
#: the supply: as the device file says. ratio: learned over expected resistance. model: current at the last tick, before
#: and end: where the interval before it began and aimed at [A]; past: its length [s]. emf: induced voltage [V].
#: residual, level, change: smoothed difference, magnitude and change per tick [A]
COIL = np.dtype(
    [
        (name, "f8")
        for name in (
            *("cold", "reference", "coefficient", "inductance", "limit", "voltage", "ratio", "model", "before", "end"),
            *("past", "emf", "residual", "level", "change"),
        )
    ]
)


@kernel
def check_currents(
    coils: Records,
    elapsed: float,
    restart: bool,
    duties: Array,
    measured: Array,
    age: float,
    winding: Array,
    emf: Array,
) -> bool:
    """A tick `elapsed` [s] after the last: whether `measured` (m,) [A], `age` [s] old, match the `duties` (m,) since.

    coils (m,) COIL; winding (m,) [K] as observed; emf (m,) [V] induced from now on. restart: the device has switched
    off by itself meanwhile, and the comparison begins anew.
    """
    keep, slow = np.exp(-elapsed / _SMOOTH), np.exp(-elapsed / _LEARN)
    plausible = True
    for j in range(measured.size):
        c = coils[j]
        i = measured[j]
        if not np.isfinite(i):
            continue
        expected = c.cold * (1.0 + c.coefficient * (winding[j] - c.reference))
        resistance = expected * c.ratio
        rate = resistance / c.inductance if c.inductance > 0.0 else np.inf
        volts = duties[j] * c.voltage - c.emf
        end = volts / resistance
        now = end + (c.model - end) * np.exp(-rate * elapsed)
        if age <= elapsed:
            then = end + (c.model - end) * np.exp(-rate * (elapsed - max(age, 0.0)))
        else:
            then = c.end + (c.before - c.end) * np.exp(-rate * max(c.past - (age - elapsed), 0.0))
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
        if not (abs(c.residual) <= allowed and _LOWEST <= c.ratio <= _HIGHEST):
            plausible = False
        c.before, c.end, c.past = c.model, end, elapsed
        c.model = now
        c.emf = emf[j] if np.isfinite(emf[j]) else 0.0
    return plausible


@final
class CurrentCheck:
    """The memory of `check_currents` for the coils of `device`: nothing flows, resistances as the device file says."""

    def __init__(self, device: Device) -> None:
        coils = device.coils
        self.coils: Records = np.zeros(device.channels, dtype=COIL)  #: (m,)
        self.coils["cold"], self.coils["inductance"] = coils.resistance, coils.inductance
        self.coils["reference"], self.coils["coefficient"] = coils.reference_temperature, coils.temperature_coefficient
        self.coils["limit"], self.coils["voltage"] = coils.current_limit, device.supply.voltage
        self.coils["ratio"] = 1.0

    def restart(self) -> None:
        """A person engages: what was learned before may belong to a sensor that was repaired meanwhile."""
        self.coils["ratio"] = 1.0
        for name in ("residual", "level", "change"):
            self.coils[name] = 0.0
