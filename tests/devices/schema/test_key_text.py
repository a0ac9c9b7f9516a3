"""Reference of all files: every key with meaning, unit, range and default, consistent with validation."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

import pytest
from pydantic import BaseModel, Field

from haptorb.devices import quantity as q
from haptorb.devices import schema as m
from haptorb.devices.registry import find_file, kind_names
from haptorb.devices.schema import KeyText, list_keys
from haptorb_study.feel.designs import DesignFile, DesignTable
from haptorb_study.study_file import Study


def models() -> Iterator[type[BaseModel]]:
    yield from (find_file(name, name) for name in kind_names())
    yield from (Study, DesignFile, DesignTable)


def keys() -> list[tuple[str, KeyText]]:
    return [(model.__name__, key) for model in models() for key in list_keys(model)]


@pytest.mark.parametrize(("model", "key"), keys(), ids=lambda part: part if isinstance(part, str) else part.path)
def test_every_key_has_meaning_unit_range_and_default(model: str, key: KeyText) -> None:
    for name in ("meaning", "value", "unit", "range", "default"):
        assert getattr(key, name).strip(), f"{model}: {key.path} has no {name}"
    assert not key.meaning.endswith(".")


class Inner(BaseModel):
    angle: Annotated[q.Angle, Field(gt=0, le=q.si("90 deg", "rad", "an angle")), m.Meaning("an angle")]


class File(BaseModel):
    size: Annotated[q.Length, Field(gt=0), m.Meaning("how large")]
    share: Annotated[q.Number, Field(ge=0, lt=1), m.Meaning("what part")] = 0.5
    way: Annotated[Literal["up", "down"], m.Meaning("which way")] = "up"
    wait: Annotated[Annotated[float, Field(gt=0)] | None, m.Unit("s"), m.Without("for ever")] = None
    inner: tuple[Inner, ...] = ()


def test_what_a_schema_says_is_what_its_rows_say() -> None:
    rows = {key.path: key for key in list_keys(File)}
    assert rows["size"] == KeyText("size", "how large", "length", "mm, cm, m", "> 0", "required")
    assert rows["share"] == KeyText("share", "what part", "number", "1", "≥ 0, < 1", "0.5")
    assert rows["way"] == KeyText("way", "which way", "text", "none", '"up", "down"', '"up"')
    assert (rows["wait"].meaning, rows["wait"].unit, rows["wait"].default) == ("", "s", "for ever")
    assert rows["inner"].value == "list of tables"
    assert rows["inner"].default == ""  # nobody said what holds without it: found by the test above
    assert rows["inner.angle"].range == "> 0, ≤ 90 deg"


def test_the_kinds_that_were_wrong() -> None:
    motor = {key.path: key for key in list_keys(find_file("spherical-motor", "pmsm"))}
    assert (motor["sensors.cross"].value, motor["sensors.cross"].unit) == ("number", "1")
    assert motor["groups.coils"].value == "list of 1 to 48 lists of 1 to 48 whole numbers"
    assert motor["groups.antipodal"].value == "true or false"
    assert motor["groups.winding"].range == '"series-aiding", "series-opposed", "matched"'
    assert motor["magnets.multipole.strengths"].unit == "A·m"
    magnet = {key.path: key for key in list_keys(find_file("spherical-electromagnet", "omni"))}
    assert magnet["hall.positions"].value == "list of 0 to 100 lists of 3 lengths"
    assert magnet["electromagnet.moment_per_current"].default == "computed from [windings]"
