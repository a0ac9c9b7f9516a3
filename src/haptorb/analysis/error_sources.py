"""Error sources common to all kinds of devices: current control, magnets and field sensors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy.special import ndtr

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
    "Effect",
    "MagnetTrial",
    "SensorTrial",
    "add_to",
    "current_sources",
    "describe_share",
    "find_origin",
    "magnet_warmth",
    "multiply",
    "sensor_sources",
    "source",
    "spread_evenly",
    "strengthen",
]


# --------------------------------------------------------------------------------------------------
# Rows of a table of sources: the effect on a trial of an amount, the standard uncertainty times deviates.


Effect = Callable[[Any, Array], None]  #: changes a trial by an amount, of the shape of the standard uncertainty


def source(
    name: str, standard: float | Array, unit: str, origin: str, dimension: int, effect: Effect, *, evenly: bool = False
) -> ErrorSource[Any]:
    """Create a source of error with an `effect` on a trial; evenly: uniform within √3 of the `standard` uncertainty.

    unit: SI unit of `standard`, "1" for a relative one, "rad" for an angle in degrees, or the text to print. An array
    (dimension,) has one standard uncertainty for each deviate, in that unit [SI].
    """
    shape = np.shape(standard) or (dimension,)

    def perturb(deviates: Array, trial: Any) -> None:
        drawn = spread_evenly(deviates) if evenly else deviates
        effect(trial, standard * drawn.reshape(shape))

    largest = float(np.max(standard))
    match unit:
        case "1":
            text = describe_share(largest)
        case "rad":
            text = f"{np.degrees(largest):.3g}°"
        case "A" | "T" | "m":
            text = format_quantity(largest, unit)
        case _:
            text = unit
    return ErrorSource(name, text, origin, dimension, perturb)


def add_to(field: str) -> Effect:
    """Effect that adds the amount to a `field` of the trial, a number or an array; "built.core": that of its part."""
    *parts, name = field.split(".")

    def add(trial: Any, amount: Array) -> None:
        for part in parts:
            trial = getattr(trial, part)
        before = getattr(trial, name)
        if isinstance(before, float):
            setattr(trial, name, before + float(amount[0]))
        else:
            before += amount.reshape(before.shape)

    return add


def multiply(field: str) -> Effect:
    """Effect that multiplies a `field` of the trial by 1 plus the amount."""

    def change(trial: Any, amount: Array) -> None:
        before = getattr(trial, field)
        before *= 1.0 + amount

    return change


def spread_evenly(deviates: Array) -> Array:
    """Uniform deviates from −√3 to √3, of standard deviation 1, from normal `deviates` (...) [1]."""
    found: Array = np.sqrt(3.0) * (2.0 * ndtr(deviates) - 1.0)
    return found


# --------------------------------------------------------------------------------------------------
# Error propagation from commanded to actual current: current sensors, windings, supply and quantisation.
#
# Above 2.5 % of its limit a coil's resistance is estimated from the measured current, so that this current, not the
# true one, follows the command: errors of resistance and supply vanish, those of the current sensor remain. Below, the
# resistance is that of the device file, and the opposite holds.


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


def current_sources(device: Device, known: ChainUncertainty, offset: float) -> tuple[ErrorSource[Any], ...]:
    """Current sources of every device; `offset` [A] of the current sensors."""
    m, supply = device.channels, device.supply
    step = supply.voltage / device.coils.resistance / 2**supply.duty_bits
    read = np.hypot(supply.current_noise, supply.current_step / np.sqrt(12)) / np.sqrt(_AVERAGING_TICKS)
    noise: Array = np.hypot(step / np.sqrt(12), read)  # of the duty cycle, and what the estimated resistance passes

    def origin(key: str) -> str:
        return find_origin(device, known, key)

    return (
        source("current sensors, gain", known.current_gain, "1", origin("current_gain"), m, add_to("gain")),
        source("current sensors, offset", offset, "A", origin("current_offset"), m, add_to("offset")),
        source("resistance", known.resistance, "1", origin("resistance"), m, add_to("resistance")),
        source("supply voltage", known.supply, "1", origin("supply"), 1, add_to("supply")),
        source("quantisation and noise of the currents", noise, "A", "computed", m, add_to("noise")),
    )


def find_origin(device: Device, known: ChainUncertainty, key: str, section: str = "uncertainty") -> str:
    """Origin of the value of `key`: the device file, where it may be assumed, or the defaults of `known`."""
    if f"{section}.{key}" in device.assumed:
        return "assumed"
    return "device file" if section != "uncertainty" or known.is_stated(key) else "default"


def describe_share(share: float) -> str:
    """Format a relative uncertainty.

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


def strengthen(trial: MagnetTrial, relative: Array) -> None:
    """Change the strength common to all magnets by `relative` (1,), or that of each by its own (p,) [1]."""
    trial.strengthen(1 + relative)


def magnet_warmth(name: str, device: Device, known: ChainUncertainty) -> ErrorSource[Any]:
    """Temperature common to all magnets of the mover, in a hand and over warm coils."""
    kelvin = known.magnet_temperature
    origin, relative = find_origin(device, known, "magnet_temperature"), kelvin * known.remanence_drift
    return source(name, relative, f"{kelvin:.3g} K", origin, 1, strengthen)


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


def mix_axes(*, across: bool) -> Effect:
    """Effect on the gain of each field sensor's axes, or on its cross-axis sensitivity."""
    rows, columns = np.nonzero(np.eye(3) != across)

    def change(trial: SensorTrial, amount: Array) -> None:
        trial.mixing[:, rows, columns] += amount.reshape(len(trial.mixing), -1)

    return change


def turn_sensors(trial: SensorTrial, angles: Array) -> None:
    """Rotate each field sensor about its axes by small `angles` (3 k,) [rad]."""
    x, y, z = angles.reshape(-1, 3).T
    for row, column, angle in ((0, 1, -z), (0, 2, y), (1, 2, -x)):
        trial.mixing[:, row, column] += angle
        trial.mixing[:, column, row] -= angle


def sensor_sources(device: Device, hall: FieldSensors, section: str, averaged: float) -> tuple[ErrorSource[Any], ...]:
    """Sources of the field sensors `hall` of `device` except their positions; the device file has them in `section`.

    The estimator averages their noise over `averaged` readings. All are at the temperature of their calibration.
    """
    errors, k = hall.errors, len(hall.positions)

    def origin(key: str) -> str:
        return "assumed" if f"{section}.{key}" in device.assumed else "device file"

    noise = float(np.hypot(hall.noise, hall.step / np.sqrt(12)) / np.sqrt(averaged))
    angle = f"{np.degrees(errors.angle):.2g}°"
    return (
        source("field sensors, gain", errors.gain, "1", origin("gain"), 3 * k, mix_axes(across=False)),
        source("field sensors, cross-axis", errors.cross, "1", origin("cross"), 6 * k, mix_axes(across=True)),
        source("field sensors, offset", errors.offset, "T", origin("offset"), 3 * k, add_to("reading")),
        source("field sensors, noise", noise, "T", origin("noise"), 3 * k, add_to("reading")),
        source("field sensors, angle", errors.angle, angle, origin("angle"), 3 * k, turn_sensors),
    )
