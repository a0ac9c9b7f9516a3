"""Numbers of a design file: ranges with a unit, places, and bounds in the unit of their quantity."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

from haptorb.design.file_schema import ParameterSection, PlaceSection
from haptorb.design.parameter import WHOLE, DesignParameter, ParameterPlace
from haptorb.devices.schema.units import convert
from haptorb.errors import InputError, quote

__all__ = ["is_base_share", "make_parameter", "read_bound", "read_number"]

_NUMBER = re.compile(r"\s*([+-]?(?:\d{1,40}\.?\d{0,40}|\.\d{1,40})(?:[eE][+-]?\d{1,3})?)\s*(.*?)\s*")
_PLACE = re.compile(r"\s*(-)?\s*(?:(\d+\.?\d*|\.\d+)\s*\*)?\s*([A-Za-z_][\w.-]*)\s*")
_BASE = re.compile(r"\s*(?:(\d+\.?\d*|\.\d+)\s*\*?\s*)?base\s*")


def read_number(value: str | float, unit: str | None = None) -> tuple[float, str]:
    """The number and its unit, or the number in `unit` if that is given; ValueError for another.

    >>> read_number("18 deg"), read_number("1 cm", "mm")
    ((18.0, 'deg'), (10.0, 'mm'))
    """
    match = _NUMBER.fullmatch(value) if isinstance(value, str) and len(value) <= 100 else None
    if isinstance(value, str):
        if match is None:
            raise ValueError(f"must be a number with its unit; got {quote(value)}")
        number, name = float(match[1]), match[2]
    else:
        number, name = float(value), ""
    if not math.isfinite(number):
        raise ValueError(f"must be a finite number; got {quote(value)}")
    if unit is None or name == unit:
        return number, name
    if number == 0.0 and name == "":
        return number, unit
    found = convert(number, name, unit)
    if found is None:
        raise ValueError(f"must be {f'in {unit}, or a unit like it' if unit else 'a plain number'}; got {quote(value)}")
    return float(f"{found:.12g}"), unit


def make_parameter(name: str, section: ParameterSection) -> DesignParameter:
    """The parameter that [parameters.NAME] describes; InputError that names the key."""
    where = f"parameters.{name}"
    unit, low, high, step = "", 0.0, 0.0, 0.0
    if section.choices is None:
        low, unit = _read(section.low, None, f"{where}.low")
        high = _read(section.high, unit, f"{where}.high")[0]
        step = 0.0 if section.step is None else _read(section.step, unit, f"{where}.step")[0]
        if not low < high:
            raise InputError(f"{where}.high must be greater than low ({section.low}); got {section.high}")
        if step < 0 or step > high - low or (section.step is not None and step == 0):
            raise InputError(f"{where}.step must be greater than 0 and at most high - low; got {section.step}")
    places = tuple(_make_place(place, unit, f"{where}.places") for place in section.places)
    choices = _label(section.choices, where)
    tables = bool(choices) and all(isinstance(value, dict) for _, value in choices)
    if not tables and any(place.key == WHOLE for place in places):
        raise InputError(
            f"{where}.places has '{WHOLE}', the whole device file: so every choice must be a table of tables"
        )
    return DesignParameter(name, places, unit, low, high, step, choices)


def read_bound(value: str | float, unit: str, where: str, base: float | None) -> float:
    """A bound in the `unit` of its quantity; "0.9 base" is that much of the `base` device's own number."""
    match = _BASE.fullmatch(value) if isinstance(value, str) else None
    if match is not None:
        if base is None:
            raise InputError(f"{where}: '{value}', but the base device has no such value")
        return float(match[1] or 1.0) * base
    try:
        number, name = read_number(value)
        if name in ("", unit) or name == unit.replace("·", "*"):
            return number
        found = convert(number, name, unit) if unit else None
    except ValueError as cause:
        raise InputError(f"{where} {cause}") from cause
    if found is None:
        wanted = f"a number in {unit}" if unit else "a plain number"
        raise InputError(f"{where} must be {wanted}, 'base' or '0.9 base'; got {quote(value)}")
    return found


def is_base_share(value: str | float | None) -> bool:
    """Whether the bound `value` is a share of the base device's number."""
    return isinstance(value, str) and _BASE.fullmatch(value) is not None


def _read(value: str | float | None, unit: str | None, where: str) -> tuple[float, str]:
    try:
        return read_number(0.0 if value is None else value, unit)
    except ValueError as cause:
        raise InputError(f"{where} {cause}") from cause


def _make_place(place: str | PlaceSection, unit: str, where: str) -> ParameterPlace:
    if isinstance(place, PlaceSection):
        return ParameterPlace(place.key, place.factor, _read(place.offset, unit, f"{where}.offset")[0])
    if place.strip() == WHOLE:
        return ParameterPlace(WHOLE)
    match = _PLACE.fullmatch(place)
    if match is None:
        raise InputError(f"{where} must be a key, '-key' or '0.5*key'; got {quote(place)}")
    factor = float(match[2] or 1.0)
    return ParameterPlace(match[3], -factor if match[1] else factor)


def _label(choices: list[Any] | Mapping[str, Any] | None, where: str) -> tuple[tuple[str, Any], ...]:
    """Label → choice; a list of texts and numbers is its own labels, other entries are numbered."""
    if choices is None:
        return ()
    if isinstance(choices, Mapping):
        return tuple(choices.items())
    plain = all(isinstance(one, str | int | float) for one in choices)
    labels = [str(one) if plain else str(number) for number, one in enumerate(choices, 1)]
    if len(set(labels)) != len(labels):
        raise InputError(f"{where}.choices: '{max(labels, key=labels.count)}' appears twice")
    return tuple(zip(labels, choices, strict=True))
