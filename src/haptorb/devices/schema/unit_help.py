"""What to say of a unit that cannot be used: which name in it is unknown, what is near, and what is usual."""

from __future__ import annotations

from collections.abc import Callable
from difflib import get_close_matches

from haptorb.devices.schema.field_units import AMBIGUOUS, FIELD
from haptorb.devices.schema.units import PREFIXED, PREFIXES, WHOLE, find_unit, split_unit
from haptorb.errors import quote

__all__ = ["explain_unit", "usual_units"]

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
    """What the field writes where SI `unit` is wanted, the most usual first; none for a plain number.

    >>> usual_units("m")[:2]
    ('mm', 'cm')
    """
    return tuple(_USUAL[unit].split(", ")) if unit in _USUAL else (unit,) if unit else ()


def explain_unit(text: str, unit: str, is_unit: Callable[[str], bool]) -> str:
    """What is wrong with the unit `text` where SI `unit` is wanted, as the end of a message; empty without a unit.

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
