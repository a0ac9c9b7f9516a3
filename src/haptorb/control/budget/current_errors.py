"""From wanted to true currents: what current sensors, windings, supply and steps make of them.

Above 2.5 % of its limit a coil's resistance is learned from the measured current, so that this current, and not the
true one, becomes the wanted one: errors of resistance and supply vanish, those of the current sensor remain. Below,
the resistance is taken from the device file, and it is the other way round.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from haptorb.control.budget.error_model import ErrorSource
from haptorb.control.protection.state import make_coils
from haptorb.devices.device import Device
from haptorb.devices.uncertainty.common import ChainUncertainty
from haptorb.display.quantity_text import format_quantity
from haptorb.numerics.arrays import Array

__all__ = ["ChainTrial", "CurrentLoop", "current_sources", "describe_share", "find_origin"]

_WINDOW = 100.0  #: ticks over which the learned resistance averages, at 1 kHz


@dataclass
class ChainTrial:
    """How the electronics differ from their model; all zeros: not at all."""

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
        """(m,) what the sensors say of true `currents` (m,) [A]."""
        read: Array = (1 + self.gain) * currents + self.offset
        return read


class CurrentLoop:
    """The loop that holds the currents of `device`."""

    def __init__(self, device: Device) -> None:
        self._learnable = np.array(make_coils(device)["learnable"])

    def true_currents(self, wanted: Array, trial: ChainTrial) -> Array:
        """(m,) [A] the currents that flow where `wanted` (m,) [A] are, after the loop has settled."""
        learned = np.abs(wanted) > self._learnable
        measured = (wanted - trial.offset) / (1 + trial.gain)
        driven = wanted * (1 + trial.supply) / (1 + trial.resistance)
        flowing: Array = np.where(learned, measured, driven) + trial.noise
        return flowing


C = TypeVar("C", bound=ChainTrial)


class CurrentGain(ErrorSource[C]):
    """Gains of the current sensors, each its own."""

    def __init__(self, standard: float, origin: str, channels: int) -> None:
        super().__init__("current sensors, gain", describe_share(standard), origin, channels)
        self._standard = standard

    def perturb(self, deviates: Array, trial: C) -> None:
        """Add to the gains."""
        trial.gain += self._standard * deviates


class CurrentOffset(ErrorSource[C]):
    """Offsets of the current sensors, each its own."""

    def __init__(self, standard: float, origin: str, channels: int) -> None:
        super().__init__("current sensors, offset", format_quantity(standard, "A"), origin, channels)
        self._standard = standard

    def perturb(self, deviates: Array, trial: C) -> None:
        """Add to the offsets."""
        trial.offset += self._standard * deviates


class Resistance(ErrorSource[C]):
    """Resistances of the windings, each its own."""

    def __init__(self, standard: float, origin: str, channels: int) -> None:
        super().__init__("resistance", describe_share(standard), origin, channels)
        self._standard = standard

    def perturb(self, deviates: Array, trial: C) -> None:
        """Add to the resistances."""
        trial.resistance += self._standard * deviates


class SupplyVoltage(ErrorSource[C]):
    """The voltage that all coils share."""

    def __init__(self, standard: float, origin: str) -> None:
        super().__init__("supply voltage", describe_share(standard), origin, 1)
        self._standard = standard

    def perturb(self, deviates: Array, trial: C) -> None:
        """Add to the voltage."""
        trial.supply += self._standard * float(deviates[0])


class CurrentSteps(ErrorSource[C]):
    """Steps of the duty cycle, and noise of the current readings that the learned resistance lets through."""

    def __init__(self, device: Device) -> None:
        supply = device.supply
        step = supply.voltage / device.coils.resistance / 2**supply.duty_bits
        read = np.hypot(supply.current_noise, supply.current_step / np.sqrt(12)) / np.sqrt(_WINDOW)
        self._standard: Array = np.hypot(step / np.sqrt(12), read)
        text = format_quantity(float(self._standard.max()), "A")
        super().__init__("quantisation and noise of the currents", text, "computed", device.channels)

    def perturb(self, deviates: Array, trial: C) -> None:
        """Add to the currents."""
        trial.noise += self._standard * deviates


def current_sources(device: Device, known: ChainUncertainty, offset: float) -> tuple[ErrorSource[C], ...]:
    """Those of every device; `offset` [A] of the current sensors."""
    m = device.channels
    return (
        CurrentGain(known.current_gain, find_origin(device, known, "current_gain"), m),
        CurrentOffset(offset, find_origin(device, known, "current_offset"), m),
        Resistance(known.resistance, find_origin(device, known, "resistance"), m),
        SupplyVoltage(known.supply, find_origin(device, known, "supply")),
        CurrentSteps(device),
    )


def find_origin(device: Device, known: ChainUncertainty, key: str, section: str = "uncertainty") -> str:
    """Where the value of `key` comes from: the device file, where it may be assumed, or the defaults of `known`."""
    if f"{section}.{key}" in device.assumed:
        return "assumed"
    return "device file" if section != "uncertainty" or known.is_stated(key) else "default"


def describe_share(share: float) -> str:
    """A relative uncertainty as text.

    >>> describe_share(0.012)
    '1.2 %'
    """
    return f"{100 * share:.3g} %"
