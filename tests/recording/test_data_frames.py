"""Recordings in pandas, xarray and notebooks: every number with its unit."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from haptorb import Recording
from haptorb.errors import InputError
from haptorb.recording.export import units_of
from haptorb.recording.mcap import Recorder
from haptorb.recording.row import Field, RowLayout

LAYOUT = RowLayout(channels=3, sensors=2)


def record(path: Path, rows: Any, layout: RowLayout = LAYOUT, *, finish: bool = True) -> Recording:
    with path.open("wb") as file:
        recorder = Recorder(file, layout, 1000.0, 10**18)
        recorder.add_metadata("device", {"name": "omni", "title": "Omni <Zárate>", "coils": '["x", "y", "z"]'})
        recorder.add_metadata("run", {"driver": "sim", "rate_hz": "1000.0", "model": "exact"})
        recorder.add_metadata("world", {"change": "0", "tick": "0", "world": '{"name": "dome", "values": {}}'})
        recorder.append(rows)
        if finish:
            recorder.add_metadata("end", {"rows": str(len(rows))})
            recorder.finish()
    return Recording(path)


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    rows = np.zeros((500, LAYOUT.width))
    rows[:, LAYOUT["tick"]] = np.arange(500)[:, None]
    rows[:, LAYOUT["t"]] = 1e-3 * np.arange(500)[:, None]
    rows[:, LAYOUT["p"]] = (0.0, 0.0, 0.05)
    rows[:, LAYOUT["wrench_commanded"]] = (0, 0, 0.25, 0, 0, 0)
    rows[:, LAYOUT["wrench_actual"]] = np.nan
    rows[:, LAYOUT["wrench_model"]] = (0, 0, 0.2, 0, 0, 0)
    rows[:, LAYOUT["current_measured"]] = (1.0, -2.5, 0.0)
    rows[:, LAYOUT["winding"]] = 310.15
    rows[200:210, LAYOUT["guard"]] = 4
    return record(tmp_path / "run.mcap", rows)


def test_pandas_has_every_number_and_its_unit(recording: Recording) -> None:
    frame = recording.to_pandas()
    assert len(frame) == 500
    assert frame.index.name == "t"
    assert frame.index[-1] == pytest.approx(0.499)
    assert (frame["p[2]"] == 0.05).all()
    assert frame.shape[1] == LAYOUT.width - 1
    units = frame.attrs["units"]
    assert set(units) == {"t", *frame.columns}
    assert (units["p[2]"], units["wrench_actual[2]"], units["wrench_actual[5]"], units["winding[0]"]) == (
        "m",
        "N",
        "N·m",
        "K",
    )
    assert frame.attrs["about"]["age"] == "age of the pose"
    assert frame.attrs["device"] == "omni"
    names = recording.path.with_suffix(".csv")
    recording.to_csv(names)
    heads = names.read_text(encoding="utf-8").splitlines()[0].split(",")
    assert [head.partition(" [")[0] for head in heads] == list(units)


def test_xarray_has_named_parts_and_units(recording: Recording) -> None:
    data = recording.to_xarray()
    assert data.sizes["t"] == 500
    assert float(data["wrench_commanded"].sel(component="F_z").max()) == 0.25
    assert float(data["p"].sel(axis="z").mean()) == pytest.approx(0.05)
    assert float(data["current_measured"].sel(channel=2).min()) == -2.5
    assert float(data["current_measured"].swap_dims(channel="coil").sel(coil="y").min()) == -2.5
    assert data["current_measured"].attrs == {"units": "A", "long_name": "measured currents"}
    assert data["t"].attrs["units"] == "s"
    assert data["field"].shape == (500, 6)
    assert set(data.data_vars) | {"t"} == {field.name for field in recording.fields}
    assert data.attrs["model"] == "exact"


@pytest.mark.parametrize("layout", [RowLayout(1, 0), RowLayout(24, 48)])
@pytest.mark.parametrize("rows", [0, 1, 3])
def test_any_device_and_few_rows(tmp_path: Path, layout: RowLayout, rows: int) -> None:
    few = record(tmp_path / "a.mcap", np.ones((rows, layout.width)), layout)
    assert few.to_pandas().shape == (rows, layout.width - 1)
    assert few.to_xarray().sizes["t"] == rows
    ElementTree.fromstring(few._repr_html_())
    assert f"{rows} row" in repr(few)


def test_cut_short_is_said(tmp_path: Path) -> None:
    cut = record(tmp_path / "a.mcap", np.ones((20_000, LAYOUT.width)), finish=False)
    assert 0 < len(cut.to_pandas()) <= 20_000
    assert "cut short" in repr(cut)


@pytest.mark.parametrize("package", ["pandas", "xarray"])
def test_without_the_package_the_error_names_what_to_install(
    recording: Recording, monkeypatch: pytest.MonkeyPatch, package: str
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(InputError, match=r"pip install 'haptorb\[notebook\]'") as told:
        getattr(recording, f"to_{package}")()
    assert len(str(told.value).splitlines()) == 1
    assert package in str(told.value)


def test_units_of_fields() -> None:
    assert units_of(Field("contacts", 16, "m, m, m, N", ""))[:8] == ("m", "m", "m", "m", "m", "N", "N", "N")
    assert units_of(Field("q", 4, "1", "")) == ("1",) * 4
    assert units_of(Field("strange", 5, "m, N", "")) == ("m, N",) * 5
    for field in RowLayout(3, 9).fields:
        assert len(units_of(field)) == field.width


def test_a_recording_shows_what_ran_and_the_force(recording: Recording) -> None:
    assert repr(recording) == "<Recording run.mcap: omni, 0.499 s, 500 rows, 1 trip>"
    html = recording._repr_html_()
    ElementTree.fromstring(html)
    for text in (
        "Omni &lt;Zárate&gt;",
        "dome",
        "250 mN",
        "2.5 A",
        "37.0 °C",
        "by the controller model",
        "<polyline",
        "complete",
    ):
        assert text in html


def test_numbers_that_are_none_are_shown_all_the_same(tmp_path: Path) -> None:
    rows = np.full((50, LAYOUT.width), np.nan)
    rows[:, LAYOUT["t"]] = np.arange(50)[:, None]
    rows[:, LAYOUT["wall"]] = 0.0
    rows[3, LAYOUT["wrench_commanded"]] = 1e300
    rows[4, LAYOUT["wrench_commanded"]] = np.inf
    ElementTree.fromstring(record(tmp_path / "a.mcap", rows)._repr_html_())
