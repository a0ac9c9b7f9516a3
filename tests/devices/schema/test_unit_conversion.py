"""Units parsed without pint, against pint."""

from __future__ import annotations

import itertools
import math
import tomllib
from importlib.resources import files
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from haptorb.devices import quantity
from haptorb.devices.unit_conversion import PREFIXED, PREFIXES, WHOLE, convert, split_unit

NAMES = sorted({*WHOLE, *PREFIXED, *(prefix + unit for prefix, unit in itertools.product(PREFIXES, PREFIXED))})
#: units in which values are wanted
WANTED = ("m", "rad", "kg", "s", "N", "N*m", "N/m", "N*s/m", "N*m/rad", "N*m*s/rad", "kg*m**2", "A", "A/s", "V", "ohm",
          "H", "F", "T", "m**2", "A*m**2", "K", "delta_degC", "J/K", "W/K", "1/K", "Pa", "")  # fmt: skip


def by_pint(number: float, unit: str, wanted: str) -> float:
    return quantity._convert_with_pint(number, unit, wanted)


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


@pytest.mark.parametrize(
    ("text", "wanted", "number"),
    [
        ("13480 gauss", "T", 1.348), ("13.48 kG", "T", 1.348), ("13.48 kGs", "T", 1.348), ("200 mG", "T", 2e-5),
        ("1 kOe", "T", 0.1), ("1000 kA/m", "T", 0.4 * math.pi), ("795.7747154594767 kA/m", "T", 1.0),
        ("1000 emu/cm^3", "T", 0.4 * math.pi), ("200 emu/A", "m**2", 0.2), ("0.2 Am²/A", "m**2", 0.2),
        ("250 mil", "m", 6.35e-3), ("250 thou", "m", 6.35e-3), ("60 mNm", "N*m", 0.06),
        ("2 mNms/rad", "N*m*s/rad", 2e-3), ("12 Ns/m", "N*s/m", 12.0), ("22 Ohm", "ohm", 22.0),
        ("80 turns", "", 80.0), ("1 turn", "rad", 2 * math.pi),
    ],
)  # fmt: skip
def test_units_of_magnetics_and_workshops_are_read(text: str, wanted: str, number: float) -> None:
    """1 G = 1e-4 T, 1 Oe = 1000/4π A/m, 1 emu = 1e-3 A·m², 1 mil = 25.4 µm; pint says otherwise, or nothing."""
    assert quantity.si(text, wanted, "a value") == pytest.approx(number, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "wanted", "told"),
    [
        ("24 milimeter", "m", "did you mean 'millimeter'?"),
        ("24 kg", "m", "(units: mm, cm"),
        ("12 Volts", "V", "did you mean 'volt'?"),
        ("5 TESLA", "T", "did you mean 'tesla'?"),
        ("26 gr", "kg", "write 'g' (gram) or 'grain'"),
        ("5 G/T", "T", "gauss, kG"),
    ],
)
def test_a_unit_that_cannot_be_used_lists_what_can(text: str, wanted: str, told: str) -> None:
    with pytest.raises(ValueError, match="must be a value") as refused:
        quantity.si(text, wanted, "a value")
    assert told in str(refused.value)
