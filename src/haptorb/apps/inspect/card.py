"""A capability card: what a device is, what it can do and what about it is only assumed."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from haptorb.apps.inspect.quantities import Curve, Quantity
from haptorb.apps.terminal import print_facts, print_text
from haptorb.apps.terminal.notebook_report import NotebookReport
from haptorb.devices.device import Device

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Card", "card", "facts", "print_card"]


class Card(NotebookReport, ABC):
    """What every card answers."""

    _device: Device

    @property
    def device(self) -> Device:
        """The device whose card this is."""
        return self._device

    @abstractmethod
    def quantities(self) -> list[Quantity]:
        """The figures of the card that stand beside those of other devices, in order."""

    @abstractmethod
    def curves(self) -> list[Curve]:
        """The lines that are drawn over those of other devices."""

    @abstractmethod
    def numbers(self) -> dict[str, Any]:
        """Everything on the card as plain JSON types, SI units in the keys."""

    @abstractmethod
    def show(self, console: Console) -> None:
        """Print it for people."""

    def _summarize(self) -> str:
        return f"<{type(self).__name__} of {self._device.name}: {self._device.title}>"

    @abstractmethod
    def draw(self) -> Figure:
        """The card as a picture."""


def card(device: Device) -> Card:
    """The card of `device`; InputError where its kind has none."""
    made: Card = device.kind.require_part("card", device.name, "`haptorb inspect`")(device)
    return made


def facts(device: Device) -> dict[str, Any]:
    """What all devices have, as plain JSON types."""
    coils = device.coils
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
        "remarks": list(device.remarks),
        "assumed": dict(device.assumed),
    }


def print_card(device: Device, console: Console, more: Iterable[tuple[str, str]]) -> None:
    """Print the head of the card: title, limits, and `more` facts (name, text)."""
    coils, limits = device.coils, device.limits
    print_text(console, device.title, "bold")
    print_text(console, f"{device.source} · file {device.digest[:12]}\n", "dim")
    same = len(set(coils.current_limit)) == 1
    amperes = f"{coils.current_limit[0]:g}" if same else ", ".join(f"{a:g}" for a in coils.current_limit)
    names = ", ".join(coils.names) if device.channels <= 6 else f"{coils.names[0]} … {coils.names[-1]}"
    torque = f"{limits.torque * 1e3:g} mN·m" if limits.torque < 1 else f"{limits.torque:g} N·m"
    guard = f"{limits.force:g} N, {torque}, {limits.slew / 1e3:g} A/ms, poses expire after {limits.expiry * 1e3:g} ms"
    lasting = f"{device.sustained_current.min():.2f} A continuous"
    if coils.heat.coupling is not None:
        lasting += f" with one coil warm, {device.sustained_current_together.min():.2f} A with all coils warm"
    power = "" if np.isinf(device.supply.power) else f", {device.supply.power:g} W for all coils"
    facts = [
        ("channels", f"{device.channels} ({names})"),
        ("current", f"{amperes} A peak, {lasting}"),
        ("coils", f"{coils.resistance.min():.3g} Ω at {coils.reference_temperature - 273.15:.0f} °C"),
        ("supply", f"{device.supply.voltage:g} V{power}, {device.supply.duty_bits}-bit duty"),
        ("guard", guard),
    ]
    print_facts(console, [*facts, *more])
    for remark in device.remarks:
        print_text(console, f"\n{remark[:1].upper()}{remark[1:]}.", "bold red")
