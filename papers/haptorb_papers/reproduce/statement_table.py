"""HTML table of the statements of one part of a paper: printed, computed, tolerance, class."""

from __future__ import annotations

import math
from collections.abc import Iterable
from decimal import Decimal
from html import escape

from haptorb_papers.reproduce.citation import ROUNDING
from haptorb_papers.reproduce.item import Item

__all__ = ["css_class", "describe_tolerance", "format_number", "item_anchor", "statement_table"]


# --------------------------------------------------------------------------------------------------
# Numbers and tolerances as a reader says them: "±0.05 mm, the print's last digit", "9 digits", "exactly".


_NOTHING = 1e-13  #: what rounding leaves of nothing
_DIGITS = 6  #: from so many digits on, how many agree says more than the difference
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def format_number(value: float | None, digits: int = 5) -> str:
    """`digits` significant digits, powers of ten written out, a true minus; what rounding leaves of nothing is 0.

    >>> format_number(-0.188419), format_number(None), format_number(1e-16), format_number(1e-9), format_number(2.5e-7)
    ('−0.18842', '', '0', '10⁻⁹', '2.5 × 10⁻⁷')
    >>> format_number(16200), format_number(float("nan"))
    ('16200', 'not a number')
    """
    if value is None:
        return ""
    if not math.isfinite(value):
        return "not a number" if math.isnan(value) else "infinite"
    value = 0.0 if abs(value) < _NOTHING else value
    mantissa, _, power = f"{value:.{digits}g}".partition("e")
    if power:
        ten = "10" + str(int(power)).translate(_SUPERSCRIPTS)
        mantissa = ten if mantissa == "1" else f"{mantissa} × {ten}"
    return mantissa.replace("-", "−")


def describe_tolerance(item: Item) -> str:
    """Tolerance within which a computed number agrees; empty where nothing is compared.

    >>> from dataclasses import replace
    >>> item = Item("x", "bai2012", "Fig. 8", "a force", 7.8, 7.82, "N", 0.05)
    >>> describe_tolerance(item)
    '±0.05 N, the print’s last digit'
    >>> describe_tolerance(replace(item, tolerance=0.2))
    '±0.2 N (2.6 %)'
    >>> describe_tolerance(replace(item, tolerance=7.8e-9)), describe_tolerance(replace(item, tolerance=0.0))
    ('9 digits', 'exactly')
    >>> describe_tolerance(replace(item, published=0.0, tolerance=1e-9))
    'at most 10⁻⁹ N'
    """
    goal, tolerance = item.published if item.corrected is None else item.corrected, item.tolerance
    if goal is None or tolerance is None or item.computed is None:
        return ""
    if tolerance < _NOTHING:
        return "exactly"
    unit = "" if item.unit == "1" else f" {item.unit}"
    if goal == 0.0:
        return f"at most {format_number(tolerance, 3)}{unit}"
    share = tolerance / abs(goal)
    if share <= 10.0**-_DIGITS:
        if item.basis == "held":
            return "the same number"
        return f"{math.floor(-math.log10(share) + 1e-6)} digits"
    text = f"±{format_number(tolerance, 3)}{unit}"
    step = 10.0 ** _last_place(goal)
    if item.corrected is None and not item.implied and math.isclose(tolerance, 0.5 * step, rel_tol=0.03):
        return f"{text}, the print’s last digit"
    return text if item.unit == "%" else f"{text} ({format_number(100 * share, 2)} %)"


def _last_place(value: float) -> int:
    """The power of ten of the last digit with which `value` is written.

    >>> _last_place(7.8), _last_place(25.0), _last_place(2.407)
    (-1, 0, -3)
    """
    exponent = Decimal(f"{value:.12g}").normalize().as_tuple().exponent
    return min(exponent, 0) if isinstance(exponent, int) else 0


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
