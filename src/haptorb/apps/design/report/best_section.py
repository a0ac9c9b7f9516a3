"""The designs that were picked: how, what they change, and each with its device file, drawing and card."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from html import escape

from haptorb.apps.design.report.best_design import BestDesign
from haptorb.apps.design.results_table import ResultsColumn, ResultsTable
from haptorb.design.analysis.best import RULES
from haptorb.display.quantity_text import format_number

__all__ = ["make_best_section"]


def make_best_section(table: ResultsTable, best: Sequence[BestDesign]) -> str:
    """HTML of all of `best`."""
    if not best:
        return (
            "<p>There is no valid design within the ranges and constraints. The rejected designs are counted below.</p>"
        )
    rule = RULES[len(table.select("objective")) > 1]
    return f"<p class='soft'>Selection: {escape(rule)}</p>" + "".join(
        _make_one(table, number, one) for number, one in enumerate(best, 1)
    )


def _make_one(table: ResultsTable, number: int, one: BestDesign) -> str:
    file = f"{one.name}.toml"
    shown = f"Sections and views of {escape(one.name)} and of the base device, to one scale"
    picture = (
        f"<figure tabindex='0'><img loading='lazy' width='1080' height='954' alt='{shown}' "
        f"src='{_encode_data(one.drawing, 'image/png')}'>"
        "<figcaption>Both columns have the same scale.</figcaption></figure>"
        if one.drawing
        else ""
    )
    return (
        f"<article class='best' id='best-{number}'><h3>{number}: {escape(one.name)} "
        f"<span class='soft'>{escape(one.reason)}</span></h3>"
        f"<p><a class='button' download='{escape(file)}' href='{_encode_data(one.text.encode(), 'application/toml')}'>"
        f"Device file {escape(file)}</a> <code>haptorb run {escape(file)}</code></p>"
        f"<div class='side'>{_make_numbers(table, one.row)}{picture}</div>"
        f"<details><summary>Capability card (<code>haptorb inspect {escape(file)}</code>)</summary>"
        f"<pre tabindex='0'>{escape(one.card)}</pre></details>"
        f"<details><summary>Device file</summary><pre tabindex='0'>{escape(one.text)}</pre></details></article>"
    )


def _make_numbers(table: ResultsTable, row: int) -> str:
    lines = "".join(
        f"<tr><th scope='row'>{escape(one.title)}{f' [{escape(one.unit)}]' if one.unit else ''}</th>"
        f"<td class='n'>{_tell(one, float(one.values[row]))}</td><td class='n'>{_tell(one, one.base)}</td>"
        f"<td class='n'>{_compare(one, row)}</td></tr>"
        for kind in ("objective", "parameter", "constraint")
        for one in table.select(kind)
    )
    base = escape(table.design.base.rpartition("/")[2]) + (" *" if table.remark else "")
    note = f"<p class='soft'>* {escape(table.remark)}.</p>" if table.remark else ""
    return (
        "<div class='wide' tabindex='0'><table class='table'><thead><tr><th></th>"
        f"<th scope='col' class='n'>this design</th><th scope='col' class='n'>{base}</th>"
        f"<th scope='col' class='n'>ratio</th></tr></thead><tbody>{lines}</tbody></table>{note}</div>"
    )


def _tell(column: ResultsColumn, value: float) -> str:
    if value != value:
        return "–"
    return escape(column.labels[int(value)] if column.labels else format_number(value, 4).replace("-", "−"))


def _compare(column: ResultsColumn, row: int) -> str:
    """Of an objective: how it stands to the base device's."""
    if column.kind != "objective" or not column.base * column.values[row] > 0:
        return ""
    return f"{column.values[row] / column.base:.3g}"


def _encode_data(content: bytes, kind: str) -> str:
    """`content` of media type `kind` as an address that holds it."""
    return f"data:{kind};base64,{b64encode(content).decode('ascii')}"
