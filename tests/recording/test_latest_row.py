"""The newest tick by field names: values, units, unknown names, and representation."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from haptorb.errors import UnknownName
from haptorb.recording.row import LatestRow, RowLayout

LAYOUT = RowLayout(channels=3, sensors=0)


@pytest.fixture
def row() -> LatestRow:
    numbers = np.zeros(LAYOUT.width)
    numbers[LAYOUT["tick"]], numbers[LAYOUT["t"]], numbers[LAYOUT["guard"]] = 512, 0.512, 2
    numbers[LAYOUT["p"]] = 0.0, 0.0, 0.05
    numbers[LAYOUT["wrench_actual"]] = 0.0, 0.0, 0.25, 0.0, 0.002, 0.0
    numbers[LAYOUT["winding"]] = 298.15, 303.15, 300.0
    return LatestRow(LAYOUT, numbers)


def test_every_field_has_its_name_its_place_and_its_unit(row: LatestRow) -> None:
    for field in LAYOUT.fields:
        value = row[field.name]
        assert np.array_equal(getattr(row, field.name), value)
        assert np.array_equal(np.atleast_1d(value), row[LAYOUT[field.name]])
        assert isinstance(value, float) == (field.width == 1)
        assert row.units[field.name] == field.unit
    assert row.t == 0.512
    assert row.wrench_actual[2] == row["wrench_actual"][2] == 0.25
    assert row.temperature.tolist() == row.winding.tolist() == [298.15, 303.15, 300.0]
    assert row.units["temperature"] == "K"


def test_it_is_all_numbers_for_numpy_and_passes_between_processes(row: LatestRow) -> None:
    assert np.asarray(row).shape == (LAYOUT.width,)
    np.array(row)[0] = 7.0
    assert row.tick == 512, "a copy is one"
    again = pickle.loads(pickle.dumps(row))
    assert np.array_equal(again.numbers, row.numbers)


def test_a_name_that_is_none_is_told_with_the_nearest(row: LatestRow) -> None:
    with pytest.raises(UnknownName, match="'wrench_actua'; did you mean 'wrench_actual'"):
        row["wrench_actua"]
    with pytest.raises(AttributeError, match="'temprature'; did you mean 'temperature'"):
        row.temprature  # noqa: B018
    assert not hasattr(row, "forces")
    assert {"wrench_actual", "p", "temperature"} <= set(dir(row))


def test_it_shows_names_values_and_units(row: LatestRow) -> None:
    short, long = repr(row), str(row)
    assert len(short.splitlines()) == 2
    for part in (
        "tick 512",
        "0.512 s",
        "running",
        "p (0, 0, 50) mm",
        "wrench_actual (0, 0, 250) mN, (0, 2, 0) mN·m",
        "30 °C",
    ):
        assert part in short
    shown = {line.split()[0]: line for line in long.splitlines()}
    assert list(shown) == [field.name for field in LAYOUT.fields if field.width]
    assert shown["wrench_actual"].endswith("(0, 0, 250) mN, (0, 2, 0) mN·m")
    assert shown["guard"].endswith("2 (running)")
    assert shown["winding"].endswith(" K")


def test_what_is_not_known_yet_shows_as_unknown() -> None:
    row = LatestRow(LAYOUT, LAYOUT.empty())
    assert "guard unknown" in repr(row)
    assert "unknown" in str(row)
