"""Error sources common to all kinds of devices: current control, magnets and field sensors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from haptorb.analysis.error_budget import ErrorSource
from haptorb.arrays import Array
from haptorb.control.guard import make_coils
from haptorb.devices.base import Device
from haptorb.devices.field_sensors import FieldSensors
from haptorb.devices.uncertainty import ChainUncertainty
from haptorb.display import format_quantity

__all__ = [
    "ChainTrial",
    "CurrentLoop",
    "MagnetStrength",
    "MagnetTrial",
    "SensorPlacement",
    "SensorTrial",
    "current_sources",
    "describe_share",
    "find_origin",
    "magnet_warmth",
    "sensor_sources",
]


# --------------------------------------------------------------------------------------------------
# Error propagation from commanded to actual current: current sensors, windings, supply and quantisation.
#
# Above 2.5 % of its limit a coil's resistance is estimated from the measured current, so that this current, not the
# true one, follows the command: errors of resistance and supply vanish, those of the current sensor remain. Below, the
# resistance is that of the device file, and the opposite is the case.


_AVERAGING_TICKS = 100.0  #: ticks over which the estimated resistance averages, at 1 kHz


@dataclass
class ChainTrial:
    """Deviations of the electronics from their model; all zeros: none."""

    gain: Array  #: (m,) of the current sensors, relative
    offset: Array  #: (m,) of the current sensors [A]
    resistance: Array  #: (m,) relative
    supply: float  #: relative
    noise: Array  #: (m,) of the current itself [A]

    @classmethod
    def exact(cls, channels: int) -> ChainTrial:
        """No error."""
        zero = np.zeros(channels)
        return cls(zero.copy(), zero.copy(), zero.copy(), 0.0, zero.copy())

    def read_currents(self, currents: Array) -> Array:
        """(m,) sensor readings of true `currents` (m,) [A]."""
        read: Array = (1 + self.gain) * currents + self.offset
        return read


class CurrentLoop:
    """Current control of `device`."""

    def __init__(self, device: Device) -> None:
        self._learnable = np.array(make_coils(device)["learnable"])

    def true_currents(self, wanted: Array, trial: ChainTrial) -> Array:
        """(m,) [A] steady-state currents for the commanded `wanted` (m,) [A]."""
        learned = np.abs(wanted) > self._learnable
        measured = (wanted - trial.offset) / (1 + trial.gain)
        driven = wanted * (1 + trial.supply) / (1 + trial.resistance)
        flowing: Array = np.where(learned, measured, driven) + trial.noise
        return flowing


C = TypeVar("C", bound=ChainTrial)


class CurrentGain(ErrorSource[C]):
    """Gains of the current sensors, independent."""

    def __init__(self, standard: float, origin: str, channels: int) -> None:
        super().__init__("current sensors, gain", describe_share(standard), origin, channels)
        self._standard = standard

    def perturb(self, deviates: Array, trial: C) -> None:
        """Add to the gains."""
        trial.gain += self._standard * deviates


class CurrentOffset(ErrorSource[C]):
    """Offsets of the current sensors, independent."""

    def __init__(self, standard: float, origin: str, channels: int) -> None:
        super().__init__("current sensors, offset", format_quantity(standard, "A"), origin, channels)
        self._standard = standard

    def perturb(self, deviates: Array, trial: C) -> None:
        """Add to the offsets."""
        trial.offset += self._standard * deviates


class Resistance(ErrorSource[C]):
    """Resistances of the windings, independent."""

    def __init__(self, standard: float, origin: str, channels: int) -> None:
        super().__init__("resistance", describe_share(standard), origin, channels)
        self._standard = standard

    def perturb(self, deviates: Array, trial: C) -> None:
        """Add to the resistances."""
        trial.resistance += self._standard * deviates


class SupplyVoltage(ErrorSource[C]):
    """Supply voltage, common to all coils."""

    def __init__(self, standard: float, origin: str) -> None:
        super().__init__("supply voltage", describe_share(standard), origin, 1)
        self._standard = standard

    def perturb(self, deviates: Array, trial: C) -> None:
        """Add to the voltage."""
        trial.supply += self._standard * float(deviates[0])


class CurrentSteps(ErrorSource[C]):
    """Quantisation of the duty cycle, and noise of the current readings that the estimated resistance passes."""

    def __init__(self, device: Device) -> None:
        supply = device.supply
        step = supply.voltage / device.coils.resistance / 2**supply.duty_bits
        read = np.hypot(supply.current_noise, supply.current_step / np.sqrt(12)) / np.sqrt(_AVERAGING_TICKS)
        self._standard: Array = np.hypot(step / np.sqrt(12), read)
        text = format_quantity(float(self._standard.max()), "A")
        super().__init__("quantisation and noise of the currents", text, "computed", device.channels)

    def perturb(self, deviates: Array, trial: C) -> None:
        """Add to the currents."""
        trial.noise += self._standard * deviates


def current_sources(device: Device, known: ChainUncertainty, offset: float) -> tuple[ErrorSource[C], ...]:
    """Current sources of every device; `offset` [A] of the current sensors."""
    m = device.channels
    return (
        CurrentGain(known.current_gain, find_origin(device, known, "current_gain"), m),
        CurrentOffset(offset, find_origin(device, known, "current_offset"), m),
        Resistance(known.resistance, find_origin(device, known, "resistance"), m),
        SupplyVoltage(known.supply, find_origin(device, known, "supply")),
        CurrentSteps(device),
    )


def find_origin(device: Device, known: ChainUncertainty, key: str, section: str = "uncertainty") -> str:
    """Origin of the value of `key`: the device file, where it may be assumed, or the defaults of `known`."""
    if f"{section}.{key}" in device.assumed:
        return "assumed"
    return "device file" if section != "uncertainty" or known.is_stated(key) else "default"


def describe_share(share: float) -> str:
    """A relative uncertainty as text.

    >>> describe_share(0.012)
    '1.2 %'
    """
    return f"{100 * share:.3g} %"


# --------------------------------------------------------------------------------------------------
# Strength of the mover's magnets: relative error common to all, individual, or by temperature.


class MagnetTrial(Protocol):
    """Device with magnets in its mover."""

    def strengthen(self, factors: Array) -> None:
        """Multiply the strength of all magnets by `factors` (1,), or that of each by its own (p,)."""


M = TypeVar("M", bound=MagnetTrial)


class MagnetStrength(ErrorSource[M]):
    """Strength common to all magnets, or with several deviates that of each; `relative` standard uncertainty."""

    def __init__(self, name: str, relative: float, origin: str, magnets: int = 1, text: str = "") -> None:
        super().__init__(name, text or describe_share(relative), origin, magnets)
        self._relative = relative

    def perturb(self, deviates: Array, trial: M) -> None:
        """Change the strength of `trial` by the `deviates` (1,) [1]."""
        trial.strengthen(1 + self._relative * deviates)


def magnet_warmth(name: str, device: Device, known: ChainUncertainty) -> MagnetStrength[M]:
    """Temperature common to all magnets of the mover, in a hand and over warm coils."""
    kelvin = known.magnet_temperature
    origin = find_origin(device, known, "magnet_temperature")
    return MagnetStrength(name, kelvin * known.remanence_drift, origin, text=f"{kelvin:.3g} K")


# --------------------------------------------------------------------------------------------------
# Errors of the field sensors: gain, cross-axis, offset, noise and position, independent for each sensor.


@dataclass
class SensorTrial(ChainTrial):
    """Deviations of the field sensors and the electronics of one device from ideal ones; zeros: none."""

    mixing: Array  #: (k, 3, 3) gain error and cross-axis sensitivity, along their own axes
    reading: Array  #: (k, 3) reading at zero field [T]
    placement: Array  #: (k, 3) displacement from the nominal positions [m]

    def read_field(self, field: Array, frames: Array | None = None) -> Array:
        """(k, 3) readings [T] of a true `field` (k, 3) [T]; columns of frames (k, 3, 3) are the sensors' own axes."""
        own = field if frames is None else np.einsum("kji,kj->ki", frames, field)
        own = own + np.einsum("kij,kj->ki", self.mixing, own) + self.reading
        read: Array = own if frames is None else np.einsum("kij,kj->ki", frames, own)
        return read


S = TypeVar("S", bound=SensorTrial)


class SensorMixing(ErrorSource[S]):
    """Gain of each field sensor's axes, or its cross-axis sensitivity."""

    def __init__(self, name: str, standard: float, origin: str, sensors: int, *, across: bool) -> None:
        super().__init__(name, describe_share(standard), origin, sensors * (6 if across else 3))
        self._standard, self._where = standard, np.nonzero(np.eye(3) != across)

    def perturb(self, deviates: Array, trial: S) -> None:
        """Add to gain and cross-axis sensitivity."""
        rows, columns = self._where
        trial.mixing[:, rows, columns] += self._standard * deviates.reshape(len(trial.mixing), -1)


class SensorReading(ErrorSource[S]):
    """Reading of each axis of the field sensors at zero field: its offset, or its noise."""

    def __init__(self, name: str, standard: float, origin: str, sensors: int) -> None:
        super().__init__(name, format_quantity(standard, "T"), origin, 3 * sensors)
        self._standard = standard

    def perturb(self, deviates: Array, trial: S) -> None:
        """Add to the readings."""
        trial.reading += self._standard * deviates.reshape(-1, 3)


class SensorAngle(ErrorSource[S]):
    """Rotation of each field sensor about its axes."""

    def __init__(self, standard: float, origin: str, sensors: int) -> None:
        super().__init__("field sensors, angle", f"{np.degrees(standard):.2g}°", origin, 3 * sensors)
        self._standard = standard

    def perturb(self, deviates: Array, trial: S) -> None:
        """Rotate the sensors, by small angles."""
        x, y, z = self._standard * deviates.reshape(-1, 3).T
        for row, column, angle in ((0, 1, -z), (0, 2, y), (1, 2, -x)):
            trial.mixing[:, row, column] += angle
            trial.mixing[:, column, row] -= angle


class SensorPlacement(ErrorSource[S]):
    """Position of each field sensor."""

    def __init__(self, standard: float, origin: str, sensors: int) -> None:
        super().__init__("field sensors, position", format_quantity(standard, "m"), origin, 3 * sensors)
        self._standard = standard

    def perturb(self, deviates: Array, trial: S) -> None:
        """Move the sensors of `trial`, by `deviates` (3 k,) [1] times the standard uncertainty."""
        trial.placement += self._standard * deviates.reshape(-1, 3)


def sensor_sources(device: Device, hall: FieldSensors, section: str, averaged: float) -> tuple[ErrorSource[S], ...]:
    """Sources of the field sensors `hall` of `device` except their positions; the device file has them in `section`.

    The estimator averages their noise over so many readings. All are at the temperature of their calibration.
    """
    errors, count = hall.errors, len(hall.positions)

    def origin(key: str) -> str:
        return "assumed" if f"{section}.{key}" in device.assumed else "device file"

    noise = float(np.hypot(hall.noise, hall.step / np.sqrt(12)) / np.sqrt(averaged))
    return (
        SensorMixing("field sensors, gain", errors.gain, origin("gain"), count, across=False),
        SensorMixing("field sensors, cross-axis", errors.cross, origin("cross"), count, across=True),
        SensorReading("field sensors, offset", errors.offset, origin("offset"), count),
        SensorReading("field sensors, noise", noise, origin("noise"), count),
        SensorAngle(errors.angle, origin("angle"), count),
    )
