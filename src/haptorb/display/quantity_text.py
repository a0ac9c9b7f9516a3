"""Numbers with units as people read them: three digits, and the prefix that suits the size."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

__all__ = ["format_number", "format_quantity", "format_vector", "scale_unit"]

_PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M"}
#: a unit that begins with one of these takes a prefix
_PREFIXED = frozenset({"m", "s", "A", "N", "W", "V", "Ω", "H", "T", "J", "Hz", "Pa", "rad"})
#: a unit without a prefix of its own → the unit that is read below a tenth of it, and its power of ten
_SMALLER = {"kg": ("g", -3), "m³": ("cm³", -6)}


def format_number(value: float, digits: int = 3) -> str:
    """`value` with that many digits, without an exponent where it can be read without one.

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


def format_quantity(value: float, unit: str, digits: int = 3) -> str:
    """`value` in `unit` [SI], with a prefix where the unit takes one.

    >>> format_quantity(0.0529, "N/A"), format_quantity(8000.0, "A/s"), format_quantity(298.15, "K")
    ('52.9 mN/A', '8 kA/s', '298 K')
    >>> format_quantity(0.0181, "kg"), format_quantity(9.65e-5, "m³")
    ('18.1 g', '96.5 cm³')
    """
    power, shown = _choose_unit(abs(value), unit, digits)
    return f"{format_number(value / 10.0**power, digits)} {shown}".rstrip()


def format_vector(values: Iterable[float], unit: str, digits: int = 3) -> str:
    """Several numbers in one unit, with the prefix that suits the largest.

    >>> format_vector((0.0, 0.0, 0.05), "m")
    '(0, 0, 50) mm'
    """
    numbers = [float(value) for value in values]
    largest = max((abs(value) for value in numbers if math.isfinite(value)), default=0.0)
    power, shown = _choose_unit(largest, unit, digits)
    scaled = [value / 10.0**power for value in numbers]
    # What is tiny beside the largest is rounding, and reads as zero.
    texts = [format_number(0.0 if abs(value) < 1e-9 * largest / 10.0**power else value, digits) for value in scaled]
    return f"({', '.join(texts)}) {shown}".rstrip()


def scale_unit(size: float, unit: str) -> tuple[float, str]:
    """What numbers of about `size` in `unit` [SI] are multiplied with to be shown, and the unit they are then in.

    >>> scale_unit(0.0123, "N·m"), scale_unit(0.0123, "mm²")
    ((1000.0, 'mN·m'), (1.0, 'mm²'))
    """
    power, shown = _choose_unit(abs(size), unit, 3)
    return 10.0**-power, shown


def _choose_unit(size: float, unit: str, digits: int) -> tuple[int, str]:
    """The unit that suits `size` [unit], and its power of ten; `unit` itself, and 0, where it takes no prefix.

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
