"""Base of the capability cards of all kinds of devices."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from haptorb.arrays import Array
from haptorb.devices.base import Device, endurance
from haptorb.devices.build_checks import BuildCheck, format_bound
from haptorb.display import format_number
from haptorb.notebook import NotebookReport
from haptorb.terminal import Column, TextTable, print_facts, print_table, print_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Card", "Curve", "Quantity", "common_curves", "common_quantities", "facts", "print_card"]


@dataclass(frozen=True)
class Quantity:
    """One quantity of a device.

    Parameters
    ----------
    name : str
        Name of the quantity.
    unit : str
        Its unit; empty: none.
    value : float
        Its value, in that unit.
    """

    name: str
    unit: str
    value: float

    @property
    def text(self) -> str:
        """Format the value with three digits.

        >>> Quantity("peak", "mN", 958.71).text, Quantity("endurance", "s", float("inf")).text
        ('959', 'unlimited')
        """
        return "unlimited" if self.value == math.inf else format_number(self.value)

    @property
    def head(self) -> str:
        """Format name and unit.

        >>> Quantity("peak", "mN", 958.71).head
        'peak [mN]'
        """
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True)
class Curve:
    """One curve of a capability card; curves of several devices with the same panel and label share axes.

    Parameters
    ----------
    panel : str
        Title of the panel.
    label : str
        Name of the curve in it.
    x_label : str
        Quantity and unit of the horizontal axis.
    y_label : str
        Quantity and unit of the vertical axis.
    x : sequence of float
        Values on the horizontal axis, in its unit.
    y : sequence of float
        Values on the vertical axis, in its unit.
    style : str
        Line style of matplotlib: it distinguishes labels, as colours distinguish devices.
    """

    panel: str
    label: str
    x_label: str
    y_label: str
    x: Sequence[float] | Array
    y: Sequence[float] | Array
    style: str = "-"


def common_quantities(device: Device) -> list[Quantity]:
    """Return the quantities that every device has."""
    coils, limits = device.coils, device.limits
    loads = endurance(device, (1.0, 0.5))
    return [
        Quantity("channels", "", device.channels),
        Quantity("peak current", "A", float(device.driven_current.max())),
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
    """Return endurance over current, the curve that every device has."""
    shares = [1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.25, 0.2]
    loads = [(100 * share, seconds) for share, seconds in endurance(device, tuple(shares)) if math.isfinite(seconds)]
    share, seconds = zip(*loads, strict=True) if loads else ((), ())
    return [
        Curve("Endurance of one channel from room temperature", "until derating", "share of full current [%]",
              "time [s]", share, seconds),
    ]  # fmt: skip


class Card(NotebookReport, ABC):
    """Base class of the capability cards."""

    _device: Device

    @property
    def device(self) -> Device:
        """The device whose card this is."""
        return self._device

    @abstractmethod
    def quantities(self) -> list[Quantity]:
        """Return the card's quantities for a comparison with other devices, in order."""

    @abstractmethod
    def curves(self) -> list[Curve]:
        """Return the card's curves for a comparison with other devices."""

    @abstractmethod
    def numbers(self) -> dict[str, Any]:
        """Return everything on the card as plain JSON types, SI units in the keys."""

    @abstractmethod
    def show(self, console: Console) -> None:
        """Print the card on `console`."""

    def _summarize(self) -> str:
        return f"<{type(self).__name__} of {self._device.name}: {self._device.title}>"

    @abstractmethod
    def draw(self) -> Figure:
        """Return the card as a figure."""


def facts(device: Device) -> dict[str, Any]:
    """Return the data that every device has, as plain JSON types."""
    coils, inheritance = device.coils, None if device.text is None else device.text.inheritance
    return {
        "name": device.name,
        "title": device.title,
        "source": device.source,
        "digest": device.digest,
        "channels": list(coils.names),
        "current_limit_a": coils.current_limit.tolist(),
        "sustained_current_a": device.sustained_current.tolist(),
        "sustained_current_all_warm_a": device.sustained_current_together.tolist(),
        "resistance_ohm": coils.resistance.tolist(),
        "supply_v": device.supply.voltage,
        "supply_w": device.supply.power if np.isfinite(device.supply.power) else None,
        "limits": {
            "force_n": device.limits.force,
            "torque_nm": device.limits.torque,
            "slew_a_per_s": device.limits.slew,
            "expiry_s": device.limits.expiry,
            "force_rate_n_per_s": device.limits.force_rate,
            "torque_rate_nm_per_s": device.limits.torque_rate,
        },
        "inherited": None
        if inheritance is None
        else {"from": inheritance.base, "own": list(inheritance.own), "dropped": list(inheritance.dropped)},
        "build_checks": [
            {
                "condition": check.condition,
                "of": check.name,
                "unit": check.unit,
                "value": check.value,
                "limit": check.limit,
                "margin": check.margin,
                "holds": check.holds,
                "note": check.note,
            }
            for check in device.build_checks
        ],
        "remarks": list(device.remarks),
        "assumed": dict(device.assumed),
    }


def print_card(device: Device, console: Console, more: Iterable[tuple[str, str]]) -> None:
    """Print the top of the card: title, limits, and `more` facts (name, text)."""
    coils, limits = device.coils, device.limits
    print_text(console, device.title, "bold")
    print_text(console, f"{device.source} · file {device.digest[:12]}\n", "dim")
    peak, hot = device.driven_current, device.supply.voltage / device.greatest_resistance
    same = np.ptp(peak) < 1e-9 * peak[0]
    amperes = f"{peak[0]:.3g} A" if same else ", ".join(f"{a:.3g}" for a in peak) + " A"
    if (hot < peak).any():
        amperes += f" peak at 20 °C, {hot.min():.3g} A hot"
    else:
        amperes += " peak at 20 °C and hot"
    names = ", ".join(coils.names) if device.channels <= 6 else f"{coils.names[0]} … {coils.names[-1]}"
    torque = f"{limits.torque * 1e3:g} mN·m" if limits.torque < 1 else f"{limits.torque:g} N·m"
    guard = f"{limits.force:g} N, {torque}, {limits.slew / 1e3:g} A/ms, poses expire after {limits.expiry * 1e3:g} ms"
    lasting = f"{device.sustained_current.min():.2f} A continuous"
    if coils.heat.coupling is not None:
        lasting += f" with one coil warm, {device.sustained_current_together.min():.2f} A with all coils warm"
    power = "" if np.isinf(device.supply.power) else f", {device.supply.power:g} W for all coils"
    facts = [
        ("channels", f"{device.channels} ({names})"),
        ("current", f"{amperes}, {lasting}"),
        ("coils", f"{coils.resistance.min():.3g} Ω at {coils.reference_temperature - 273.15:.0f} °C"),
        ("supply", f"{device.supply.voltage:g} V{power}, {device.supply.duty_bits}-bit duty"),
        ("guard", guard),
    ]
    inheritance = None if device.text is None else device.text.inheritance
    if inheritance is not None:
        dropped = f"; not from it: {_name_some(inheritance.dropped)}" if inheritance.dropped else ""
        own = (
            f"{len(inheritance.own)} values of its own ({_name_some(inheritance.own)})"
            if inheritance.own
            else "no value of its own"
        )
        facts.append(("based on", f"{inheritance.base}, with {own}{dropped}; all others are its base's"))
    print_facts(console, [*facts, *more])
    for remark in device.remarks:
        print_text(console, f"\n{remark[:1].upper()}{remark[1:]}.", "bold red")


def _name_some(keys: tuple[str, ...], most: int = 8) -> str:
    more = f" and {len(keys) - most} more" if len(keys) > most else ""
    return ", ".join(keys[:most]) + more


def print_build_checks(device: Device, console: Console) -> None:
    """Print for each condition of buildability the part of `device` with the least margin."""
    nearest: dict[str, BuildCheck] = {}
    for check in device.build_checks:
        known = nearest.setdefault(check.condition, check)
        if check.margin / (abs(check.limit) or 1.0) < known.margin / (abs(known.limit) or 1.0):
            nearest[check.condition] = check
    holds = all(check.holds for check in nearest.values())
    table = TextTable(
        (
            Column("condition", kind="key"), Column("value"), Column("limit"), Column("margin"),
            Column("part", kind="note"),
        ),
        f"{'It can be built' if holds else 'It cannot be built'}: of each condition, the part with the least margin",
    )  # fmt: skip
    for condition, check in nearest.items():
        limit = f"{'≥' if check.at_least else '≤'} {format_bound(check.limit, check.unit)}"
        margin = format_bound(max(check.margin, 0.0), check.unit) if check.holds else "NOT KEPT"
        table.add_row(condition, format_bound(check.value, check.unit), limit, margin, check.name)
    print_text(console)
    print_table(console, table)


def _duration(seconds: float) -> str:
    if math.isinf(seconds):
        return "unlimited"
    return f"{seconds:.1f} s" if seconds < 10 else f"{seconds:.0f} s"
