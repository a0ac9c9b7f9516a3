"""The statements of one part of a paper as a table in HTML: printed, computed, how near is near enough, class."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

from haptorb_papers.reproduce.citation import ROUNDING
from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.tolerance_text import describe_tolerance, format_number

__all__ = ["css_class", "item_anchor", "statement_table"]

_HEADS = ("where", "what", "printed", "here", "agrees within", "class")


def statement_table(items: Iterable[Item]) -> str:
    """All of them, one row each. On a narrow page a row becomes a block, whose cells say what they are."""
    heads = "".join(f"<th scope='col'{_numeric(head)}>{head}</th>" for head in _HEADS)
    rows = "".join(_row(item) for item in items)
    return f"<div class='wide'><table><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table></div>"


def item_anchor(item: Item) -> str:
    """The id of its row, for links."""
    return escape(f"{item.paper}-{item.id}", quote=True)


def css_class(verdict: str) -> str:
    """In which colour a class is written."""
    return {"reproduced": "good", "implied": "good", "contradicted": "erratum", "differs": "bad"}.get(verdict, "open")


def _row(item: Item) -> str:
    unit = "" if item.unit == "1" else f" {escape(item.unit)}"
    printed = _with_unit(item.published, unit)
    if item.implied:
        printed += "<br><small>implied</small>"
    if item.corrected is not None:
        printed = f"{printed}<br><small>by {escape(item.erratum)}: {_with_unit(item.corrected, unit)}</small>"
    why = f"<br><small>{escape(item.reason)}</small>" if item.reason not in ("", ROUNDING) else ""
    cells = (
        ("where", escape(item.where)),
        ("what", escape(item.what) + why),
        ("printed", printed),
        ("here", _with_unit(item.computed, unit)),
        ("agrees within", escape(describe_tolerance(item)).replace(" %", "\N{NO-BREAK SPACE}%")),
    )
    row = "".join(f"<td data-is='{name}'{_numeric(name)}>{text}</td>" for name, text in cells)
    verdict = f"<td data-is='class' class='v {css_class(item.verdict)}'>{escape(item.label)}</td>"
    return f"<tr id='{item_anchor(item)}'>{row}{verdict}</tr>"


def _with_unit(value: float | None, unit: str) -> str:
    return "" if value is None else format_number(value) + unit


def _numeric(head: str) -> str:
    return " class='n'" if head in ("printed", "here", "agrees within") else ""
