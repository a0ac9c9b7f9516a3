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
    if len(summary.units) < 2:
        return
    title = "Order, trial by trial" if summary.mixed else "Order of the blocks"
    table = TextTable((Column("participant"), Column("order", kind="text")), title)
    for person in range(len(summary.plans)):
        table.add_row(str(person + 1), summary.row(person))
    print_table(make_console(), table)
