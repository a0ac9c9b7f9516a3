"""`haptorb bench` as one table: every benchmark runs, states its comparison, and is stored and read again."""

import io
import json
from functools import cache

import numpy as np
import pytest
from rich.console import Console

from haptorb.cli import main
from haptorb.errors import InputError, UnknownName
from haptorb_bench import BENCHMARKS, BenchResult, Metric, load_result, outside, run_benchmarks, starting

pytestmark = pytest.mark.timeout(900)  # the first run on a machine compiles all kernels

SHORT = 0.02
QUICK = ("allocation", "estimation", "tick", "start", "recording", "study")


@pytest.fixture(scope="module")
def quick():
    told = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(starting, "_first_tick", cache(starting._first_tick))  # once, though it may compile
        patch.setattr(starting, "sleep", lambda seconds: None)
        found = run_benchmarks(QUICK, SHORT, "haptorb bench --effort 0.02", lambda name, what: told.append(name))
    assert set(told) == set(QUICK)
    return found


@pytest.mark.slow
def test_each_benchmark_has_rows_with_figures(quick):
    for name in QUICK:
        rows = [row for row in quick.rows if row.benchmark == name]
        assert rows
        assert all(row.value is not None and np.isfinite(row.value) and row.value > 0 for row in rows)
    assert {"processor", "cores", "load before", "numba"} <= quick.machine.keys()


@pytest.mark.slow
def test_daqp_answers_the_same_problems_alike(quick):
    pytest.importorskip("daqp")
    for row in quick.rows:
        if row.benchmark == "allocation":
            assert row.peer == "DAQP"
            assert float(row.note.split()[3]) < 1e-6


def test_scipy_trains_the_same_network():
    (row, other) = run_benchmarks(["training"], SHORT, "", lambda name, what: None).rows
    assert row.value == other.value > 0
    assert {row.peer, other.peer} == {"SciPy L-BFGS-B", "SciPy least_squares trf"}
    for one in (row, other):  # either it got there, or it is said how far it came
        assert (one.peer_value is None) is (" after " in one.note)


@pytest.mark.slow
def test_a_recording_keeps_up_and_is_smaller_than_plain_numbers(quick):
    rows = {(row.what, row.peer): row for row in quick.rows if row.benchmark == "recording"}
    assert rows["bytes per row", "plain float64"].ratio > 1.2
    assert rows["bytes per row", "JSON lines"].ratio > 2


@pytest.mark.parametrize(
    ("row", "ratio", "kept"),
    [
        (Metric("a", "b", 2.0, "µs", "c", 9.0, limit=3.0), 4.5, True),
        (Metric("a", "b", 4.0, "µs", limit=3.0), None, False),
        (Metric("a", "b", 4.0, "1/s", "c", 8.0, limit=3.0, at_least=True), 0.5, True),
        (Metric("a", "b", None, "µs", limit=3.0, note="no browser"), None, None),
        (Metric("a", "b", 1.0, "µs"), None, None),
    ],
)
def test_ratio_and_limit(row, ratio, kept):
    assert row.ratio == ratio
    assert row.kept is kept
    assert Metric.read(json.loads(json.dumps(row.numbers()))) == row


def test_what_is_stored_comes_back_and_is_told(tmp_path):
    rows = (
        Metric("tick", "fast", 2.0, "µs", "peer", 9000.0, limit=3.0),
        Metric("loop", "slow", 4.0, "µs", limit=3.0),
        Metric("loop", "absent", None, "ms", note="needs a browser"),
    )
    found = BenchResult({"processor": "one", "cores": "2"}, "haptorb bench", "2026-01-01", rows)
    found.store(tmp_path / "b.json")
    assert load_result(tmp_path / "b.json") == found
    told = found.markdown()
    for said in ("`haptorb bench`", "4,500 ×", "≤ 3 µs (missed)", "not measured", "needs a browser"):
        assert said in told
    assert "9.00 ms" in told
    assert "slow" not in found.markdown(["tick"])
    assert "absent" in found.markdown()
    assert "other" not in BenchResult({}, "", "", (Metric("tick", "other", 1.0, "µs"),)).markdown(short=True)
    console = Console(file=io.StringIO(), width=160)
    found.show(console)
    assert "needs a browser" in console.file.getvalue()


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"rows": [{"what": 1}], "machine": {}, "command": "", "day": ""}'])
def test_a_file_that_holds_no_benchmarks_is_refused(tmp_path, text):
    (tmp_path / "b.json").write_text(text)
    with pytest.raises(InputError, match="haptorb bench --store"):
        load_result(tmp_path / "b.json")


def test_unknown_names_and_efforts():
    with pytest.raises(UnknownName, match="tick"):
        run_benchmarks(["tic"], 1.0, "", lambda name, what: None)
    for effort in (0.0, -1.0, float("nan"), 11.0):
        with pytest.raises(InputError, match="effort"):
            run_benchmarks(["tick"], effort, "", lambda name, what: None)


def test_a_program_that_fails_is_a_row_that_says_so(monkeypatch, tmp_path):
    monkeypatch.setattr(outside, "_CLONE", tmp_path)
    for run in (outside.console, outside.serial, outside.study):
        (row,) = run(SHORT, lambda what: None)
        assert row.value is None
        assert "clone" in row.note
    (tmp_path / "benchmarks").mkdir()
    (tmp_path / "benchmarks" / "serial_cycle.py").write_text("raise SystemExit('no emulator')")
    (row,) = outside.serial(SHORT, lambda what: None)
    assert row.note == "failed: no emulator"


def test_the_command(capsys, tmp_path):
    words = ["bench", "training", "--effort", "0.02", "--json", "--store", str(tmp_path / "b.json")]
    with pytest.raises(SystemExit) as end:
        main(words)
    assert not end.value.code
    told = json.loads(capsys.readouterr().out)
    assert told == json.loads((tmp_path / "b.json").read_text())
    assert told["command"] == "haptorb bench training --effort 0.02"
    assert set(BENCHMARKS) >= {"magnetics", "estimation", "allocation", "tick", "training", "recording"}
