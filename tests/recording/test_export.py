"""Exports: the same numbers in three formats, with units, a time range, selected fields; all or nothing."""

from __future__ import annotations

import json

import numpy as np
import pytest

from haptorb import Recording
from haptorb.errors import InputError, RecordingError, UnknownName
from haptorb.recording.export import FORMATS, Export
from haptorb.recording.mcap import Recorder
from haptorb.recording.row import RowLayout
from oracles.command import run_command

LAYOUT = RowLayout(channels=2, sensors=1)
ROWS = 500


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("export") / "run.mcap"
    rows = np.random.default_rng(3).normal(size=(ROWS, LAYOUT.width))
    rows[:, LAYOUT["t"]] = 10.0 + 1e-3 * np.arange(ROWS)[:, None]
    with path.open("wb") as out:
        recorder = Recorder(out, LAYOUT, 1000.0, 10**18)
        recorder.add_metadata("device", {"name": "omni"})
        recorder.add_metadata("run", {"driver": "sim", "rate_hz": "1000.0"})
        recorder.append(rows)
        recorder.finish()
    return path


@pytest.fixture(scope="module")
def recording(file):
    return Recording(file)


def read_table(path, form):
    """Columns by name, whichever program reads that format."""
    if form == "csv":
        head, *lines = path.read_text(encoding="utf-8").splitlines()
        numbers = np.array([[float(cell) for cell in line.split(",")] for line in lines])
        return {name.split(" ")[0]: numbers[:, i] for i, name in enumerate(head.split(","))}
    if form == "parquet":
        from pyarrow import parquet

        table = parquet.read_table(path)
        return {name: table[name].to_numpy() for name in table.column_names}
    with np.load(path) as archive:
        wide = {name: archive[name] for name in archive.files if name != "about"}
    return {
        (f"{name}[{i}]" if values.ndim == 2 else name): column
        for name, values in wide.items()
        for i, column in enumerate(np.atleast_2d(values.T))
    }


@pytest.mark.parametrize("form", FORMATS)
def test_every_number_arrives_bit_for_bit(recording, tmp_path, form):
    Export.of(recording, form).write(tmp_path / "out")
    columns = read_table(tmp_path / "out", form)
    assert len(columns) == LAYOUT.width
    assert np.array_equal(np.column_stack(list(columns.values())), recording.rows)


@pytest.mark.parametrize("form", FORMATS)
def test_a_range_of_time_and_some_fields(recording, tmp_path, form):
    part = Export.of(recording, form, ["p", "t"], 0.1, 0.2)
    part.write(tmp_path / "out")
    columns = read_table(tmp_path / "out", form)
    assert list(columns) == ["p[0]", "p[1]", "p[2]", "t"]
    assert np.array_equal(columns["t"], recording["t"][100:201])
    assert np.array_equal(columns["p[1]"], recording["p"][100:201, 1])


def test_units_go_with_the_numbers(recording, tmp_path):
    from pyarrow import parquet

    for form in FORMATS:
        Export.of(recording, form, ["wrench_commanded"]).write(tmp_path / form)
    heads = (tmp_path / "csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert heads == [f"wrench_commanded[{i}] [{'N' if i < 3 else 'N·m'}]" for i in range(6)]
    schema = parquet.read_schema(tmp_path / "parquet")
    assert schema.field("wrench_commanded[3]").metadata[b"unit"].decode() == "N·m"
    assert schema.metadata[b"device"] == b"omni"
    with np.load(tmp_path / "npz") as archive:
        about = json.loads(str(archive["about"]))
    assert about["fields"]["wrench_commanded"]["unit"] == "N, N·m"
    assert about["recording"]["device"] == "omni"


@pytest.mark.parametrize(
    ("error", "arguments"),
    [
        (UnknownName, {"form": "xlsx"}),
        (UnknownName, {"form": "csv", "fields": ["p", "nothing"]}),
        (InputError, {"form": "csv", "fields": []}),
        (InputError, {"form": "csv", "start": 0.6}),
        (InputError, {"form": "csv", "start": 0.2, "end": 0.1}),
        (InputError, {"form": "csv", "end": -1.0}),
        (InputError, {"form": "csv", "start": float("nan")}),
    ],
)
def test_what_cannot_be_is_refused(recording, error, arguments):
    with pytest.raises(error):
        Export.of(recording, **arguments)


def test_nothing_is_left_where_writing_fails(recording, tmp_path, monkeypatch):
    monkeypatch.setitem(FORMATS, "csv", lambda export, path, report: path.write_text("half") and 1 / 0)
    with pytest.raises(ZeroDivisionError):
        Export.of(recording, "csv").write(tmp_path / "out.csv")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(RecordingError, match="cannot write"):
        Export.of(recording, "npz").write(tmp_path / "nowhere" / "out.npz")


def test_the_command_writes_and_keeps_what_is_there(file, tmp_path, capsys):
    out = tmp_path / "part.csv"
    command = ["export", str(file), "-o", str(out), "--start", "100 ms", "--end", "0.2", "--fields", "t, p"]
    code, text, _ = run_command(capsys, *command, "--json")
    assert (code, json.loads(text)["ticks"]) == (0, 101)
    before = out.read_bytes()
    code, _, text = run_command(capsys, *command)
    assert code == 2
    assert "--force" in text
    assert out.read_bytes() == before
    assert run_command(capsys, *command, "--force")[0] == 0
    for wrong in (["--to", "xlsx"], ["--start", "1 kg"], ["--fields", "nothing"], ["-o", f"{tmp_path}/no/a.csv"]):
        assert run_command(capsys, "export", str(file), "-o", str(tmp_path / "b"), *wrong)[0] == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["part.csv"]


def test_info_tells_the_same_in_words_and_json(file, recording, capsys, tmp_path):
    code, text, _ = run_command(capsys, "info", str(file), "--json")
    told = json.loads(text)
    assert (code, told["ticks"], told["device"], told["complete"], told["rate_hz"]) == (0, ROWS, "omni", True, 1000.0)
    assert told["duration_s"] == pytest.approx(0.499)
    size = float(np.linalg.norm(recording["wrench_commanded"][:, :3], axis=1).max())
    assert told["run"]["largest_commanded_force_n"] == pytest.approx(size)
    assert {"name": "p", "width": 3, "unit": "m"}.items() <= next(f for f in told["fields"] if f["name"] == "p").items()
    words = run_command(capsys, "info", str(file))[1]
    assert "500 rows" in words
    assert "omni" in words
    assert "N·m" in run_command(capsys, "info", str(file), "--fields")[1]
    assert run_command(capsys, "info", str(tmp_path / "nothing.mcap"))[0] == 2
