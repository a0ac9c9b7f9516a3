"""What cards have in common, so that devices stand side by side: quantities by name, and curves by panel."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from haptorb.devices.device import Device
from haptorb.devices.endurance import endurance
from haptorb.display.quantity_text import format_number
from haptorb.numerics.arrays import Array

__all__ = ["Curve", "Quantity", "common_curves", "common_quantities"]


@dataclass(frozen=True)
class Quantity:
    """One line of a comparison: what it is, in which unit, and its value for one device."""

    name: str
    unit: str
    value: float

    @property
    def text(self) -> str:
        """The value with three digits.

        >>> Quantity("peak", "mN", 958.71).text, Quantity("endurance", "s", float("inf")).text
        ('959', 'unlimited')
        """
        return "unlimited" if self.value == math.inf else format_number(self.value)

    @property
    def head(self) -> str:
        """Name and unit.

        >>> Quantity("peak", "mN", 958.71).head
        'peak [mN]'
        """
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True)
class Curve:
    """A line in the panel of that title; devices that have a curve of the same panel and label are drawn over another.

    style   dashes as matplotlib writes them: they tell the label, as colours tell the device
    """

    panel: str
    label: str
    x_label: str
    y_label: str
    x: Sequence[float] | Array
    y: Sequence[float] | Array
    style: str = "-"


def common_quantities(device: Device) -> list[Quantity]:
    """What every device has."""
    coils, limits = device.coils, device.limits
    loads = endurance(device, (1.0, 0.5))
    return [
        Quantity("channels", "", device.channels),
        Quantity("peak current", "A", float(coils.current_limit.max())),
        Quantity("continuous current", "A", float(device.sustained_current.min())),
        Quantity("continuous current, all coils warm", "A", float(device.sustained_current_together.min())),
        Quantity("resistance, least", "Ω", float(coils.resistance.min())),
        Quantity("resistance, greatest", "Ω", float(coils.resistance.max())),
        Quantity("inductance, greatest", "mH", 1e3 * float(coils.inductance.max())),
        Quantity("supply", "V", device.supply.voltage),
        Quantity("supply's power", "W", device.supply.power),
        Quantity("force limit of the guard", "N", limits.force),
        Quantity("torque limit of the guard", "mN·m", 1e3 * limits.torque),
        Quantity("slew limit", "A/ms", 1e-3 * limits.slew),
        Quantity("field sensors", "", device.sensors),
        *(Quantity(f"endurance at {100 * share:.0f} % current", "s", seconds) for share, seconds in loads),
    ]


def common_curves(device: Device) -> list[Curve]:
    """Endurance over current: every device has it."""
    shares = [1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.25, 0.2]
    loads = [(100 * share, seconds) for share, seconds in endurance(device, tuple(shares)) if math.isfinite(seconds)]
    share, seconds = zip(*loads, strict=True) if loads else ((), ())
    return [
        Curve("Endurance of one channel from room temperature", "until derating", "share of full current [%]",
              "time [s]", share, seconds),
    ]  # fmt: skip
