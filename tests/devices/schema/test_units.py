"""The units that are read without pint, against pint."""

from __future__ import annotations

import itertools
import math
import tomllib
from importlib.resources import files
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from haptorb.devices.schema import quantity
from haptorb.devices.schema.units import PREFIXED, PREFIXES, WHOLE, convert, split_unit

NAMES = sorted({*WHOLE, *PREFIXED, *(prefix + unit for prefix, unit in itertools.product(PREFIXES, PREFIXED))})
#: units in which values are wanted
WANTED = ("m", "rad", "kg", "s", "N", "N*m", "N/m", "N*s/m", "N*m/rad", "N*m*s/rad", "kg*m**2", "A", "A/s", "V", "ohm",
          "H", "F", "T", "m**2", "K", "delta_degC", "J/K", "W/K", "1/K", "Pa", "")  # fmt: skip


def by_pint(number: float, unit: str, wanted: str) -> float:
    return quantity._ask_pint(number, unit, wanted)


def values(raw: Any) -> list[str]:
    """Every text of a device file that begins like a number."""
    if isinstance(raw, dict):
        if "unit" in raw:
            return [f"{x} {raw['unit']}" for x in numbers(raw["value"])]
        return [text for key, part in raw.items() if key not in ("source", "assumed") for text in values(part)]
    if isinstance(raw, list):
        return [text for part in raw for text in values(part)]
    return [raw] if isinstance(raw, str) and quantity._NUMBER.fullmatch(raw) and not raw.startswith("inf") else []


def numbers(value: Any) -> list[float]:
    return [x for part in value for x in numbers(part)] if isinstance(value, list) else [value]


@pytest.mark.parametrize("name", NAMES)
def test_every_unit_is_what_pint_takes_it_for(name: str) -> None:
    wanted = [unit for unit in (*WANTED, "1/s", "W") if convert(1.0, name, unit) is not None]
    assert wanted
    for unit in wanted:
        assert convert(1.7, name, unit) == pytest.approx(by_pint(1.7, name, unit), rel=4e-16)


@pytest.mark.parametrize("device", sorted(path.name for path in (files("haptorb.devices") / "catalogue").iterdir()))
def test_values_of_the_catalogue_are_the_same_to_the_last_digit_and_pint_is_not_asked(device: str) -> None:
    raw = tomllib.loads((files("haptorb.devices") / "catalogue" / device).read_text(encoding="utf-8"))
    told, asked = values(raw), 0
    for text in told:
        match = quantity._NUMBER.fullmatch(text)
        assert match
        number, unit = float(match[1]), match[2]
        for wanted in WANTED:
            here = convert(number, unit, wanted)
            if here is not None:
                asked += 1
                assert float(f"{here:.15g}") == float(f"{by_pint(number, unit, wanted):.15g}"), text
    assert asked >= len(told)  # a variant may have none of its own


@given(st.floats(allow_nan=False, allow_infinity=False), st.sampled_from(["mm", "inch", "deg", "N*m/rad", "1/K", "%"]))
def test_numbers_of_any_size_are_converted_or_refused_as_pint_does(number: float, unit: str) -> None:
    wanted = {"mm": "m", "inch": "m", "deg": "rad", "N*m/rad": "N*m", "1/K": "1/K", "%": ""}[unit]
    here = convert(number, unit, wanted)
    assert here is not None
    assert here == pytest.approx(by_pint(number, unit, wanted), rel=1e-15, abs=1e-320)


@pytest.mark.parametrize(
    ("text", "factors"),
    [
        ("N*m", (("N", 1), ("m", 1))), ("m/s/s", (("m", 1), ("s", -1), ("s", -1))), ("", ()),
        ("kg m²", (("kg", 1), ("m", 2))), ("1/K", (("K", -1),)), ("m⁻¹", (("m", -1),)), ("°", (("degree", 1),)),
        ("N per mm", (("N", 1), ("mm", -1))), ("m**-2", (("m", -2),)),
    ],
)  # fmt: skip
def test_units_are_split(text: str, factors: tuple[tuple[str, int], ...]) -> None:
    assert split_unit(text) == factors


@pytest.mark.parametrize("text", ["m^99", "m//s", "m*", "(m", "2 m", "m m m m m m m m m", "m\0"])
def test_what_is_no_unit_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"character|factors"):
        split_unit(text)
    assert convert(1.0, text, "m") is None


@pytest.mark.parametrize(
    ("number", "unit", "wanted"),
    [
        (1.0, "furlong", "m"),
        (1.0, "kg", "m"),
        (1.0, "degC", "delta_degC"),
        (1.0, "degC/m", "K/m"),
        (math.inf, "m", "m"),
    ],
)
def test_the_rest_is_for_pint(number: float, unit: str, wanted: str) -> None:
    assert convert(number, unit, wanted) is None


def test_other_units_are_read_with_pint() -> None:
    assert quantity.si("1 nautical_mile", "m", "a length") == 1852.0
    assert quantity.si("25 degC", "K", "a temperature") == 298.15
    assert quantity.si("inf", "", "a number") == math.inf
