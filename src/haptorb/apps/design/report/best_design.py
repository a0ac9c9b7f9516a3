"""One of the designs that were picked, as the report shows it: device file, device, card and drawing."""

from __future__ import annotations

from dataclasses import dataclass

from haptorb.apps.design.report.side_by_side import draw_beside
from haptorb.apps.design.results_table import ResultsTable
from haptorb.apps.inspect import card
from haptorb.apps.progress import build_tables
from haptorb.design.device_changes import build_device, write_device_text
from haptorb.design.evaluate import find_base
from haptorb.devices.device import Device
from haptorb.errors import InputError

__all__ = ["BestDesign", "make_best"]

_WIDTH = 110  #: characters of a line of a card


@dataclass(frozen=True)
class BestDesign:
    """A design with what is made of it.

    row      of the results table
    text     the device file, for `haptorb run` and every other command
    card     what `haptorb inspect` prints of it; or why it has none
    drawing  PNG, beside the base device; empty for a kind of device without geometry
    """

    row: int
    name: str
    reason: str
    text: str
    card: str
    drawing: bytes


def make_best(table: ResultsTable, row: int, reason: str) -> BestDesign:
    """Everything that the report says of the design in `row`; a motor's tables are computed for its card."""
    _, found = table.found[row]
    name = table.name(row)
    device = build_device(table.design, found.values, name)
    base = find_base(table.design)
    drawn = device.kind.part("geometry") is not None and base.kind.part("geometry") is not None
    return BestDesign(
        row, name, reason, write_device_text(table.design, found.values, name), _print_card(device),
        draw_beside(device, base) if drawn else b"",
    )  # fmt: skip


def _print_card(device: Device) -> str:
    try:
        build_tables(device)
        return card(device).render_text(_WIDTH)
    except InputError as cause:
        return f"no card: {cause}"
