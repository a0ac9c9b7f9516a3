"""`haptorb design sweep`: a run, ^C, the same command again, and what goes wrong, told in one line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from haptorb.cli.program import main
from haptorb_design.store import open_results, read_results
from oracles.designs.small_design import CODE, TEXT, make_design, write_design

#: at the seventh call: the first is for the base device
INTERRUPTED = CODE.replace(
    "def reach(candidate):",
    "def reach(candidate):\n    from pathlib import Path\n    gate = Path(__file__).with_name('gate')\n"
    "    gate.write_text(gate.read_text() + '.' if gate.exists() else '.')\n"
    "    if len(gate.read_text()) == 7:\n        raise KeyboardInterrupt",
)


def sweep(folder: Path, *more: str) -> int:
    common = ["--into", str(folder / "r.sqlite"), *([] if "--processes" in more else ["--processes", "1"])]
    try:
        return main(["design", "sweep", str(folder / "small.toml"), *common, *more])
    except SystemExit as end:
        return int(end.code or 0)


def test_a_sweep_and_the_same_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_design(tmp_path)
    assert sweep(tmp_path, "--count", "24", "--json") == 0
    first: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert first["designs"] == 24
    assert first["valid"] + sum(first["refused"].values()) == 24
    stored = read_results(tmp_path / "r.sqlite").evaluations
    assert sweep(tmp_path, "--count", "24", "--json") == 0
    assert json.loads(capsys.readouterr().out) == first
    assert read_results(tmp_path / "r.sqlite").evaluations == stored
    assert sweep(tmp_path, "--count", "30") == 0
    assert "30 designs" in capsys.readouterr().out
    assert read_results(tmp_path / "r.sqlite").evaluations[:24] == stored


def test_an_interrupt_keeps_everything_and_the_same_command_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_design(tmp_path, code=INTERRUPTED)
    assert sweep(tmp_path, "--count", "16") == 130
    kept = read_results(tmp_path / "r.sqlite").evaluations
    assert sum(one.valid for one in kept) == 5
    assert f"{len(kept)} of 16 designs" in capsys.readouterr().err
    assert sweep(tmp_path, "--count", "16") == 0
    found = read_results(tmp_path / "r.sqlite").evaluations
    assert [one.number for one in found] == list(range(16))
    assert found[: len(kept)] == kept


def test_no_valid_design_is_a_verdict(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_design(tmp_path, TEXT.replace('at_most = "31 mm"', 'at_most = "3 mm"'))
    assert sweep(tmp_path, "--count", "8") == 1
    told = capsys.readouterr()
    assert "0 valid" in told.out
    assert "room" in told.err


@pytest.mark.parametrize(
    ("more", "told"),
    [
        (["--method", "sobl"], "did you mean 'sobol'"),
        (["--method", "grid", "--count", "3"], "at least 20"),
        (["--count", "0"], "count must be"),
        (["--processes", "0"], "processes must be"),
        (["--scheduler", "tcp://127.0.0.1:1"], "leave them out"),
    ],
)
def test_what_cannot_be_asked(tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str], told: str) -> None:
    write_design(tmp_path)
    assert sweep(tmp_path, *more) == 2
    error = capsys.readouterr().err
    assert told in error
    assert "Traceback" not in error


def test_a_file_in_use_or_of_another_design(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    design = make_design(tmp_path)
    with open_results(tmp_path / "r.sqlite", design, "sobol", 1):
        assert sweep(tmp_path, "--count", "4") == 2
        assert "another program" in capsys.readouterr().err
    write_design(tmp_path, TEXT.replace("26 mm", "27 mm"))
    assert sweep(tmp_path, "--count", "4") == 2
    assert "choose another file" in capsys.readouterr().err
