"""Small HTML for notebooks and reports: facts, tables, curves.

Only the curves have fixed colours; everything else adapts to light and dark pages.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

import numpy as np

from haptorb.arrays import Array, record

__all__ = [
    "Link",
    "Presentable",
    "curves_svg",
    "facts_html",
    "format_beside",
    "format_number",
    "format_quantity",
    "format_vector",
    "pre_html",
    "scale_unit",
    "scroll_table_html",
    "table_html",
]


#: Okabe and Ito's colours, distinguishable with any colour vision
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")
_WIDTH, _HEIGHT, _LEFT, _BOTTOM = 520, 130, 52, 22  #: size of a figure, and margins for its axis labels [px]
_POINTS = 200  #: sampling points across a curve
_LEFT_CELL = "text-align:left;vertical-align:top;padding:0 1em 0 0"
_RIGHT_CELL = "text-align:right;vertical-align:top;padding:0 1em 0 0"


def facts_html(title: str, facts: Iterable[tuple[str, str]], more: str = "") -> str:
    """Return a title, a table of names and texts, and `more` HTML below it.

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
    """Return a table; the first column is text, the others are numbers.

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
    """Table cell with `text` that opens `to` in another tab."""

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
    """Return `text` in a fixed-width font, as a terminal shows it.

    >>> pre_html("a < b")
    "<pre style='line-height:1.25'>a &lt; b</pre>"
    """
    return f"<pre style='line-height:1.25'>{escape(text)}</pre>"


def curves_svg(x: Array, curves: Sequence[tuple[str, Array]], x_title: str, y_title: str) -> str:
    """Draw curves over `x` (n,) as SVG; each of `curves` is a name and (n,) values, in the units of the titles.

    A curve with more points than the figure resolves is drawn from the minimum to the maximum of each interval, so that
    no peak is lost. Non-finite values are left out. Empty if there are not two points to connect.

    >>> curves_svg(np.array([0.0, 1.0]), [("force", np.array([0.0, 0.5]))], "s", "N").count("<polyline")
    1
    """
    values = [y[np.isfinite(y)] for _, y in curves]
    ordinates = np.concatenate([np.zeros(1), *values])
    if len(x) < 2 or ordinates.size < 3 or not x[-1] > x[0]:
        return ""
    low, high = float(ordinates.min()), float(ordinates.max())
    span = high - low or 1.0
    right, top = _WIDTH - 8, 20  # the legend is above

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
    """Return the curve itself, or minimum and maximum of each interval of a long one; an interval of NaN stays NaN."""
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


# --------------------------------------------------------------------------------------------------
# Common display of values in a notebook: one or two lines of text, and a small HTML table.


class Presentable:
    """Base of objects with a summary of one or two lines and a table of facts. Dataclasses keep this `repr`.

    The names begin with an underscore because users name the fields of subclasses.
    """

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "__repr__" not in vars(cls):
            cls.__repr__ = cls.__repr__  # type: ignore[method-assign]  # otherwise `dataclass` would define its own

    def _summarize(self) -> str:
        """Summarise the object in one or two lines."""
        return object.__repr__(self)

    def _list_facts(self) -> list[tuple[str, str]]:
        """List names and figures with units, for a table."""
        return []

    def __repr__(self) -> str:
        return self._summarize()

    def _repr_html_(self) -> str:
        return facts_html(self._summarize(), self._list_facts(), self._picture_html())

    def _picture_html(self) -> str:
        """Return HTML below the table; empty for none."""
        return ""


# --------------------------------------------------------------------------------------------------
# Numbers with units: three digits, and a suitable prefix.


_PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M"}
#: units that begin with one of these take a prefix
_PREFIXED = frozenset({"m", "s", "A", "N", "W", "V", "Ω", "H", "T", "J", "Hz", "Pa", "rad"})
#: a unit without prefixes → the unit used below a tenth of it, and its power of ten
_SMALLER = {"kg": ("g", -3), "m³": ("cm³", -6)}


def format_number(value: float, digits: int = 3) -> str:
    """Format `value` with that many digits, without an exponent where that is readable.

    >>> format_number(0.05), format_number(999.7), format_number(1234.56)
    ('0.05', '1000', '1235')
    >>> format_number(-1e-17), format_number(float("nan"))
    ('-1e-17', 'unknown')
    """
    if math.isnan(value):
        return "unknown"
    if value == 0.0 or math.isinf(value):
        return "0" if value == 0.0 else "inf" if value > 0 else "-inf"
    if 10**digits - 0.5 <= abs(value) < 1e6:
        return f"{value:.0f}"
    return f"{value:.{digits}g}"


def format_beside(value: float, limit: float, decimals: int) -> str:
    """Format `value` with that many `decimals`, and with more where it would read like a `limit` that it is not.

    >>> format_beside(0.99949, 0.9995, 4), format_beside(0.9995, 0.9995, 4), format_beside(99.99999, 100.0, 2)
    ('0.99949', '0.9995', '99.99999')
    """
    while value != limit and decimals < 15 and f"{value:.{decimals}f}" == f"{limit:.{decimals}f}":
        decimals += 1
    return f"{value:.{decimals}f}"


def format_quantity(value: float, unit: str, digits: int = 3) -> str:
    """Format `value` in `unit` [SI], with a prefix where the unit takes one.

    >>> format_quantity(0.0529, "N/A"), format_quantity(8000.0, "A/s"), format_quantity(298.15, "K")
    ('52.9 mN/A', '8 kA/s', '298 K')
    >>> format_quantity(0.0181, "kg"), format_quantity(9.65e-5, "m³")
    ('18.1 g', '96.5 cm³')
    """
    power, shown = _choose_unit(abs(value), unit, digits)
    return f"{format_number(value / 10.0**power, digits)} {shown}".rstrip()


def format_vector(values: Iterable[float], unit: str, digits: int = 3) -> str:
    """Format several numbers in one unit, with the prefix that suits the largest.

    >>> format_vector((0.0, 0.0, 0.05), "m")
    '(0, 0, 50) mm'
    """
    numbers = [float(value) for value in values]
    largest = max((abs(value) for value in numbers if math.isfinite(value)), default=0.0)
    power, shown = _choose_unit(largest, unit, digits)
    scaled = [value / 10.0**power for value in numbers]
    # Values far smaller than the largest are rounding errors, shown as zero.
    texts = [format_number(0.0 if abs(value) < 1e-9 * largest / 10.0**power else value, digits) for value in scaled]
    return f"({', '.join(texts)}) {shown}".rstrip()


def scale_unit(size: float, unit: str) -> tuple[float, str]:
    """Return the factor for displaying numbers of about `size` in `unit` [SI], and the resulting unit.

    >>> scale_unit(0.0123, "N·m"), scale_unit(0.0123, "mm²")
    ((1000.0, 'mN·m'), (1.0, 'mm²'))
    """
    power, shown = _choose_unit(abs(size), unit, 3)
    return 10.0**-power, shown


def _choose_unit(size: float, unit: str, digits: int) -> tuple[int, str]:
    """Return the unit that suits `size` [unit], and its power of ten; `unit` itself and 0 if it takes no prefix.

    A square takes none: mm² is not 1e-3 m².
    """
    if unit in _SMALLER and 0.0 < size < 0.1:
        shown, power = _SMALLER[unit]
        return power, shown
    first = re.split("[/·²³]", unit, maxsplit=1)[0]
    if first not in _PREFIXED or unit[len(first) :].startswith(("²", "³")):
        return 0, unit
    if not math.isfinite(size) or size == 0.0:
        return 0, unit
    power = 3 * math.floor(math.log10(float(f"{size:.{digits}g}")) / 3)
    power = min(max(power, min(_PREFIXES)), max(_PREFIXES))
    return power, f"{_PREFIXES[power]}{unit}"
