"""Heat, measured: one coil is warmed as the paper did it and left to cool, and two nodes explain what was read.

Its resistance tells the winding's temperature, so a small current stays on while it cools. Zárate 2020, Fig. 6: 30 %
duty for three minutes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptorb.apps.calibrate.measure import Session
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.errors import CalibrationError
from haptorb.physics.arrays import Array
from haptorb.sensing.thermal_identification import ThermalIdentification, thermal_identification

__all__ = ["HEATING", "Course", "heated"]

_RATE = 250.0  #: a firmware's watchdog waits 15 ms: three readings may come late, in six minutes [Hz]
_UNWATCHED = 100.0  #: nothing watches a simulation [Hz]
_BIN = 1.0  #: readings are averaged over this [s]
_MARGIN = 5.0  #: heating ends so far below the device's warning [K]
_COLD = 4.0  #: a coil that is warmer than the others by this is not cold [K]


@dataclass(frozen=True)
class Course:
    """How long and how strongly: duties [1] and seconds."""

    hot: float = 0.3
    heating: float = 180.0
    warm: float = 0.05
    cooling: float = 180.0

    @property
    def seconds(self) -> float:
        """From the first to the last reading."""
        return self.heating + self.cooling


HEATING = Course()


def heated(
    session: Session, device: SphericalElectromagnet, resistance: Array, course: Course = HEATING, coil: int = 0
) -> ThermalIdentification:
    """The two nodes of `coil`, found over `course`; `resistance` (m,) [Ω] as it was when cold.

    Begin with a cold device: its first temperature is taken as the room's. Raises CalibrationError if it is not, or if
    the record determines too little.
    """
    coils, rate = device.coils, _UNWATCHED if session.simulated else _RATE
    rest, _ = session.held(np.zeros(device.channels), 0.2, rate=rate)
    cold = np.mean([sample.temperatures for sample in rest], axis=0)
    if cold[coil] - cold.min() > _COLD:
        raise CalibrationError(
            f"coil '{coils.names[coil]}' is {cold[coil] - cold.min():.0f} K warmer than the others: let it cool for "
            "ten minutes"
        )
    hot, hottest = int(course.heating / _BIN), coils.heat.warn - _MARGIN
    times, power, winding, boundary = [], [], [], []
    duties = np.zeros(device.channels)
    for n in range(hot + int(course.cooling / _BIN)):
        duties[coil] = course.hot if n < hot else course.warm
        samples, applied = session.held(duties, _BIN, 0.2 * _BIN, rate=rate)
        current = float(np.mean([sample.currents[coil] for sample in samples]))
        edge = float(np.mean([sample.temperatures[coil] for sample in samples]))
        volts = abs(float(applied[coil])) * device.supply.voltage
        if abs(current) < 0.02:
            raise CalibrationError(f"coil '{coils.names[coil]}' carries no current while it is heated: is it engaged?")
        warm = cold[coil] + (volts / abs(current) / resistance[coil] - 1) / coils.temperature_coefficient
        times.append((n + 0.6) * _BIN)
        power.append(volts * abs(current))
        winding.append(warm)
        boundary.append(edge)
        if edge > hottest and n < hot:
            hot = n + 1
    session.held(np.zeros(device.channels), 0.02, rate=rate)
    return thermal_identification(times, power, winding, boundary, float(cold[coil]))
