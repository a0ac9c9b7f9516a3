"""Who will meet what when, printed before anybody takes part."""

from __future__ import annotations

from typing import TYPE_CHECKING

from haptorb.apps.terminal import Column, TextTable, make_console, print_table, tell

if TYPE_CHECKING:
    from haptorb.apps.study.model.order_summary import OrderSummary

__all__ = ["print_order"]


def print_order(summary: OrderSummary) -> None:
    """The order of the first participants, and how it balances."""
    for sentence in summary.sentences:
        tell(sentence)
    if len(summary.units) < 2 and not summary.asks:
        return
    title = f"Order of the {summary.asks}" if len(summary.units) < 2 else "Order, trial by trial"
    if len(summary.units) > 1 and not summary.mixed:
        title = "Order of the blocks" + (f", and of the {summary.asks} in each" if summary.asks else "")
    table = TextTable((Column("participant"), Column("order", kind="text")), title)
    for person in range(len(summary.plans)):
        table.add_row(str(person + 1), summary.row(person))
    print_table(make_console(), table)
