"""Conversion of device files' units to SI without pint: names, prefixes and powers, with exact factors.

pint knows every unit and takes half a second to load. The few that device files use are here; whatever else a
file says, and every mistake, is pint's to judge (`quantity.si`). Sources: the SI brochure (BIPM 2019); the inch is
25.4 mm. Values are computed as fractions, so that 67.9 mm is 0.0679 m to the last digit.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from difflib import get_close_matches
from fractions import Fraction
from functools import lru_cache

from haptorb.errors import quote

__all__ = [
    "AMBIGUOUS",
    "COMPOUND",
    "FIELD",
    "MAGNETIC",
    "PREFIXED",
    "PREFIXES",
    "VACUUM",
    "WHOLE",
    "convert",
    "explain_unit",
    "find_unit",
    "split_unit",
    "usual_units",
]


# --------------------------------------------------------------------------------------------------
# Units of magnetics and workshops that pint takes for something else, or does not convert to SI.
#
# In air B = μ0 H, and of a magnet J = μ0 M: so where a flux density or polarization is required, a field strength H or
# a magnetization M is one too. Sources: Jackson, Classical Electrodynamics, appendix (Gaussian units); a mil is a
# thousandth of an inch. pint takes "mil" for an angle, "Gs" for a gigasecond, "Nm" for the fineness of a yarn and "gr"
# for a grain; gauss and oersted it does not convert to tesla.


_LENGTH, _DENSITY, _STRENGTH, _MOMENT = (1, 0, 0, 0, 0), (0, 1, -2, -1, 0), (-1, 0, 0, 1, 0), (2, 0, 0, 1, 0)
_GAUSS = (Fraction(1, 10_000), _DENSITY)
_OERSTED = (10**6 / (1000 * 4 * Fraction(math.pi)), _STRENGTH)  # 1000/4π A/m
_EMU = (Fraction(1, 1000), _MOMENT)
_MIL = (Fraction("0.0000254"), _LENGTH)

#: unit, with or without a prefix → (factor to SI, powers of m, kg, s, A, K)
FIELD: dict[str, tuple[Fraction, tuple[int, int, int, int, int]]] = {
    "G": _GAUSS,
    "Gs": _GAUSS,
    "gauss": _GAUSS,
    "Gauss": _GAUSS,
    "tesla": (Fraction(1), _DENSITY),
    "Tesla": (Fraction(1), _DENSITY),
    "Oe": _OERSTED,
    "oersted": _OERSTED,
    "Oersted": _OERSTED,
    "emu": _EMU,
    "mil": _MIL,
    "mils": _MIL,
    "thou": _MIL,
    "Ohm": (Fraction(1), (2, 1, -3, -2, 0)),
    "Ohms": (Fraction(1), (2, 1, -3, -2, 0)),
}

#: field strength or magnetization, where a flux density is required
MAGNETIC = (_STRENGTH, _DENSITY)
VACUUM = 4 * Fraction(math.pi) / 10**7  #: μ0 [T·m/A], as `magnetics.dipole` has it

#: units that people write as one word → the units; an exponent belongs to the last
COMPOUND: dict[str, tuple[str, ...]] = {
    f"{prefix}{''.join(names)}": (f"{prefix}{names[0]}", *names[1:])
    for prefix in ("", "n", "µ", "μ", "u", "m", "k")
    for names in (("N", "m"), ("N", "s"), ("N", "m", "s"), ("A", "m"))
}

#: what pint reads as one unit and most people mean as another → what to write instead
AMBIGUOUS = {"gr": "'g' (gram) or 'grain'"}


_MOST_FACTORS = 8
_FACTOR = re.compile(r"(Δ?°?[^\W\d]\w{0,39}|[%‰°])(?:\s*(?:\*\*|\^)\s*(-?[1-9]))?")
_BETWEEN = re.compile(r"\s*(\*(?!\*)|/|·|⋅|×|\bper\b)\s*|\s+")
_RAISED = re.compile("(⁻?)([¹²³⁴⁵⁶⁷⁸⁹])")
_PLAIN = str.maketrans("¹²³⁴⁵⁶⁷⁸⁹", "123456789")
_SIGNS = {"°": "degree", "%": "percent", "‰": "permille", "℃": "degC"}
_CELSIUS = frozenset({"degC", "°C", "celsius"})
_ZERO_CELSIUS = Fraction("273.15")  #: [K]

Dimension = tuple[int, int, int, int, int]  # powers of m, kg, s, A, K
_NONE: Dimension = (0, 0, 0, 0, 0)
_TURN = Fraction(math.pi) * 2

#: symbol → power of ten
PREFIXES = {"p": -12, "n": -9, "µ": -6, "μ": -6, "u": -6, "m": -3, "k": 3, "M": 6}
#: unit that takes a prefix → (factor to SI, dimension)
PREFIXED: dict[str, tuple[Fraction, Dimension]] = {
    "m": (Fraction(1), (1, 0, 0, 0, 0)),
    "g": (Fraction(1, 1000), (0, 1, 0, 0, 0)),
    "s": (Fraction(1), (0, 0, 1, 0, 0)),
    "A": (Fraction(1), (0, 0, 0, 1, 0)),
    "K": (Fraction(1), (0, 0, 0, 0, 1)),
    "rad": (Fraction(1), _NONE),
    "Hz": (Fraction(1), (0, 0, -1, 0, 0)),
    "N": (Fraction(1), (1, 1, -2, 0, 0)),
    "Pa": (Fraction(1), (-1, 1, -2, 0, 0)),
    "J": (Fraction(1), (2, 1, -2, 0, 0)),
    "W": (Fraction(1), (2, 1, -3, 0, 0)),
    "V": (Fraction(1), (2, 1, -3, -1, 0)),
    "ohm": (Fraction(1), (2, 1, -3, -2, 0)),
    "Ω": (Fraction(1), (2, 1, -3, -2, 0)),
    "H": (Fraction(1), (2, 1, -2, -2, 0)),
    "F": (Fraction(1), (-2, -1, 4, 2, 0)),
    "T": (Fraction(1), (0, 1, -2, -1, 0)),
}
#: unit without a prefix → (factor to SI, dimension)
WHOLE: dict[str, tuple[Fraction, Dimension]] = {
    "cm": (Fraction(1, 100), (1, 0, 0, 0, 0)),
    "inch": (Fraction("0.0254"), (1, 0, 0, 0, 0)),
    "min": (Fraction(60), (0, 0, 1, 0, 0)),
    "h": (Fraction(3600), (0, 0, 1, 0, 0)),
    "deg": (_TURN / 360, _NONE),
    "degree": (_TURN / 360, _NONE),
    "percent": (Fraction(1, 100), _NONE),
    "delta_degC": (Fraction(1), (0, 0, 0, 0, 1)),
    "Δ°C": (Fraction(1), (0, 0, 0, 0, 1)),
}


@lru_cache(maxsize=512)
def split_unit(text: str) -> tuple[tuple[str, int], ...]:
    """The factors that `text` writes: (name, power) each; ValueError for anything else.

    Names, `*`, `·`, `/` or a space between them, and one exponent each; nothing is evaluated. "Nm", "Nms", "Ns" and
    "Am" are read as several names; an exponent belongs to the last.

    >>> split_unit("N·m/s²")
    (('N', 1), ('m', 1), ('s', -2))
    """
    factors, sign, at = [], 1, 0
    text = _RAISED.sub(lambda found: f"^{'-' if found[1] else ''}{found[2].translate(_PLAIN)}", text).replace("℃", "°C")
    if text.startswith("1/"):
        text = text[1:]
    if text.startswith("/"):
        sign, at = -1, 1
    for count in range(_MOST_FACTORS):
        while text[at : at + 1].isspace():
            at += 1
        if at == len(text) and count == 0 and sign == 1:
            break
        factor = _FACTOR.match(text, at)
        if factor is None:
            raise ValueError(f"no unit at character {at + 1} of {quote(text)}")
        *before, last = COMPOUND.get(factor[1], (_SIGNS.get(factor[1], factor[1]),))
        factors += [(name, sign) for name in before]
        factors.append((last, sign * int(factor[2] or 1)))
        at = factor.end()
        if at == len(text):
            break
        between = _BETWEEN.match(text, at)
        if between is None:
            raise ValueError(f"no '*' or '/' at character {at + 1} of {quote(text)}")
        sign, at = -1 if between[1] in ("/", "per") else 1, between.end()
    else:
        raise ValueError(f"more than {_MOST_FACTORS} factors in {quote(text)}")
    return tuple(factors)


def find_unit(name: str) -> tuple[Fraction, Dimension] | None:
    """Factor and dimension of one name, with its prefix; None for a name that is not here."""
    if name in WHOLE:
        return WHOLE[name]
    if name in PREFIXED:
        return PREFIXED[name]
    if name in FIELD:
        return FIELD[name]
    power, unit = PREFIXES.get(name[:1]), PREFIXED.get(name[1:]) or FIELD.get(name[1:])
    if power is None or unit is None:
        return None
    return unit[0] * Fraction(10) ** power, unit[1]


@lru_cache(maxsize=512)
def _scale(text: str) -> tuple[Fraction, Dimension] | None:
    """Factor and dimension of a whole unit; None for one that is not made of the units here."""
    factor, powers = Fraction(1), _NONE
    try:
        factors = split_unit(text)
    except ValueError:
        return None
    for name, power in factors:
        found = find_unit(name)
        if found is None:
            return None
        factor *= found[0] ** power
        a, b, c, d, e = (old + power * new for old, new in zip(powers, found[1], strict=True))
        powers = (a, b, c, d, e)
    return factor, powers


@lru_cache(maxsize=4096)  # the fractions take longer than all else that is done with a value
def convert(number: float, text: str, unit: str) -> float | None:
    """Convert `number` from unit `text` to `unit`; None if only pint can decide: another unit, or an error.

    A field strength or magnetization, where a flux density is required, is multiplied by μ0.

    >>> convert(67.9, "mm", "m")
    0.0679
    >>> convert(1.0, "furlong", "m") is None, convert(1.0, "kg", "m") is None
    (True, True)
    """
    if math.isinf(number):
        return number if text == unit == "" else None
    if text in _CELSIUS:  # the one with an offset: only by itself
        return float(Fraction(repr(number)) + _ZERO_CELSIUS) if unit == "K" else None
    here, there = _scale(text), _scale(unit)
    if here is None or there is None:
        return None
    factor = here[0] / there[0]
    if here[1] != there[1]:
        if (here[1], there[1]) != MAGNETIC:
            return None
        factor *= VACUUM
    return float(Fraction(repr(number)) * factor)


# --------------------------------------------------------------------------------------------------
# Messages about invalid units: the unknown name, the nearest known one, and the usual units.


#: SI unit → what the field writes, the most usual first
_USUAL = {
    "m": "mm, cm, m, µm, inch, mil",
    "rad": "deg, rad, turn",
    "kg": "g, kg",
    "s": "ms, s, µs, min",
    "N": "N, mN, lbf",
    "N*m": "mN*m, N*m",
    "N/m": "N/m, N/mm",
    "N*s/m": "N*s/m",
    "N*m/rad": "N*m/rad, mN*m/deg",
    "N*m*s/rad": "mN*m*s/rad, N*m*s/rad",
    "kg*m**2": "kg*m^2, g*cm^2",
    "A": "A, mA",
    "A/s": "A/ms, A/s",
    "N/s": "N/s, N/ms",
    "N*m/s": "N*m/s, mN*m/ms",
    "V": "V, mV",
    "W": "W, mW, kW",
    "ohm": "ohm, Ω, mohm",
    "H": "mH, µH, H",
    "F": "µF, nF, F",
    "T": "T, mT, gauss, kG, kA/m, Oe, emu/cm^3",
    "m**2": "m^2, A*m^2/A, emu/A",
    "K": "degC, K",
    "delta_degC": "delta_degC, K",
    "J/K": "J/K",
    "W/K": "W/K, mW/K",
    "1/K": "1/K",
    "T/K": "µT/K, mT/K",
    "A*m**2": "mA*m^2, A*m^2, emu",
    "Pa": "GPa, MPa, Pa, psi",
}
_LONG_PREFIXES = ("", "nano", "micro", "milli", "centi", "kilo", "mega", "giga")
_LONG = ("meter", "metre", "gram", "second", "ampere", "volt", "tesla", "gauss", "newton", "ohm", "henry", "farad",
         "watt", "joule", "kelvin", "radian", "degree", "hertz", "pascal", "oersted")  # fmt: skip


def usual_units(unit: str) -> tuple[str, ...]:
    """Usual units where SI `unit` is required, the most common first; none for a plain number.

    >>> usual_units("m")[:2]
    ('mm', 'cm')
    """
    return tuple(_USUAL[unit].split(", ")) if unit in _USUAL else (unit,) if unit else ()


def explain_unit(text: str, unit: str, is_unit: Callable[[str], bool]) -> str:
    """Explain why the unit `text` is invalid for SI `unit`, as the end of a message; empty without a unit.

    is_unit: whether a single name is a unit that pint knows.

    >>> explain_unit("milimeter", "m", lambda name: False)
    ": 'milimeter' is not a unit, did you mean 'millimeter'? (units: mm, cm, m, µm, inch, mil)"
    """
    if text == "":
        return ""
    usual = usual_units(unit)
    suitable = f" (units: {', '.join(usual)})" if usual else " (this value has no unit)"
    try:
        names = [name for name, _ in split_unit(text)]
    except ValueError as cause:
        return f": {cause}{suitable}"
    for name in names:
        if name in AMBIGUOUS:
            return f": write {AMBIGUOUS[name]}{suitable}"
        if find_unit(name) is None and not is_unit(name):
            near = _find_near(name)
            hint = f", did you mean '{near}'?" if near else ""
            return f": {quote(name, 20)} is not a unit{hint}{suitable}"
    return suitable


def _find_near(name: str) -> str | None:
    """The unit whose spelling is nearest to `name`: the same letters in another case first."""
    short = [*WHOLE, *PREFIXED, *FIELD]
    known = [*short, *(prefix + unit for prefix in PREFIXES for unit in (*PREFIXED, *FIELD)),
             *(prefix + unit for prefix in _LONG_PREFIXES for unit in _LONG)]  # fmt: skip
    same = [unit for unit in known if unit.lower() in (name.lower(), name.lower().removesuffix("s"))]
    return next(iter(same or get_close_matches(name[:40], known, n=1, cutoff=0.6)), None)
