"""Values with units in device files: parsing, check of the dimension, conversion to SI.

A value is `"67.9 mm"`, a list of such, or a table `{ value = …, unit = "…", source = "…" }` or `{ value = …, assumed =
"why" }`; `unit` spares writing it in every element of an array.
"""

from __future__ import annotations

import math
import re
import shutil
import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator

from haptorb.cache_folder import private_folder
from haptorb.devices.unit_conversion import AMBIGUOUS, convert, explain_unit, split_unit, usual_units
from haptorb.errors import InputError, quote

__all__ = [
    "Angle",
    "Conductance",
    "Current",
    "Damping",
    "Duration",
    "FieldDrift",
    "Force",
    "ForceRate",
    "HeatCapacity",
    "Inductance",
    "Inertia",
    "InverseKelvin",
    "Length",
    "MagneticMoment",
    "Mass",
    "Modulus",
    "MomentPerCurrent",
    "Number",
    "Polarization",
    "Power",
    "QuantityKind",
    "Resistance",
    "Slew",
    "Stiffness",
    "Temperature",
    "TemperatureStep",
    "Torque",
    "TorqueRate",
    "TurnDamping",
    "TurnStiffness",
    "Voltage",
    "si",
    "strip_provenance",
]

_MAX_VALUE_CHARACTERS = 100  #: characters of a value
_MAX_NUMBER = (
    1e15  #: in SI units; beyond it, and below its inverse, nothing in a device is, and products would overflow
)
_NUMBER = re.compile(
    r"\s*([+-]?(?:[0-9]{1,40}\.?[0-9]{0,40}|\.[0-9]{1,40})(?:[eE][+-]?[0-9]{1,4})?|[+-]?inf)\s*(.*?)\s*"
)


@lru_cache(maxsize=1)
def _registry() -> Any:
    """pint's, for units that `unit_conversion` does not know, with its definitions as it kept them the last time.

    It writes them without care for a process that is killed meanwhile; what cannot be read is thrown away. They are
    pickled objects of pint and its parser: with another version of either they are created again.
    """
    import pint

    parser, python = version("flexparser"), sys.implementation.cache_tag
    folder: Path | None = None
    try:
        folder = private_folder("units", f"pint {pint.__version__}, flexparser {parser}, {python}")
        return pint.UnitRegistry(cache_folder=folder)
    except Exception:  # a partial file, a full disk, or a folder that others can write
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)
        return pint.UnitRegistry(cache_folder=None)


def si(value: object, unit: str, kind: str) -> float:
    """`value` (a string with a unit, or a (number, unit) pair) in SI `unit`; ValueError says what was expected.

    >>> si("67.9 mm", "m", "a length")
    0.0679
    >>> si("25 degC", "K", "a temperature")
    298.15
    """
    usual = usual_units(unit)
    expected = f"must be {kind} with its unit, such as '1 {usual[0]}'" if usual else f"must be {kind}"
    try:
        if isinstance(value, tuple):
            number, name = float(value[0]), str(value[1])
        elif isinstance(value, str):
            match = _NUMBER.fullmatch(value) if len(value) <= _MAX_VALUE_CHARACTERS else None
            if match is None:
                raise ValueError(f"{expected}; got {quote(value)}")
            number, name = float(match[1]), match[2]
        elif isinstance(value, int | float) and not isinstance(value, bool) and unit == "":
            number, name = float(value), ""
        else:
            raise ValueError(f"{expected}; got {quote(value)}")
    except OverflowError as cause:
        raise ValueError(f"{expected}; got {quote(value)}") from cause
    text = quote(f"{number} {name}") if isinstance(value, tuple) else quote(value)
    unbounded = math.isinf(number) and unit == "" and (not isinstance(value, str) or "inf" in value)
    if not unbounded and not math.isfinite(number):
        raise ValueError(f"must be a finite {kind.removeprefix('a ').removeprefix('an ')}; got {text}")
    try:
        turns = unit == "" and name in ("turn", "turns")  # of a winding, where an angle's turn is 2π
        converted = number if turns else convert(number, name, unit)
        if converted is None:
            converted = _convert_with_pint(number, name, unit)
    except (ArithmeticError, AttributeError, ValueError) as cause:
        why = explain_unit(name, unit, _is_unit)
        raise ValueError(f"{expected if name == '' else f'must be {kind}'}; got {text}{why}") from cause
    if not unbounded and converted != 0.0 and not 1.0 / _MAX_NUMBER <= abs(converted) <= _MAX_NUMBER:
        raise ValueError(
            f"must be {kind} whose size is between {1 / _MAX_NUMBER:g} and {_MAX_NUMBER:g} {unit}".rstrip()
            + f"; got {text}"
        )
    return float(f"{converted:.15g}")  # 67.9 mm is 0.0679 m, not 0.06790000000000001 m


def _convert_with_pint(number: float, name: str, unit: str) -> float:
    """`number` of the unit that `name` writes, in `unit`; ValueError, or another error of pint's, if it cannot."""
    import pint

    try:
        powers = _unit(name)  # safety: unit-read
        return float(_registry().Quantity(number, powers).to(unit or "dimensionless").magnitude)
    except pint.PintError as cause:
        raise ValueError(str(cause)) from cause


@lru_cache(maxsize=512)
def _unit(text: str) -> Any:
    """The product of powers that `text` writes, as pint counts it; ValueError for anything else.

    pint is asked for single names only, since what it is given otherwise it evaluates.
    """
    from pint.util import UnitsContainer

    registry, powers = _registry(), Counter[str]()
    for factor, power in split_unit(text):
        if factor in AMBIGUOUS:
            raise ValueError(f"{factor} has two meanings")
        name = registry.get_name(factor)
        if name:  # "dimensionless" has none
            powers[name] += power
    return UnitsContainer(powers)


def _is_unit(name: str) -> bool:
    """Whether pint knows `name`."""
    try:
        return bool(_unit(name))
    except Exception:  # any failure of pint on a wrong name
        return False


@dataclass(frozen=True)
class QuantityKind(BeforeValidator):
    """Kind of value in a device file: its SI `unit`, and `kind` as used in sentences, "a length"."""

    unit: str = ""
    kind: str = ""


def _unit_validator(unit: str, kind: str) -> QuantityKind:
    return QuantityKind(lambda value: si(value, unit, kind), unit=unit, kind=kind)


Number = Annotated[float, _unit_validator("", "a plain number")]  #: plain number [1]
Length = Annotated[float, _unit_validator("m", "a length")]  #: length [m]
Angle = Annotated[float, _unit_validator("rad", "an angle")]  #: angle [rad]
Mass = Annotated[float, _unit_validator("kg", "a mass")]  #: mass [kg]
Duration = Annotated[float, _unit_validator("s", "a duration")]  #: duration [s]
Force = Annotated[float, _unit_validator("N", "a force")]  #: force [N]
Torque = Annotated[float, _unit_validator("N*m", "a torque")]  #: torque [N·m]
Stiffness = Annotated[float, _unit_validator("N/m", "a stiffness")]  #: stiffness [N/m]
Damping = Annotated[float, _unit_validator("N*s/m", "a damping")]  #: damping [N·s/m]
#: rotational stiffness [N·m/rad]
TurnStiffness = Annotated[float, _unit_validator("N*m/rad", "a rotational stiffness")]
TurnDamping = Annotated[float, _unit_validator("N*m*s/rad", "a rotational damping")]  #: rotational damping [N·m·s/rad]
Inertia = Annotated[float, _unit_validator("kg*m**2", "a moment of inertia")]  #: moment of inertia [kg·m²]
Current = Annotated[float, _unit_validator("A", "a current")]  #: current [A]
Slew = Annotated[float, _unit_validator("A/s", "a rate of current")]  #: rate of current [A/s]
ForceRate = Annotated[float, _unit_validator("N/s", "a rate of force")]  #: rate of force [N/s]
TorqueRate = Annotated[float, _unit_validator("N*m/s", "a rate of torque")]  #: rate of torque [N·m/s]
Voltage = Annotated[float, _unit_validator("V", "a voltage")]  #: voltage [V]
Power = Annotated[float, _unit_validator("W", "a power")]  #: power [W]
Resistance = Annotated[float, _unit_validator("ohm", "a resistance")]  #: resistance [Ω]
Inductance = Annotated[float, _unit_validator("H", "an inductance")]  #: inductance [H]
Modulus = Annotated[float, _unit_validator("Pa", "a modulus of elasticity")]  #: modulus of elasticity [Pa]
Polarization = Annotated[float, _unit_validator("T", "a flux density")]  #: flux density [T]
#: magnetic moment per current [m²]
MomentPerCurrent = Annotated[float, _unit_validator("m**2", "a magnetic moment per current")]
Temperature = Annotated[float, _unit_validator("K", "a temperature")]  #: temperature [K]
#: temperature difference [K]
TemperatureStep = Annotated[float, _unit_validator("delta_degC", "a temperature difference")]
HeatCapacity = Annotated[float, _unit_validator("J/K", "a heat capacity")]  #: heat capacity [J/K]
Conductance = Annotated[float, _unit_validator("W/K", "a heat conductance")]  #: heat conductance [W/K]
FieldDrift = Annotated[float, _unit_validator("T/K", "a flux density per kelvin")]  #: flux density per kelvin [T/K]
MagneticMoment = Annotated[float, _unit_validator("A*m**2", "a magnetic moment")]  #: magnetic moment [A·m²]
InverseKelvin = Annotated[float, _unit_validator("1/K", "a temperature coefficient")]  #: temperature coefficient [1/K]


def strip_provenance(value: Any, path: str, assumed: dict[str, str]) -> Any:
    """The value without its provenance; what is assumed, and why, goes into `assumed`.

    Raises InputError for keys that a value cannot have.
    """
    if isinstance(value, list):
        return [strip_provenance(part, f"{path}.{number}", assumed) for number, part in enumerate(value, 1)]
    if not isinstance(value, Mapping):
        return value
    if "value" not in value:
        return {key: strip_provenance(part, f"{path}.{key}", assumed) for key, part in value.items()}
    strange = set(value) - {"value", "unit", "assumed", "source"}
    if strange:
        raise InputError(
            f"{path}.{quote(min(strange))[1:-1]}: a value has only the keys value, unit, source and assumed"
        )
    if "assumed" in value:
        if not isinstance(value["assumed"], str) or not value["assumed"].strip():
            raise InputError(f"{path}.assumed must give the reason for the value")
        assumed[path] = value["assumed"]
    return _with_unit(value["value"], str(value["unit"]), path) if "unit" in value else value["value"]


def _with_unit(value: Any, unit: str, path: str) -> Any:
    if isinstance(value, list):
        return [_with_unit(item, unit, "") for item in value]
    if isinstance(value, str) and path:
        raise InputError(
            f"{path}.unit ({quote(unit)}) has no effect: the value {quote(value)} is a text with a unit of its own; "
            "leave the unit out, or give the value as a number"
        )
    if isinstance(value, int | float) and not isinstance(value, bool):
        return (value, unit)
    return value
