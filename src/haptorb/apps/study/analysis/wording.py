"""Numbers and intervals of an analysis as people read them; what is not a number is a dash, never "nan"."""

from __future__ import annotations

import math

__all__ = ["format_p", "format_percent", "format_range", "format_value"]


def format_value(value: float, form: str, scale: float = 1.0) -> str:
    """`scale` times `value`, or a dash.

    >>> format_value(0.25, ".1f", 100), format_value(float("nan"), ".1f")
    ('25.0', '–')
    """
    return f"{scale * value:{form}}" if math.isfinite(value) else "–"


def format_range(limits: tuple[float, float], form: str, scale: float = 1.0) -> str:
    """Both ends, or one dash where an end is not known: one participant has no interval over people.

    >>> format_range((0.25, 0.5), ".1f", 100), format_range((float("nan"), float("nan")), ".1f")
    ('25.0 to 50.0', '–')
    """
    low, high = limits
    known = math.isfinite(low) and math.isfinite(high)
    return f"{scale * low:{form}} to {scale * high:{form}}" if known else "–"


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
