"""Heat, measured: one coil is warmed as the paper did it and left to cool, and two nodes explain what was read.

Its resistance tells the winding's temperature, so a small current stays on while it cools. Zárate 2020, Fig. 6: 30 %
duty for three minutes.

Six minutes are long for a computer that must never be silent for 15 ms. Where it was, and the firmware switched off for
that reason alone, the second is lost and the record goes on in the next: less heat went in, and that is written down.
The person has agreed to current in this coil for all of the step, with the tool away; any other trip ends it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from typing import final

import numpy as np

from haptorb.apps.calibrate.measure import DriverSession
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.errors import CalibrationError, HostSilent
from haptorb.numerics.arrays import Array
from haptorb.sensing.calibration.thermal_identification import ThermalIdentification, thermal_identification

__all__ = ["HEATING", "HeatingResult", "HeatingSchedule", "identify_heat"]

_RATE = 250.0  #: a firmware's watchdog waits 15 ms: three readings may come late, in six minutes [Hz]
_UNWATCHED = 100.0  #: nothing watches a simulation [Hz]
_BIN = 1.0  #: readings are averaged over this [s]
_MARGIN = 5.0  #: heating ends so far below the device's warning [K]
_COLD = 4.0  #: a coil that is warmer than the others by this is not cold [K]
_LOST = 0.2  #: share of the seconds that may be lost: with more, the record is one of this computer
_BREATH = 0.1  #: a pause lasts at least this [s]


@dataclass(frozen=True)
class HeatingSchedule:
    """How long and how strongly: duties [1] and seconds."""

    hot: float = 0.3
    heating: float = 180.0
    warm: float = 0.05
    cooling: float = 180.0

    @property
    def seconds(self) -> float:
        """From the first to the last reading."""
        return self.heating + self.cooling


HEATING = HeatingSchedule()


@dataclass(frozen=True)
class HeatingResult:
    """What was found, and how many seconds were lost because this computer hesitated."""

    found: ThermalIdentification
    lost: int


def identify_heat(
    session: DriverSession,
    device: SphericalElectromagnet,
    resistance: Array,
    course: HeatingSchedule = HEATING,
    coil: int = 0,
) -> HeatingResult:
    """The two nodes of `coil`, found over `course`; `resistance` (m,) [Ω] as it was when cold.

    Begin with a cold device: its first temperature is taken as the room's. Raises CalibrationError if it is not, if the
    record determines too little, or if more than a fifth of it was lost.
    """
    coils, rate = device.coils, _UNWATCHED if session.simulated else _RATE
    rest, _ = session.hold(np.zeros(device.channels), 0.2, rate=rate)
    cold = np.mean([sample.temperatures for sample in rest], axis=0)
    if cold[coil] - cold.min() > _COLD:
        raise CalibrationError(
            f"coil '{coils.names[coil]}' is {cold[coil] - cold.min():.0f} K warmer than the others: let it cool for "
            "ten minutes"
        )
    hot, cool = int(course.heating / _BIN), int(course.cooling / _BIN)
    hottest, start, ohms = coils.heat.warn - _MARGIN, session.now(), float(resistance[coil])
    duties, record = np.zeros(device.channels), _Record()
    n = lost = 0
    while n < hot + cool:
        duties[coil] = course.hot if n < hot else course.warm
        try:
            samples, applied = session.hold(duties, _BIN, 0.2 * _BIN, rate=rate)
        except HostSilent as cause:  # safety: silence-forgiven
            lost += 1
            if lost > _LOST * (hot + cool):  # safety: heating-end
                raise CalibrationError(
                    f"this computer was too busy: {lost} of {n + 1} s of readings are lost; close other programs, or "
                    "use another computer"
                ) from cause
            last = (duties[coil] * device.supply.voltage) ** 2 / ohms
            record.spend(min(max(session.now() - start, n * _BIN), (n + 1) * _BIN), last)
            after = _pause(session, device, start, n, rate)
            record.spend(after * _BIN, 0.0)
            lost, n = lost + after - n - 1, after
            continue
        current = float(np.mean([sample.currents[coil] for sample in samples]))
        edge = np.mean([sample.temperatures for sample in samples], axis=0)
        volts = abs(float(applied[coil])) * device.supply.voltage
        if abs(current) < 0.02:
            raise CalibrationError(
                f"coil '{coils.names[coil]}' carries no current during heating: is the device engaged?"
            )
        ohms = volts / abs(current)
        warm = cold[coil] + (ohms / resistance[coil] - 1) / coils.temperature_coefficient
        record.tell((n + 0.6) * _BIN, warm, edge[coil])  # readings are averaged over the last four fifths
        record.spend((n + 1) * _BIN, volts * abs(current))
        if edge[coil] > hottest and n < hot:
            hot = n + 1
        n += 1
    session.hold(np.zeros(device.channels), 0.02, rate=rate)
    return HeatingResult(
        thermal_identification(record.times, record.power(), record.winding, record.boundary, float(cold[coil])), lost
    )


@final
class _Record:
    """Temperatures [K] at times [s], and the heat [J] that went in since the beginning, at times of its own."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.winding: list[float] = []
        self.boundary: list[float] = []
        self._until, self._joules = [0.0], [0.0]

    def tell(self, t: float, winding: float, boundary: float) -> None:
        """One pair of temperatures."""
        self.times.append(t)
        self.winding.append(winding)
        self.boundary.append(float(boundary))

    def spend(self, until: float, watts: float) -> None:
        """So much power from the last such time until this one."""
        self._joules.append(self._joules[-1] + watts * (until - self._until[-1]))
        self._until.append(until)

    def power(self) -> Array:
        """(n,) mean power [W] from each of the times to the next, from the last to the end."""
        times = np.array([*self.times, self._until[-1]])
        mean: Array = np.diff(np.interp(times, self._until, self._joules)) / np.diff(times)
        return mean


def _pause(session: DriverSession, device: SphericalElectromagnet, start: float, second: int, rate: float) -> int:
    """Coils off until a second begins: which."""
    session.reengage()
    after = max(second + 1, ceil((session.now() - start + _BREATH) / _BIN))
    session.hold(np.zeros(device.channels), start + after * _BIN - session.now(), rate=rate)
    return after
