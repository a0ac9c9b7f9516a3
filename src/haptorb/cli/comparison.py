"""Several devices side by side: one row per quantity, one column per device, and their curves over each other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, final

import numpy as np
from rich.console import Console

from haptorb.analysis.workspace import map_workspaces
from haptorb.cli.card import Card, Curve, Quantity
from haptorb.devices.base import Device
from haptorb.errors import InputError
from haptorb.notebook import NotebookReport
from haptorb.terminal import Column, TextTable, print_facts, print_table, print_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Comparison", "describe_mappings", "name_devices"]


#: Okabe and Ito's colours, distinguishable with any colour vision, and a marker for each
_LINES = (
    *(("#0072b2", "o"), ("#d55e00", "s"), ("#009e73", "D"), ("#cc79a7", "^"), ("#e69f00", "v"), ("#56b4e9", "P")),
    ("#000000", "X"),
)
_MISSING = "-"  #: shown if a device does not have the quantity
_EQUAL_TOLERANCE = 1e-6  #: relative difference below which two values count as equal


@final
class Comparison(NotebookReport):
    """Cards of several devices; `labels` are their names in tables and legends."""

    def __init__(self, cards: Sequence[Card], labels: Sequence[str]) -> None:
        if len(cards) > len(_LINES):
            raise InputError(f"at most {len(_LINES)} devices can be compared at once; got {len(cards)}")
        self.cards, self.labels = tuple(cards), tuple(labels)
        self._columns = [{one.head: one for one in card.quantities()} for card in cards]

    def numbers(self) -> list[dict[str, Any]]:
        """Return every card as plain JSON types, in the order of the devices."""
        return [card.numbers() for card in self.cards]

    def show(self, console: Console) -> None:
        """Print the devices, then the quantities in which they may differ."""
        devices = [card.device for card in self.cards]
        facts = [
            (label, f"{device.kind.title} · {device.title} · {device.source} · file {device.digest[:12]}")
            for label, device in zip(self.labels, devices, strict=True)
        ]
        print_facts(console, facts)
        print_text(console)
        two = len(self.cards) == 2 and devices[0].kind.name == devices[1].kind.name
        columns = [Column("quantity", kind="key"), *(Column(label) for label in self.labels)]
        if two:
            columns.append(Column("change", "%"))
        table = TextTable(tuple(columns), "Capability side by side")
        heads = self._list_heads()
        for head in heads:
            cells = [column.get(head) for column in self._columns]
            texts = [_MISSING if cell is None else cell.text for cell in cells]
            table.add_row(head, *texts, *([_change(*cells)] if two else []))
        print_table(console, table)
        for line in describe_mappings(devices, self.labels):
            print_text(console, line)
        if len({device.digest for device in devices}) < len(devices):
            print_text(console, '\nDevices with the same number after "file" are the same in every value.')
        if any(len(column) < len(heads) for column in self._columns):
            print_text(console, f"\n{_MISSING}: this kind of device does not have the quantity", "dim")

    def _list_heads(self) -> list[str]:
        """List the quantities of all devices, each once: common ones first."""
        heads = list(dict.fromkeys(head for column in self._columns for head in column))
        return sorted(heads, key=lambda head: not all(head in column for column in self._columns))

    def draw(self) -> Figure:
        """Draw the curves of all devices, one panel for each quantity that at least one of them has."""
        from matplotlib.figure import Figure
        from matplotlib.lines import Line2D

        panels: dict[str, list[tuple[int, Curve]]] = {}
        for number, card in enumerate(self.cards):
            for curve in card.curves():
                panels.setdefault(curve.panel, []).append((number, curve))
        across = min(len(panels), 3)
        down = -(-len(panels) // across)
        figure = Figure(figsize=(5.2 * across, 4.2 * down + 0.6), layout="constrained")
        places = figure.subplots(down, across, squeeze=False).ravel()
        for place, (title, curves) in zip(places, panels.items(), strict=False):
            _draw_panel(place, title, curves, self.labels)
        for place in places[len(panels) :]:
            place.axis("off")
        lines = [Line2D([], [], color=color, marker=marker) for color, marker in _LINES[: len(self.cards)]]
        figure.legend(lines, self.labels, loc="outside upper left", ncols=len(lines), frameon=False)
        return figure

    def _summarize(self) -> str:
        return f"<Comparison of {', '.join(self.labels)}>"


def describe_mappings(devices: Sequence[Device], labels: Sequence[str]) -> list[str]:
    """Describe the default workspace mapping from the first device to each of another size, one line each.

    >>> from haptorb.devices.loader import load
    >>> describe_mappings([load("arm"), load("arm")], ["one", "two"])
    []
    """
    found = []
    for other, label in zip(devices[1:], labels[1:], strict=True):
        mapping = map_workspaces(devices[0], other)
        if mapping is None or (abs(mapping.scale - 1.0) < 1e-3 and np.allclose(mapping.centre, mapping.other_centre)):
            continue
        middle, there = (
            f"({', '.join(f'{round(1e3 * x) + 0:g}' for x in one)}) mm"
            for one in (mapping.centre, mapping.other_centre)
        )
        found.append(
            f"\nworkspace of {labels[0]} in that of {label}: middle {middle} onto {there}, scale {mapping.scale:.3g}; "
            f"a stiffness of {labels[0]} seems {1 / mapping.scale:.3g} times as large there"
        )
    return found


def _draw_panel(place: Any, title: str, curves: list[tuple[int, Curve]], labels: Sequence[str]) -> None:
    from matplotlib.lines import Line2D

    kinds: dict[str, str] = {}
    for number, curve in curves:
        color, marker = _LINES[number]
        place.plot(curve.x, curve.y, color=color, marker=marker, ms=4, ls=curve.style, label=f"{number}: {curve.label}")
        kinds[curve.label] = curve.style
    first = curves[0][1]
    place.set(xlabel=first.x_label, ylabel=first.y_label)
    place.set_title(title, loc="left", fontsize=10)
    place.grid(alpha=0.3)
    if endless := [labels[number] for number, curve in curves if not len(curve.y)]:
        place.text(0.97, 0.95, f"unlimited: {', '.join(endless)}", ha="right", va="top", transform=place.transAxes)
    if any(len(curve.y) for _, curve in curves):
        place.set_ylim(0, None)
    if len(kinds) > 1:
        signs = [Line2D([], [], color="0.3", ls=style) for style in kinds.values()]
        place.legend(signs, kinds, frameon=False, fontsize=8)


def _change(before: Quantity | None, after: Quantity | None) -> str:
    """Format the relative change between two devices [%]; empty if only one has the quantity."""
    if before is None or after is None:
        return ""
    if before.value == after.value:
        return "0"
    relative = after.value / before.value - 1 if before.value else float("nan")
    if not abs(relative) < float("inf"):
        return ""
    return (
        "0"
        if abs(relative) < _EQUAL_TOLERANCE
        else f"{100 * relative:+.0f}"
        if abs(relative) >= 1
        else f"{100 * relative:+.3g}"
    )


def name_devices(devices: Sequence[Device], given: Sequence[str]) -> list[str]:
    """Return a label for each device: its name, or the `given` argument if two have the same name.

    Raises InputError for a device that is given twice.
    """
    for number, one in enumerate(given):
        if one in given[:number]:
            raise InputError(f"device '{one}' is given twice; give every device once")
    names = [device.name for device in devices]
    return [name if names.count(name) == 1 else text for name, text in zip(names, given, strict=True)]
