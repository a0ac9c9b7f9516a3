"""Numbers and intervals as printed in tables and reports; NaN is a dash."""

from __future__ import annotations

import math

__all__ = ["format_p", "format_percent", "format_range", "format_value"]


def format_value(value: float, form: str, scale: float = 1.0) -> str:
    """`scale` × `value` in the format `form`; NaN is a dash.

    >>> format_value(0.25, ".1f", 100), format_value(float("nan"), ".1f")
    ('25.0', '–')
    """
    return f"{scale * value:{form}}" if math.isfinite(value) else "–"


def format_range(limits: tuple[float, float], form: str, scale: float = 1.0) -> str:
    """Interval as text; with one limit where the other is open, a dash where it is unknown.

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
    """p as text, "p < 1e-300" at underflow.

    >>> format_p(0.0123), format_p(0.0)
    ('p = 0.012', 'p < 1e-300')
    """
    return "p < 1e-300" if p < 1e-300 else f"p = {p:.2g}"


def format_percent(share: float) -> str:
    """Percentage with its sign; NaN is a dash.

    >>> format_percent(0.125), format_percent(float("nan"))
    ('12.5 %', '–')
    """
    return "–" if not math.isfinite(share) else f"{100 * share:.1f} %"
