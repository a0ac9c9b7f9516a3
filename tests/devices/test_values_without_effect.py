"""Every key of the catalogue's files changes its device; values without effect are rejected."""

import math
from dataclasses import fields, is_dataclass

import numpy as np
import pytest
from pydantic import BaseModel

import haptorb
from haptorb.devices.build_checks import BuildError
from haptorb.devices.loader import DeviceTables, build_tables, load, parse, read_tables
from haptorb.errors import HaptorbError


def flatten(value, prefix=()):
    """Everything that a device is computed from: numbers, texts and arrays by their place in its records."""
    if isinstance(value, BaseModel):
        value = value.model_dump()
    if is_dataclass(value) and not isinstance(value, type):
        skip = {"digest", "text", "assumed"}
        value = {one.name: getattr(value, one.name) for one in fields(value) if one.name not in skip}
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from flatten(inner, (*prefix, key))
    elif isinstance(value, list | tuple):
        for number, inner in enumerate(value):
            yield from flatten(inner, (*prefix, number))
    elif isinstance(value, np.ndarray):
        yield prefix, value.tobytes()
    elif not isinstance(value, str | int | float | type(None)) and hasattr(value, "__dict__"):
        yield from flatten(vars(value), prefix)
    else:
        yield prefix, value


def change(value):
    """Another value of the same form; None for a text that is no quantity."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 1
    if isinstance(value, float):
        return (1e3 if math.isinf(value) else value * 1.01) if value else 0.01
    if isinstance(value, str):
        number, _, unit = value.partition(" ")
        try:
            return f"{(float(number) or 0.01) * 1.01!r} {unit}".strip() if math.isfinite(float(number)) else None
        except ValueError:
            return None
    if isinstance(value, list) and value:
        first = change(value[0]) if not isinstance(value[0], dict) else None
        return None if first is None else [first, *value[1:]]
    return None


def list_changes(tables, path=()):
    """(key, all tables with another value there)."""
    for key, value in tables.items():
        if isinstance(value, dict) and "value" not in value:
            for name, inner in list_changes(value, (*path, key)):
                yield name, tables | {key: inner}
            continue
        plain = value["value"] if isinstance(value, dict) else value
        other = change(plain)
        if other is not None:
            yield ".".join((*path, key)), tables | {key: value | {"value": other} if isinstance(value, dict) else other}


@pytest.mark.parametrize("name", ["omni", "pmsm", "planar", "tetrahedron"])
def test_every_value_of_the_catalogue_changes_its_device(name):
    known = read_tables(name)
    before, still, tried = dict(flatten(load(name))), [], 0
    for key, values in list_changes(dict(known.values)):
        try:
            changed = build_tables(DeviceTables(name, values, known.text), override=True)
        except HaptorbError:
            continue  # a value that another one contradicts: it is read
        tried += 1
        if dict(flatten(changed)) == before:
            still.append(key)
    assert tried > 40
    assert set(still) <= {"groups.antipodal"}  # asks for a check only


@pytest.mark.parametrize(
    ("base", "tables", "key"),
    [
        ("omni", '[windings]\nfill = 0.6\n[electromagnet.moment_per_current]\nunit = "m^2"\n'
         "value = [[0.19, 0, 0], [0, 0.2, 0], [0, 0, 0.21]]", "electromagnet.moment_per_current"),
        ("omni-small-core", "[uncertainty]\nmoments = 0.02", "uncertainty.moments"),
        ("omni", "[hall]\npositions = []\ngain = 0.02", "hall.gain"),
        ("omni", '[tool]\nlength = { value = "20 mm", unit = "m" }', "tool.length.unit"),
    ],
)  # fmt: skip
def test_a_value_without_effect_is_refused_with_its_key_and_reason(base, tables, key):
    with pytest.raises(HaptorbError, match="has no effect") as refused:
        parse(f'based_on = "{base}"\nname = "own"\n{tables}', "own")
    assert key in str(refused.value)


def test_what_the_base_states_may_lose_its_effect():
    """Its author could not know; only a file's own values are refused."""
    bare = parse('based_on = "omni"\nname = "own"\n[hall]\npositions = []', "own")
    assert bare.sensors == 0
    loose = parse('based_on = "pmsm"\nname = "own"\ndrop = ["regulator"]', "own")
    assert loose.regulator is None
    with pytest.raises(HaptorbError, match=r"uncertainty\.regulator has no effect"):
        parse('based_on = "pmsm"\nname = "own"\ndrop = ["regulator"]\n[uncertainty]\nregulator = 0.05', "own")
    sizes = "[electromagnets.multipole]\ndipoles_per_loop = 16\nlength_ratio = 0.4\nstrengths = [1.5]"
    with pytest.raises(HaptorbError, match=r"electromagnets\.multipole has no effect"):
        parse(f'based_on = "pmsm"\nname = "own"\ndrop = ["magnets.multipole"]\n{sizes}', "own")


def test_a_key_that_is_dropped_and_stated_is_refused():
    with pytest.raises(HaptorbError, match=r"drop: 'tool\.length' has no effect"):
        parse('based_on = "omni"\nname = "own"\ndrop = ["tool.length"]\n[tool]\nlength = "20 mm"', "own")
    parse(
        'based_on = "omni"\nname = "own"\ndrop = ["marks"]\n[marks]\nnames = ["a", "b", "c"]\n'
        'positions = [["29 mm", "0 mm", "7 mm"], ["0 mm", "29 mm", "7 mm"], ["-25 mm", "-14 mm", "7 mm"]]',
        "own",
    )


def test_a_resistance_beside_a_fill_is_kept_and_must_agree():
    made = parse('based_on = "tetrahedron"\nname = "own"\n[windings]\nfill = 0.6', "own").coils.resistance
    assert made == pytest.approx(haptorb.load("tetrahedron").coils.resistance, rel=0.01)
    own = ", ".join(f'"{1.02 * one} ohm"' for one in made)
    kept = parse(
        f'based_on = "tetrahedron"\nname = "own"\n[windings]\nfill = 0.6\n[coils]\nresistance = [{own}]', "own"
    )
    assert kept.coils.resistance == pytest.approx(1.02 * made)
    check = next(one for one in kept.build_checks if one.condition == "wire with the stated resistance")
    assert check.value == pytest.approx(1 - 1 / 1.02, rel=1e-3)
    assert check.limit == pytest.approx(2 * kept.uncertainty.resistance)
    for base, name in (("tetrahedron", "down"), ("omni", "x")):
        wrong = ", ".join(['"0.9 ohm"'] * haptorb.load(base).channels)
        with pytest.raises(BuildError, match=rf"wire with the stated resistance.*{name}"):
            parse(
                f'based_on = "{base}"\nname = "own"\ndrop = ["coils.current_limit"]\n[windings]\nfill = 0.6\n'
                f"[coils]\nresistance = [{wrong}]", "own",
            )  # fmt: skip


def test_the_domes_wall_counts_in_a_coil_array():
    with pytest.raises(BuildError, match="windings inside the dome"):
        parse('based_on = "tetrahedron"\nname = "own"\n[dome]\nwall = "2 mm"', "own")
    parse('based_on = "tetrahedron"\nname = "own"\n[dome]\nwall = "1.7 mm"', "own")
