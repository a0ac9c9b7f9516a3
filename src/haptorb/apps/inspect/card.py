"""A capability card: what a device is, what it can do and what about it is only assumed."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from haptorb.devices.device import Device

__all__ = ["Card", "card", "facts", "print_card"]


class Card(ABC):
    """What every card answers."""

    @abstractmethod
    def numbers(self) -> dict[str, Any]:
        """Everything on the card as plain JSON types, SI units in the keys."""

    @abstractmethod
    def show(self, console: Console) -> None:
        """Print it for people."""

    @abstractmethod
    def plot(self, path: Path) -> None:
        """Draw it into the PNG or SVG file at `path`."""


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
        "resistance_ohm": coils.resistance.tolist(),
        "supply_v": device.supply.voltage,
        "limits": {
            "force_n": device.limits.force,
            "torque_nm": device.limits.torque,
            "slew_a_per_s": device.limits.slew,
            "expiry_s": device.limits.expiry,
        },
        "assumed": dict(device.assumed),
    }


def print_card(device: Device, console: Console) -> None:
    """Print the head of the card: title and limits."""
    coils, limits = device.coils, device.limits
    console.print(f"[bold]{device.title}[/]\n[dim]{device.source} · file {device.digest[:12]}[/]\n")
    table = Table.grid(padding=(0, 3))
    same = len(set(coils.current_limit)) == 1
    amperes = f"{coils.current_limit[0]:g}" if same else ", ".join(f"{a:g}" for a in coils.current_limit)
    names = ", ".join(coils.names) if device.channels <= 6 else f"{coils.names[0]} … {coils.names[-1]}"
    table.add_row("channels", f"{device.channels} ({names})")
    table.add_row("current", f"up to {amperes} A, {device.sustained_current.min():.2f} A for ever")
    table.add_row("coils", f"{coils.resistance.min():.3g} Ω at {coils.reference_temperature - 273.15:.0f} °C")
    table.add_row("supply", f"{device.supply.voltage:g} V, {device.supply.duty_bits} bits of duty")
    torque = f"{limits.torque * 1e3:g} mN·m" if limits.torque < 1 else f"{limits.torque:g} N·m"
    table.add_row(
        "guard",
        f"{limits.force:g} N, {torque}, {limits.slew / 1e3:g} A/ms, poses expire after {limits.expiry * 1e3:g} ms",
    )
    console.print(table)
