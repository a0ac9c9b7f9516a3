"""Units of magnetics and workshops that pint takes for something else, or does not convert to SI.

In air B = μ0 H, and of a magnet J = μ0 M: so where a flux density or polarization is wanted, a field strength H or a
magnetization M is one too. Sources: Jackson, Classical Electrodynamics, appendix (Gaussian units); a mil is a
thousandth of an inch. pint takes "mil" for an angle, "Gs" for a gigasecond, "Nm" for the fineness of a yarn and "gr"
for a grain; gauss and oersted it does not convert to tesla.
"""

from __future__ import annotations

import math
from fractions import Fraction

__all__ = ["AMBIGUOUS", "COMPOUND", "FIELD", "MAGNETIC", "VACUUM"]

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

#: field strength or magnetization, where a flux density is wanted
MAGNETIC = (_STRENGTH, _DENSITY)
VACUUM = 4 * Fraction(math.pi) / 10**7  #: μ0 [T·m/A], as `physics.sources.dipole` has it

#: units that people write as one word → the units; an exponent belongs to the last
COMPOUND: dict[str, tuple[str, ...]] = {
    f"{prefix}{''.join(names)}": (f"{prefix}{names[0]}", *names[1:])
    for prefix in ("", "n", "µ", "μ", "u", "m", "k")
    for names in (("N", "m"), ("N", "s"), ("N", "m", "s"), ("A", "m"))
}

#: what pint reads as one unit and most people mean as another → what to write instead
AMBIGUOUS = {"gr": "'g' (gram) or 'grain'"}
