"""Damaged and truncated recordings: every undamaged chunk is read, and the loss is reported."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import warnings
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from haptorb import Recording
from haptorb.errors import RecordingError, RecordingWarning
from haptorb.recording import recording as recording_module
from oracles.command import run_command
from oracles.made_recording import make_recording

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def benchmark_program() -> ModuleType:
    """tests/fuzz/damaged_recordings.py."""
    path = ROOT / "tests" / "fuzz" / "damaged_recordings.py"
    spec = importlib.util.spec_from_file_location("damaged_recordings", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    path = tmp_path_factory.mktemp("damaged") / "whole.mcap"
    return path, make_recording(path, 1.0)


def damage(source: Path, out: Path, *places: int) -> Path:
    """The file with other bytes at these places."""
    data = bytearray(source.read_bytes())
    for at in places:
        data[at] ^= 0x40
    out.write_bytes(data)
    return out


def list_chunks(path: Path) -> list[Any]:
    """As the makers' reader lists them."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return sorted(summary.chunk_indexes, key=lambda one: one.chunk_start_offset)


def middle(path: Path) -> int:
    """A place within the rows of the middle chunk."""
    chunks = list_chunks(path)
    one = chunks[len(chunks) // 2]
    return int(one.chunk_start_offset + one.chunk_length // 2)


def open_damaged(path: Path) -> Recording:
    with pytest.warns(RecordingWarning):
        return Recording(path)


def test_rows_of_undamaged_chunks_are_read_and_losses_named(
    benchmark_program: ModuleType, whole: tuple[Path, np.ndarray], tmp_path: Path
) -> None:
    """The nightly experiment with few files."""
    found = benchmark_program.measure(whole[0], 24, 1, 3, tmp_path)
    assert found["silent"] == []
    assert found["wrong"] == 0
    assert found["losses"] > 12
    assert found["share"] >= 0.99


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_thousand_damaged_recordings() -> None:
    program = [sys.executable, "tests/fuzz/damaged_recordings.py", "--files", "1000", "--json"]
    done = subprocess.run(program, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert json.loads(done.stdout)["share"] >= 0.99


@pytest.mark.parametrize("where", ["first chunk and summary", "magic bytes", "end", "header", "length of a chunk"])
def test_damage_where_it_hurts_most_costs_one_chunk(where: str, whole: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    path, rows = whole
    chunks, size = list_chunks(path), path.stat().st_size
    middle, first = chunks[len(chunks) // 2], chunks[0]
    inside = middle.chunk_start_offset + middle.chunk_length // 2
    places = {
        "first chunk and summary": (first.chunk_start_offset + first.chunk_length // 2, size - 200, inside),
        "magic bytes": (1, 4, inside),
        "end": (size - 1, size - 20, inside),
        "header": (10, 14, inside),
        "length of a chunk": (size - 200, middle.chunk_start_offset + 3),
    }[where]
    recording = open_damaged(damage(path, tmp_path / "damaged.mcap", *places))
    ticks = recording["tick"][:].astype(int)
    assert recording.rows.tobytes() == rows[ticks].tobytes()
    assert len(rows) - len(ticks) <= 2 * 45
    assert not recording.truncated
    assert sum(one.rows or 0 for one in recording.missing) == len(rows) - len(ticks)
    inner = recording.missing[-1]
    assert inner.start == rows[ticks[inner.row - 1], 1]
    assert inner.end == rows[ticks[inner.row], 1]


def test_a_long_recording_loses_no_more_than_a_short_one(
    whole: tuple[Path, np.ndarray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = damage(whole[0], tmp_path / "damaged.mcap", middle(whole[0]))
    short = open_damaged(path)
    monkeypatch.setattr(recording_module, "_MAX_WHOLE_BYTES", 0)
    long = Recording(path)
    assert long.long
    assert not long.checked
    with pytest.raises(RecordingError, match=r"damaged at row.*recording\.check\(\)"):
        np.asarray(long["p"])
    with pytest.warns(RecordingWarning, match="rows are missing between"):
        assert long.check()
    assert long.missing == short.missing
    assert long.damage == short.damage
    assert long.rows.tobytes() == short.rows.tobytes()
    with pytest.warns(RecordingWarning):
        assert len(Recording(path).to_pandas()) == len(short)
    words = ("export", str(path), "-o", str(tmp_path / "out.csv"), "--json")
    assert json.loads(run_command(capsys, *words)[1])["ticks"] == len(short)


def test_a_repaired_file_is_whole_for_the_makers_reader(
    whole: tuple[Path, np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = damage(whole[0], tmp_path / "damaged.mcap", middle(whole[0]))
    before, rows = path.read_bytes(), open_damaged(path).rows
    out = tmp_path / "repaired.mcap"
    code, text, error = run_command(capsys, "info", str(path), "--repair", str(out))
    assert code == 0
    assert "rows are missing between" in error
    assert f"{len(rows)} rows" in text
    with out.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == sum(1 for _ in reader.iter_messages()) == len(rows)
    repaired = Recording(out)
    assert not repaired.truncated
    assert "rows are missing between" in repaired.metadata["repair"]["damage"]
    assert "rows are missing between" in run_command(capsys, "info", str(out))[1]
    assert repaired.rows.tobytes() == rows.tobytes()
    assert [name for name, _ in repaired.notes[:-1]] == [name for name, _ in Recording(whole[0]).notes]
    for place in (path, tmp_path / "." / path.name):
        assert run_command(capsys, "info", str(path), "--repair", str(place), "--force")[0] == 2
    (tmp_path / "link.mcap").symlink_to(path)
    assert run_command(capsys, "info", str(path), "--repair", str(tmp_path / "link.mcap"), "--force")[0] == 2
    assert run_command(capsys, "info", str(path), "--repair", str(out))[0] == 2
    assert path.read_bytes() == before


@pytest.mark.parametrize("damaged", [True, False])
def test_export_names_what_is_missing_in_its_words_its_json_and_its_file(
    damaged: bool, whole: tuple[Path, np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "run.mcap", tmp_path / "out.npz"
    size = whole[0].stat().st_size
    if damaged:
        damage(whole[0], path, middle(whole[0]))
    else:
        path.write_bytes(whole[0].read_bytes()[: size // 2])
    code, text, error = run_command(capsys, "export", str(path), "--to", "npz", "-o", str(out), "--json")
    told = json.loads(text)
    assert code == 0
    assert ("rows are missing between" in error) == damaged
    assert ("the end after" in error) == (not damaged)
    assert told["truncated"] == (not damaged)
    assert len(told["missing"]) == 1
    if damaged:
        assert told["rows_missing"] == 1000 - told["ticks"]
        assert 0.3 < told["missing"][0]["start_s"] < told["missing"][0]["end_s"] < 0.7
    with np.load(out, allow_pickle=False) as archive:
        about = json.loads(str(archive["about"]))["recording"]
        assert len(archive["t"]) == told["ticks"]
    assert ("damage" in about) == damaged
    assert ("truncated" in about) == (not damaged)


def test_a_note_that_cannot_be_read_is_named(whole: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    at = whole[0].read_bytes().index(b"haptorb/run")
    recording = open_damaged(damage(whole[0], tmp_path / "damaged.mcap", at + 9))
    assert len(recording) == 1000
    assert any("'haptorb/run'" in text for text in recording.damage)


def test_a_whole_recording_is_not_called_damaged(whole: tuple[Path, np.ndarray]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        recording = Recording(whole[0])
    assert (recording.missing, recording.damage, recording.checked) == ((), (), True)
