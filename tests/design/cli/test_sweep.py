"""`haptorb design sweep`: a run, ^C, resumption by the same command, and errors in one line."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from haptorb.cli.program import main
from haptorb_design.store import open_results, read_results
from oracles.designs.small_design import BARE, CODE, TEXT, make_design, write_design

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


KILLER = """
import os

def cost(candidate):
    r = candidate.device.dome_radius
    if 0.0285 < r < 0.0287:
        os.kill(os.getpid(), 9)
    return r
"""
KILLS = """
name = "kills-its-process"
base = "bare.toml"
[parameters.radius]
low = "27 mm"
high = "30 mm"
places = ["dome.radius"]
[objectives.cost]
function = "kills_its_process.py:cost"
unit = "1"
sense = "minimise"
"""


def test_a_candidate_that_kills_its_process_is_one_rejected_design(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "kills_its_process.py").write_text(KILLER)
    (tmp_path / "small.toml").write_text(KILLS)
    (tmp_path / "bare.toml").write_text(BARE)
    assert sweep(tmp_path, "--count", "24", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    found = read_results(tmp_path / "r.sqlite").evaluations
    deadly = [one.number for one in found if 28.5 < float(one.values["radius"]) < 28.7]
    assert deadly
    assert told["refused"] == {"objective": len(deadly)}
    assert [one.number for one in found if "SIGKILL" in one.reason] == deadly
    assert told["valid"] == 24 - len(deadly)


@pytest.mark.slow  # of other commands: tests/cli/test_file_size_limit.py
def test_the_limit_of_the_shell_for_files_is_named(tmp_path: Path) -> None:
    write_design(tmp_path)
    command = f"ulimit -f 60; exec {sys.executable} -m haptorb design sweep small.toml --count 300 --into r.sqlite"
    done = subprocess.run(["bash", "-c", command], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "ulimit -f" in done.stderr
    assert "Traceback" not in done.stderr


#: as the script that pip installs
PROGRAM = "import sys; print('up', flush=True); from haptorb.cli import main; sys.exit(main())"


@pytest.mark.parametrize("delay", [0.2, 0.8, *(pytest.param(at, marks=pytest.mark.slow) for at in (0.4, 1.5, 3.0))])
def test_interrupted_at_any_time_no_traceback_is_printed(delay: float, tmp_path: Path) -> None:
    write_design(tmp_path)
    command = ["-c", PROGRAM, "design", "optimise", "small.toml", "--evaluations", "4000", "--processes", "2"]
    with subprocess.Popen(
        [sys.executable, *command], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "up\n"
        time.sleep(0.02 + delay)
        program.send_signal(signal.SIGINT)
        time.sleep(0.05)
        program.send_signal(signal.SIGINT)  # and an impatient second time
        _, said = program.communicate(timeout=60)
    assert "Traceback" not in said
    assert program.returncode in (130, -signal.SIGINT)
