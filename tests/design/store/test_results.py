"""Results: nothing lost, duplicated or incomplete; foreign files are refused in one line."""

from __future__ import annotations

import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from haptorb.errors import RecordingError
from haptorb_design import store as results
from haptorb_design.evaluate import evaluate
from haptorb_design.problem import Design, Evaluation, build_device, write_device_text
from haptorb_design.store import open_results, read_results
from haptorb_design.workers import compute_base_values
from oracles.designs.small_design import TEXT, make_design, write_design


@pytest.fixture(scope="module")
def design(tmp_path_factory: pytest.TempPathFactory) -> Design:
    return make_design(tmp_path_factory.mktemp("design"))


def make_rows(first: int, last: int) -> list[Evaluation]:
    draw = random.Random(first)
    return [
        Evaluation(
            number, {"radius": draw.random(), "angle": 50.0, "shell": "thin"}, {"cost": draw.random(), "reach": 1 / 3},
            {"room": draw.random()}, *(("room", "is “too” wide", 0.1) if number % 3 == 0 else ("", "", 1e-3)),
        )
        for number in range(first, last)
    ]  # fmt: skip


def test_what_is_stored_is_read_to_the_last_bit(design: Design, tmp_path: Path) -> None:
    where, rows = tmp_path / "r.sqlite", make_rows(0, 50)
    with open_results(where, design, "sobol", 1) as writer:
        writer.add(rows[:20])
        writer.add(rows[10:])  # some of them again
        assert read_results(where).evaluations == tuple(rows)  # while it is being written
    with open_results(where, design, "sobol", 1) as writer:
        assert writer.list_known() == {row.number: row for row in rows}
    with open_results(where, design, "sobol", 2, settings={"count": 3}) as writer:
        assert writer.list_known() == {}
        writer.add(rows[:3])
    found = read_results(where)
    assert [(run.method, run.seed, dict(run.settings), len(run.evaluations)) for run in found.runs] == [
        ("sobol", 1, {}, 50),
        ("sobol", 2, {"count": 3}, 3),
    ]


def test_the_design_that_is_read_needs_no_file(tmp_path: Path) -> None:
    path = write_design(tmp_path)
    design = make_design(tmp_path)
    with open_results(tmp_path / "r.sqlite", design, "sobol", 1) as writer:
        values = {"radius": 30.0, "angle": 55.0, "shell": "thin"}
        writer.add([evaluate(design, 0, values)])
    path.unlink()
    (tmp_path / "own.py").unlink()
    again = read_results(tmp_path / "r.sqlite").design
    for field in ("name", "title", "base", "parameters", "options", "text", "digest", "tables"):
        assert getattr(again, field) == getattr(design, field)
    assert [(goal.name, goal.sense, goal.quantity.unit, goal.quantity.text) for goal in again.goals] == [
        (goal.name, goal.sense, goal.quantity.unit, goal.quantity.text) for goal in design.goals
    ]
    assert [(one.name, one.low, one.high) for one in again.bounds] == [("room", None, 0.031)]
    assert write_device_text(again, values, "a") == write_device_text(design, values, "a")
    assert build_device(again, values).digest == build_device(design, values).digest
    assert "cannot be computed from a results file" in evaluate(again, 0, values).reason
    assert again.base_values == compute_base_values(design)  # of own functions too, which are not there any more
    assert sorted(again.base_values or ()) == ["constraints.room", "objectives.cost", "objectives.reach"]


def test_ten_thousand_designs_open_in_no_time(design: Design, tmp_path: Path) -> None:
    where, rows = tmp_path / "r.sqlite", make_rows(0, 10_000)
    with open_results(where, design, "sobol", 1) as writer:
        writer.add(rows)
    begin = time.process_time()
    with open_results(where, design, "sobol", 1) as writer:
        assert len(writer.list_known()) == 10_000
    assert len(read_results(where).evaluations) == 10_000
    assert time.process_time() - begin < 5.0  # processor time: 0.4 s


def test_one_program_for_a_run(design: Design, tmp_path: Path) -> None:
    where = tmp_path / "r.sqlite"
    with open_results(where, design, "sobol", 1) as writer:
        with (
            pytest.raises(RecordingError, match="another program is writing run 1"),
            open_results(where, design, "sobol", 1),
        ):
            pass
        with open_results(where, design, "sobol", 2) as other:  # another run of the same design may go on beside it
            other.add(make_rows(0, 3))
        writer.add(make_rows(0, 3))
    with open_results(where, design, "sobol", 1) as writer:
        assert len(writer.list_known()) == 3


def test_another_design_version_or_wish(design: Design, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    where = tmp_path / "r.sqlite"
    with open_results(where, design, "sobol", 1) as writer:
        writer.add(make_rows(0, 3))
    changed = make_design(tmp_path, TEXT.replace("26 mm", "27 mm"))
    with pytest.raises(RecordingError, match="before a change"), open_results(where, changed, "sobol", 1):
        pass
    other = replace(changed, name="other", digest="1" * 64)
    with pytest.raises(RecordingError, match="belong to design 'small'"), open_results(where, other, "sobol", 1):
        pass
    with (
        pytest.raises(RecordingError, match="already contain sobol with seed 1"),
        open_results(where, design, "sobol", 1, resume=False),
    ):
        pass
    monkeypatch.setattr(results, "__version__", "9.9.9")
    with pytest.raises(RecordingError, match=r"begun with haptorb .*, this is 9\.9\.9"):  # noqa: SIM117
        with open_results(where, design, "sobol", 1):
            pass
    assert len(read_results(where).evaluations) == 3


def test_files_that_are_no_results(design: Design, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("not a database, but long enough to be one")
    with closing(sqlite3.connect(tmp_path / "other.db", isolation_level=None)) as other:
        other.execute("CREATE TABLE animals (name TEXT)")
    with open_results(tmp_path / "newer.sqlite", design, "sobol", 1):
        pass
    with closing(sqlite3.connect(tmp_path / "newer.sqlite", isolation_level=None)) as newer:
        newer.execute("UPDATE haptorb_design_schema SET version = 99")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    for name, told in (
        ("notes.txt", "is not a database"),
        ("other.db", "is a database of another program"),
        ("newer.sqlite", "has schema 99; this haptorb knows up to 1"),
        ("", "is a folder"),
        ("nowhere/r.sqlite", "there is no folder"),
    ):
        with pytest.raises(RecordingError, match=told), open_results(tmp_path / name, design, "sobol", 1):
            pass
    for name, told in (
        ("notes.txt", "is not a database"),
        ("none.sqlite", "does not exist"),
        ("other.db", "another program"),
    ):
        with pytest.raises(RecordingError, match=told):
            read_results(tmp_path / name)
    assert not (tmp_path / "none.sqlite").exists()
    assert before == {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    (tmp_path / "half.sqlite").write_bytes(before["newer.sqlite"][:5000])
    with pytest.raises(RecordingError, match=r"half\.sqlite"):
        read_results(tmp_path / "half.sqlite")


def test_a_full_disk_loses_nothing(design: Design, tmp_path: Path) -> None:
    where = tmp_path / "r.sqlite"
    with open_results(where, design, "sobol", 1) as writer:
        writer.add(make_rows(0, 10))
        with writer._engine.connect() as connection:  # SQLite's own word for a disk of so many pages
            pages = connection.exec_driver_sql("PRAGMA page_count").scalar_one()
            connection.exec_driver_sql(f"PRAGMA max_page_count = {pages + 2}")
        with pytest.raises(RecordingError, match=r"full.*10 designs of this run are stored"):
            writer.add(make_rows(10, 1000))
        assert len(writer.list_known()) == 10
    assert read_results(where).evaluations == tuple(make_rows(0, 10))
    with open_results(where, design, "sobol", 1) as writer:
        writer.add(make_rows(10, 1000))
        assert len(writer.list_known()) == 1000


KILLED = """
import sys
sys.path[:0] = {paths}
from pathlib import Path
from oracles.designs.small_design import make_design
from haptorb_design.problem import Evaluation
from haptorb_design.store import open_results
with open_results({where!r}, make_design(Path({folder!r})), "sobol", 1) as writer:
    n = 0
    while True:
        values = {{"radius": 1.0, "angle": 50.0, "shell": "thin"}}
        writer.add([Evaluation(n + k, values, {{"cost": 1.0, "reach": 1.0}}, {{}}) for k in range(7)])
        n += 7
        print(n, flush=True)
"""


def test_a_program_that_is_killed_leaves_whole_batches_and_no_lock(tmp_path: Path) -> None:
    where = str(tmp_path / "r.sqlite")
    paths = [str(Path(__file__).parents[2]), *filter(None, sys.path)]
    program = KILLED.format(paths=paths, where=where, folder=str(tmp_path))
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        told = [int(process.stdout.readline()) for _ in range(5)]
        os.kill(process.pid, signal.SIGKILL)
    found = read_results(where).evaluations
    assert len(found) >= told[-1]
    assert [one.number for one in found] == list(range(len(found)))
    assert len(found) % 7 == 0
    with open_results(where, make_design(tmp_path), "sobol", 1) as writer:
        assert len(writer.list_known()) == len(found)
