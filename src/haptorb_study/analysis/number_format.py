"""Numbers and intervals of an analysis as people read them; what is not a number is a dash, never "nan"."""

from __future__ import annotations

import math

__all__ = ["format_p", "format_percent", "format_range", "format_value", "json_number"]


def format_value(value: float, form: str, scale: float = 1.0) -> str:
    """`scale` times `value`, or a dash.

    >>> format_value(0.25, ".1f", 100), format_value(float("nan"), ".1f")
    ('25.0', '–')
    """
    return f"{scale * value:{form}}" if math.isfinite(value) else "–"


def format_range(limits: tuple[float, float], form: str, scale: float = 1.0) -> str:
    """Both ends; the one that exists, of an interval with an open end; a dash where none is known.

    >>> format_range((0.25, 0.5), ".1f", 100), format_range((float("nan"), float("nan")), ".1f")
    ('25.0 to 50.0', '–')
    >>> format_range((0.25, math.inf), ".2f"), format_range((-math.inf, 0.5), ".2f")
    ('≥ 0.25', '≤ 0.50')
    >>> format_range((-math.inf, math.inf), ".2f")
    'no limit'
    """
    low, high = limits
    if math.isnan(low) or math.isnan(high):
        return "–"
    if math.isinf(low) or math.isinf(high):
        one = f"≤ {scale * high:{form}}" if math.isfinite(high) else f"≥ {scale * low:{form}}"
        return one if math.isfinite(low) or math.isfinite(high) else "no limit"
    return f"{scale * low:{form}} to {scale * high:{form}}"


def format_p(p: float) -> str:
    """ "p = ..." or, where a computer's numbers end, "p < ...".

    >>> format_p(0.0123), format_p(0.0)
    ('p = 0.012', 'p < 1e-300')
    """
    return "p < 1e-300" if p < 1e-300 else f"p = {p:.2g}"


def format_percent(share: float) -> str:
    """As a percentage with its sign.

    >>> format_percent(0.125), format_percent(float("nan"))
    ('12.5 %', '–')
    """
    return "–" if not math.isfinite(share) else f"{100 * share:.1f} %"


def json_number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
