"""Small HTML for notebooks and reports: facts, tables, curves.

Only the curves have colours of their own: it fits light and dark pages.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.numerics.record import record

__all__ = ["Link", "curves_svg", "facts_html", "pre_html", "scroll_table_html", "table_html"]

#: Okabe and Ito's colours: distinguished with any colour vision
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")
_WIDTH, _HEIGHT, _LEFT, _BOTTOM = 520, 130, 52, 22  #: of a picture, and room for its numbers [px]
_POINTS = 200  #: places across a curve
_LEFT_CELL = "text-align:left;vertical-align:top;padding:0 1em 0 0"
_RIGHT_CELL = "text-align:right;vertical-align:top;padding:0 1em 0 0"


def facts_html(title: str, facts: Iterable[tuple[str, str]], more: str = "") -> str:
    """A title, a table of names and texts, and `more` HTML below it.

    >>> facts_html("omni", [("supply", "12 V")]).count("<td")
    1
    """
    rows = "".join(
        f"<tr><th style='{_LEFT_CELL};font-weight:normal;opacity:.7'>{escape(name)}</th>"
        f"<td style='{_LEFT_CELL}'>{escape(text)}</td></tr>"
        for name, text in facts
    )
    table = f"<table>{rows}</table>" if rows else ""
    return f"<div><strong>{escape(title)}</strong>{table}{more}</div>"


def table_html(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; the first column is text, the others are numbers.

    >>> table_html(["", "x [N/A]"], [["F_x", "0.1"]]).count("<tr>")
    2
    """
    line = "".join(f"<th style='{_cell(n)}'>{escape(head)}</th>" for n, head in enumerate(heads))
    body = "".join(
        "<tr>" + "".join(f"<td style='{_cell(n)}'>{escape(cell)}</td>" for n, cell in enumerate(row)) + "</tr>"
        for row in rows
    )
    return f"<table><thead><tr>{line}</tr></thead><tbody>{body}</tbody></table>"


@record
class Link:
    """A cell of a table: `text` that opens `to` in another tab."""

    text: str
    to: str


def _fill_cell(cell: object) -> str:
    if isinstance(cell, Link):
        return f"<a href='{escape(cell.to)}' target='_blank' rel='noopener'>{escape(cell.text)}</a>"
    return escape(str(cell))


def scroll_table_html(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table for a report, whose style sheet gives "wide" a scroll bar: a narrow window scrolls the table, by keyboard
    too, and not the page.

    >>> scroll_table_html(["design", "trials"], [["firm & stiff", 3]])[77:]
    '<tr><td>firm &amp; stiff</td><td>3</td></tr></table></div>'
    """
    top = "".join(f"<th>{escape(head)}</th>" for head in heads)
    lines = ("<tr>" + "".join(f"<td>{_fill_cell(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<div class='wide' tabindex='0'><table><tr>{top}</tr>{''.join(lines)}</table></div>"


def pre_html(text: str) -> str:
    """Text as a terminal shows it.

    >>> pre_html("a < b")
    "<pre style='line-height:1.25'>a &lt; b</pre>"
    """
    return f"<pre style='line-height:1.25'>{escape(text)}</pre>"


def curves_svg(x: Array, curves: Sequence[tuple[str, Array]], x_title: str, y_title: str) -> str:
    """Curves over `x` (n,) as an SVG picture; each of `curves` is a name and (n,) values, in the units of the titles.

    A curve with more points than the picture shows is drawn from the lowest to the highest of each interval, so that no
    peak is lost. What is not finite is left out. Empty without two points to join.

    >>> curves_svg(np.array([0.0, 1.0]), [("force", np.array([0.0, 0.5]))], "s", "N").count("<polyline")
    1
    """
    values = [y[np.isfinite(y)] for _, y in curves]
    ordinates = np.concatenate([np.zeros(1), *values])
    if len(x) < 2 or ordinates.size < 3 or not x[-1] > x[0]:
        return ""
    low, high = float(ordinates.min()), float(ordinates.max())
    span = high - low or 1.0
    right, top = _WIDTH - 8, 20  # the names stand above

    def place(t: Array, y: Array) -> str:
        across = _LEFT + (t - x[0]) / (x[-1] - x[0]) * (right - _LEFT)
        up = _HEIGHT - _BOTTOM - (y - low) / span * (_HEIGHT - _BOTTOM - top)
        return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(across.tolist(), up.tolist(), strict=True))

    parts = []
    for number, (name, y) in enumerate(curves):
        colour = _COLOURS[number % len(_COLOURS)]
        t, thin = _join_points(x, y)
        known = np.isfinite(thin)
        if known.any():
            parts.append(f"<polyline points='{place(t[known], thin[known])}' fill='none' stroke='{colour}'/>")
        parts.append(f"<text x='{_LEFT + 8 + 110 * number}' y='12' fill='{colour}'>{escape(name)}</text>")
    base = _HEIGHT - _BOTTOM
    parts.append(f"<path d='M{_LEFT} {top}V{base}H{right}' fill='none' stroke='currentColor' opacity='.5'/>")
    for text, at in ((f"{high:.3g}", top + 8), (f"{low:.3g}", base)):
        parts.append(f"<text x='{_LEFT - 4}' y='{at}' text-anchor='end' fill='currentColor'>{text}</text>")
    parts.append(f"<text x='{_LEFT}' y='{_HEIGHT - 6}' fill='currentColor'>{x[0]:.3g}</text>")
    end = f"{x[-1]:.4g} {x_title} · {y_title} up"
    parts.append(f"<text x='{right}' y='{_HEIGHT - 6}' text-anchor='end' fill='currentColor'>{escape(end)}</text>")
    return (
        f"<svg xmlns='http://www.w3.org/2000/svg' width='{_WIDTH}' height='{_HEIGHT}' font-size='11' "
        f"font-family='sans-serif'>{''.join(parts)}</svg>"
    )


def _join_points(x: Array, y: Array) -> tuple[Array, Array]:
    """The curve itself, or lowest and highest of each interval of a long one; an interval of NaN stays NaN."""
    stretch = -(-len(x) // _POINTS)
    if stretch < 2:
        return x, y
    n = len(x) // stretch * stretch
    blocks = y[:n].reshape(-1, stretch)
    low = np.where(np.isnan(blocks), np.inf, blocks).min(axis=1)
    high = np.where(np.isnan(blocks), -np.inf, blocks).max(axis=1)
    return np.repeat(x[:n:stretch], 2), np.stack((low, high), axis=1).ravel()


def _cell(column: int) -> str:
    return _RIGHT_CELL if column else _LEFT_CELL
