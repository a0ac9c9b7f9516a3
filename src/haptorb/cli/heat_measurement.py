"""Identification of the windings' heat capacities and conductances: coils heated in turn, as Zárate 2020, Fig. 6."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from typing import final

import numpy as np

from haptorb.arrays import Array
from haptorb.cli.calibration_measurement import DriverSession
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.errors import CalibrationError, HostSilent
from haptorb.estimation.heat_calibration import (
    HeatRecord,
    NetworkIdentification,
    ThermalIdentification,
    network_identification,
    thermal_identification,
)
from haptorb.thermal import resistance_ratio, winding_temperature

__all__ = ["HEATING", "HeatingResult", "HeatingSchedule", "identify_heat"]


# --------------------------------------------------------------------------------------------------
# Coils are heated in turn where they are thermally coupled, and all are observed while they cool.
#
# The winding's temperature follows from its resistance, so a small current stays on in every observed coil (Zárate
# 2020, Fig. 6: 30 % duty for three minutes).
#
# Within minutes this computer may once be silent for 15 ms. If the firmware switched off for that reason alone, that
# second is lost and the record continues with the next; the missing heat input is recorded.
# The person has agreed to current in the coils during the whole step, with the tool away; any other trip ends it.


_SAMPLE_RATE_HZ = 250.0  #: a firmware's watchdog waits 15 ms: three consecutive readings may be late
_SIMULATED_RATE_HZ = 100.0  #: a simulation has no watchdog
_BIN_S = 1.0  #: averaging window of the readings
_STOP_MARGIN_K = 5.0  #: heating ends this far below the device's warning temperature
_COLD_TOLERANCE_K = 4.0  #: permitted difference between cold coils
_MAX_LOST_SHARE = 0.2  #: permitted share of lost seconds: above it, the record is not representative
_NO_CURRENT_A = 0.02  #: below this a driven coil carries no current
_MAX_CURRENT_RATIO, _MAX_CURRENT_OFFSET_A = (
    1.5,
    0.3,
)  #: permitted deviation of the current; beyond it the coil does not switch
_NO_COIL = -1
_MIN_PAUSE_S = 0.1  #: least duration of a pause


@dataclass(frozen=True)
class HeatingSchedule:
    """Duties [1] and durations [s] of heating and cooling for each coil."""

    hot: float = 0.3
    heating: float = 180.0
    warm: float = 0.05
    cooling: float = 180.0

    def seconds(self, device: SphericalElectromagnet) -> float:
        """Return the time from the first to the last reading of `device` [s]: coupled coils are heated in turn."""
        heated = 1 if device.coils.heat.coupling is None else device.channels
        return heated * self.heating + self.cooling


HEATING = HeatingSchedule()


@dataclass(frozen=True)
class HeatingResult:
    """Identified heat parameters, and the seconds lost because this computer was late."""

    found: ThermalIdentification | NetworkIdentification
    lost: int


def identify_heat(
    session: DriverSession, device: SphericalElectromagnet, resistance: Array, course: HeatingSchedule = HEATING
) -> HeatingResult:
    """Identify the heat parameters of `device` over `course`; `resistance` (m,) [Ω] is that of the cold coils.

    Coupled coils are driven in turn while all are observed; of identical coils without coupling, only the first is
    driven. Begin with a cold device: its first temperature is taken as ambient. Raises CalibrationError if it is not
    cold, if a coil does not switch, if the record does not determine the parameters, or if more than a fifth of it was
    lost.
    """
    coils, rate = device.coils, _SIMULATED_RATE_HZ if session.simulated else _SAMPLE_RATE_HZ
    watched = list(range(device.channels if coils.heat.coupling is not None else 1))
    rest, _ = session.hold(np.zeros(device.channels), 0.2, rate=rate)
    cold = np.mean([sample.temperatures for sample in rest], axis=0)
    warmest = max(watched, key=lambda k: float(cold[k]))
    if cold[warmest] - cold.min() > _COLD_TOLERANCE_K:
        raise CalibrationError(
            f"coil '{coils.names[warmest]}' is {cold[warmest] - cold.min():.0f} K warmer than the others: let it cool "
            "for ten minutes"
        )
    hot, cool = int(course.heating / _BIN_S), int(course.cooling / _BIN_S)
    plan = [coil for coil in watched for _ in range(hot)] + [_NO_COIL] * cool  # coil driven in each second
    hottest, start, record = coils.heat.warn - _STOP_MARGIN_K, session.now(), _Record(len(watched))
    ohms = np.array(resistance, dtype=np.float64)
    at_reference = ohms / resistance_ratio(coils.temperature_coefficient, coils.reference_temperature, cold)
    n = lost = 0
    while n < len(plan):
        duties = np.zeros(device.channels)
        duties[watched] = course.warm
        if plan[n] != _NO_COIL:
            duties[plan[n]] = course.hot
        try:
            samples, applied = session.hold(duties, _BIN_S, 0.2 * _BIN_S, rate=rate)
        except HostSilent as cause:  # safety: silence-forgiven
            lost += 1
            if lost > _MAX_LOST_SHARE * len(plan):  # safety: heating-end
                raise CalibrationError(
                    f"this computer was too busy: {lost} of {n + 1} s of readings are lost; close other programs, or "
                    "use another computer"
                ) from cause
            last = (duties * device.supply.voltage) ** 2 / ohms
            record.append_power(min(max(session.now() - start, n * _BIN_S), (n + 1) * _BIN_S), last[watched])
            after = _pause(session, device, start, n, rate)
            record.append_power(after * _BIN_S, 0.0 * last[watched])
            lost, n = lost + after - n - 1, after
            continue
        currents = np.mean([sample.currents for sample in samples], axis=0)
        edge = np.mean([sample.temperatures for sample in samples], axis=0)
        volts = np.abs(applied) * device.supply.voltage
        _check_currents(device, np.abs(currents), volts / resistance, watched)
        ohms[watched] = volts[watched] / np.abs(currents[watched])
        warm = winding_temperature(coils.temperature_coefficient, coils.reference_temperature, ohms / at_reference)
        record.append(
            (n + 0.6) * _BIN_S, warm[watched], edge[watched]
        )  # readings are averaged over the last four fifths
        record.append_power((n + 1) * _BIN_S, (volts * np.abs(currents))[watched])
        if plan[n] != _NO_COIL and edge[plan[n]] > hottest:
            plan = plan[: n + 1] + [coil for coil in plan[n + 1 :] if coil != plan[n]]
        n += 1
    session.hold(np.zeros(device.channels), 0.02, rate=rate)
    whole = record.compose(float(cold[watched].mean()))
    if coils.heat.coupling is not None:
        return HeatingResult(network_identification(whole, coils.names, coils.heat), lost)
    power, winding, boundary = whole.power[:, 0], whole.winding[:, 0], whole.boundary[:, 0]
    return HeatingResult(thermal_identification(whole.t, power, winding, boundary, whole.ambient), lost)


def _check_currents(device: SphericalElectromagnet, currents: Array, expected: Array, watched: list[int]) -> None:
    """Raise CalibrationError unless measured `currents` (m,) [A] are close to the `expected` (m,) [A]."""
    for k, name in enumerate(device.coils.names):
        if k in watched and currents[k] < _NO_CURRENT_A:
            raise CalibrationError(f"coil '{name}' carries no current during heating: check that the device is engaged")
        if currents[k] > _MAX_CURRENT_RATIO * expected[k] + _MAX_CURRENT_OFFSET_A:
            raise CalibrationError(
                f"coil '{name}' carries {currents[k]:.1f} A where {expected[k]:.1f} A should flow: it does not switch. "
                "Switch off the coils' supply, and check the coil's bridge, its driver and its wiring"
            )


@final
class _Record:
    """Temperatures of some coils [K] over time [s], and the heat input of each [J] with its own time stamps."""

    def __init__(self, coils: int) -> None:
        self._times: list[float] = []
        self._winding: list[Array] = []
        self._boundary: list[Array] = []
        self._until, self._joules = [0.0], [np.zeros(coils)]

    def append(self, t: float, winding: Array, boundary: Array) -> None:
        """Append the temperatures of all coils (m,) [K] at time `t` [s]."""
        self._times.append(t)
        self._winding.append(winding)
        self._boundary.append(boundary)

    def append_power(self, until: float, watts: Array) -> None:
        """Append the power (m,) [W] between the last time stamp and `until` [s]."""
        self._joules.append(self._joules[-1] + watts * (until - self._until[-1]))
        self._until.append(until)

    def compose(self, ambient: float) -> HeatRecord:
        """Return the record with the mean power between consecutive temperature samples [W]."""
        times = np.array([*self._times, self._until[-1]])
        heat = np.array([np.interp(times, self._until, joules) for joules in np.transpose(self._joules)])
        power = np.diff(heat) / np.diff(times)
        return HeatRecord(times[:-1], power.T, np.array(self._winding), np.array(self._boundary), ambient)


def _pause(session: DriverSession, device: SphericalElectromagnet, start: float, second: int, rate: float) -> int:
    """Keep the coils off until the next full second; return its number."""
    session.reengage()
    after = max(second + 1, ceil((session.now() - start + _MIN_PAUSE_S) / _BIN_S))
    session.hold(np.zeros(device.channels), start + after * _BIN_S - session.now(), rate=rate)
    return after
