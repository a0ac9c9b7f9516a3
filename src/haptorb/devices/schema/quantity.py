"""Values with units, as device files write them: read, checked for dimension, turned into SI.

A value is `"67.9 mm"`, a list of such, or a table `{ value = …, unit = "…", source = "…" }` or `{ value = …, assumed =
"why" }`; `unit` spares writing it in every element of an array.
"""

from __future__ import annotations

import math
import re
import shutil
import sys
from collections import Counter
from functools import lru_cache
from importlib.metadata import version
from typing import Annotated, Any

from pydantic import BeforeValidator

from haptorb.errors import quote
from haptorb.numerics.compiled import cache_folder

__all__ = [
    "Angle",
    "Capacitance",
    "Conductance",
    "Current",
    "Damping",
    "Duration",
    "Force",
    "HeatCapacity",
    "Inductance",
    "Inertia",
    "InverseKelvin",
    "Length",
    "Mass",
    "MomentPerCurrent",
    "Number",
    "Polarization",
    "Resistance",
    "Slew",
    "Stiffness",
    "Temperature",
    "TemperatureStep",
    "Torque",
    "TurnDamping",
    "TurnStiffness",
    "Voltage",
    "si",
]

_LONGEST = 100  #: characters of a value
_MOST_FACTORS = 8
_LARGEST = 1e15  #: in SI units; beyond it, and below its inverse, nothing in a device is, and products would overflow
_NUMBER = re.compile(
    r"\s*([+-]?(?:[0-9]{1,40}\.?[0-9]{0,40}|\.[0-9]{1,40})(?:[eE][+-]?[0-9]{1,4})?|[+-]?inf)\s*(.*?)\s*"
)
_FACTOR = re.compile(r"(Δ?°?[^\W\d]\w{0,39}|[%‰°])(?:\s*(?:\*\*|\^)\s*(-?[1-9]))?")
_BETWEEN = re.compile(r"\s*(\*(?!\*)|/|·|⋅|×|\bper\b)\s*|\s+")
_RAISED = re.compile("(⁻?)([¹²³⁴⁵⁶⁷⁸⁹])")
_PLAIN = str.maketrans("¹²³⁴⁵⁶⁷⁸⁹", "123456789")
_SIGNS = {"°": "degree", "%": "percent", "‰": "permille", "℃": "degC"}


@lru_cache(maxsize=1)
def _registry() -> Any:
    """pint's, with its definitions as it kept them the last time: reading them again is half of a device file's time.

    It writes them without care for a process that is killed meanwhile; what cannot be read is thrown away. They are
    pickled objects of pint and its parser: with another version of either they are made anew.
    """
    import pint

    parser, python = version("flexparser"), sys.implementation.cache_tag
    folder = cache_folder() / "units" / f"pint {pint.__version__}, flexparser {parser}, {python}"
    try:
        return pint.UnitRegistry(cache_folder=folder)
    except Exception:  # whatever a file that is half there makes of pickle, or a disk that is full
        shutil.rmtree(folder, ignore_errors=True)
        return pint.UnitRegistry(cache_folder=None)


def si(value: object, unit: str, kind: str) -> float:
    """`value` (a string with a unit, or a (number, unit) pair) in SI `unit`; ValueError says what was expected.

    >>> si("67.9 mm", "m", "a length")
    0.0679
    >>> si("25 degC", "K", "a temperature")
    298.15
    """
    expected = f"must be {kind}" if unit == "" else f"must be {kind} with its unit, such as '1 {unit}'"
    try:
        if isinstance(value, tuple):
            number, name = float(value[0]), str(value[1])
        elif isinstance(value, str):
            match = _NUMBER.fullmatch(value) if len(value) <= _LONGEST else None
            if match is None:
                raise ValueError(f"{expected}; got {quote(value)}")
            number, name = float(match[1]), match[2]
        elif isinstance(value, int | float) and not isinstance(value, bool) and unit == "":
            number, name = float(value), ""
        else:
            raise ValueError(f"{expected}; got {quote(value)}")
    except OverflowError as cause:
        raise ValueError(f"{expected}; got {quote(value)}") from cause
    told = quote(f"{number} {name}") if isinstance(value, tuple) else quote(value)
    unbounded = math.isinf(number) and unit == "" and (not isinstance(value, str) or "inf" in value)
    if not unbounded and not math.isfinite(number):
        raise ValueError(f"must be a finite {kind.removeprefix('a ').removeprefix('an ')}; got {told}")
    import pint

    try:
        powers = _unit(name)  # safety: unit-read
        converted = float(_registry().Quantity(number, powers).to(unit or "dimensionless").magnitude)
    except (pint.PintError, ArithmeticError, AttributeError, ValueError) as cause:
        raise ValueError(f"{expected if isinstance(value, tuple) else f'must be {kind}'}; got {told}") from cause
    if not unbounded and converted != 0.0 and not 1.0 / _LARGEST <= abs(converted) <= _LARGEST:
        raise ValueError(
            f"must be {kind} whose size is between {1 / _LARGEST:g} and {_LARGEST:g} {unit}".rstrip() + f"; got {told}"
        )
    return float(f"{converted:.15g}")  # 67.9 mm is 0.0679 m, not 0.06790000000000001 m


@lru_cache(maxsize=512)
def _unit(text: str) -> Any:
    """The product of powers that `text` writes, as pint counts it; ValueError for anything else.

    Names, `*`, `·`, `/` or a space between them, and one exponent each; pint is asked for single names only, since what
    it is given otherwise it evaluates.
    """
    from pint.util import UnitsContainer

    registry, powers, sign, at = _registry(), Counter[str](), 1, 0
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
        name = registry.get_name(_SIGNS.get(factor[1], factor[1]))
        if name:  # "dimensionless" has none
            powers[name] += sign * int(factor[2] or 1)
        at = factor.end()
        if at == len(text):
            break
        between = _BETWEEN.match(text, at)
        if between is None:
            raise ValueError(f"no '*' or '/' at character {at + 1} of {quote(text)}")
        sign, at = -1 if between[1] in ("/", "per") else 1, between.end()
    else:
        raise ValueError(f"more than {_MOST_FACTORS} factors in {quote(text)}")
    return UnitsContainer(powers)


def _of(unit: str, kind: str) -> BeforeValidator:
    return BeforeValidator(lambda value: si(value, unit, kind))


Number = Annotated[float, _of("", "a plain number")]
Length = Annotated[float, _of("m", "a length")]
Angle = Annotated[float, _of("rad", "an angle")]
Mass = Annotated[float, _of("kg", "a mass")]
Duration = Annotated[float, _of("s", "a duration")]
Force = Annotated[float, _of("N", "a force")]
Torque = Annotated[float, _of("N*m", "a torque")]
Stiffness = Annotated[float, _of("N/m", "a stiffness")]
Damping = Annotated[float, _of("N*s/m", "a damping")]
TurnStiffness = Annotated[float, _of("N*m/rad", "a rotational stiffness")]
TurnDamping = Annotated[float, _of("N*m*s/rad", "a rotational damping")]
Inertia = Annotated[float, _of("kg*m**2", "a moment of inertia")]
Current = Annotated[float, _of("A", "a current")]
Slew = Annotated[float, _of("A/s", "a rate of current")]
Voltage = Annotated[float, _of("V", "a voltage")]
Resistance = Annotated[float, _of("ohm", "a resistance")]
Inductance = Annotated[float, _of("H", "an inductance")]
Capacitance = Annotated[float, _of("F", "a capacitance")]
Polarization = Annotated[float, _of("T", "a flux density")]
MomentPerCurrent = Annotated[float, _of("m**2", "a magnetic moment per current")]
Temperature = Annotated[float, _of("K", "a temperature")]
TemperatureStep = Annotated[float, _of("delta_degC", "a temperature difference")]
HeatCapacity = Annotated[float, _of("J/K", "a heat capacity")]
Conductance = Annotated[float, _of("W/K", "a heat conductance")]
InverseKelvin = Annotated[float, _of("1/K", "a temperature coefficient")]
