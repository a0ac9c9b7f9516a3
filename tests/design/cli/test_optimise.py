"""`haptorb design optimise`: interrupted, killed, or beside another on one database; always the same result."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from haptorb.cli import main
from haptorb.errors import HaptorbError
from haptorb_design.design_file import load_design
from haptorb_design.search import Optimiser, optimise
from haptorb_design.store import Results, open_results, read_results
from haptorb_design.workers import LocalWorker
from oracles.command import run_command
from oracles.designs.small_design import BARE
from oracles.postgres_server import explain_absence, start_postgres

COUNT, POPULATION = 100, 20
DESIGN = """
name = "toy"
base = "bare.toml"
[parameters.radius]
low = "26 mm"
high = "32 mm"
places = ["dome.radius"]
[parameters.angle]
low = "50 deg"
high = "70 deg"
step = "1 deg"
places = ["dome.workspace_half_angle"]
[objectives.cost]
function = "cost.py:cost"
[objectives.gain]
function = "cost.py:gain"
sense = "maximise"
"""
CODE = """
import time
from pathlib import Path

SLOWLY = Path(__file__).with_name("slowly")

def cost(candidate):
    if SLOWLY.exists():
        time.sleep(0.2)
    return (candidate.device.dome_radius - 0.028) ** 2 * 1e4 + candidate.device.workspace_half_angle

def gain(candidate):
    return candidate.device.workspace_half_angle
"""


@pytest.fixture(scope="module")
def design(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("toy")
    (folder / "cost.py").write_text(CODE)
    (folder / "bare.toml").write_text(BARE)
    (folder / "toy.toml").write_text(DESIGN)
    return folder / "toy.toml"


def words_of(design: Path, into: str, *, seed: int = 1, processes: int = 1) -> list[str]:
    """The command."""
    return ["design", "optimise", str(design), "--evaluations", str(COUNT), "--population", str(POPULATION),
            "--seed", str(seed), "--into", into, "--processes", str(processes), "--json"]  # fmt: skip


def start(design: Path, into: str, *, seed: int = 1, processes: int = 1) -> subprocess.Popen[str]:
    command = words_of(design, into, seed=seed, processes=processes)
    program = "import sys; from haptorb.cli import main; sys.exit(main(sys.argv[1:]))"
    return subprocess.Popen(
        [sys.executable, "-c", program, *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


@cache
def compute_alone(design: Path, seed: int = 1) -> dict[int, object]:
    """What the run comes to in this process, without a store."""
    found = load_design(design)
    whole = optimise(Optimiser(found, seed=seed, population=POPULATION), LocalWorker(found).evaluate, {}, COUNT)
    return {one.number: (one.values, one.objectives, one.refused_by) for one in whole}


def values_of(results: Results, seed: int = 1) -> dict[int, object]:
    (run,) = (run for run in results.runs if run.seed == seed)
    assert len({one.number for one in run.evaluations}) == len(run.evaluations)
    return {one.number: (one.values, one.objectives, one.refused_by) for one in run.evaluations}


def wait_for(into: str, least: int) -> int:
    """How many designs are stored, as soon as there are `least`."""
    for _ in range(600):  # of a busy machine; it is seconds
        time.sleep(0.2)  # each look takes a few hundredths of a second of the processor
        try:
            count = len(read_results(into).evaluations)
        except HaptorbError:
            continue  # it is not there yet
        if count >= least:
            return count
    raise AssertionError(f"{into} never had {least} designs")


@pytest.mark.slow  # interrupted: test_sweep.py; killed: tests/design/store/test_results.py
@pytest.mark.parametrize("interrupted", [False, True])
def test_interrupted_and_killed_it_goes_on_and_ends_as_if_nothing_had_been(
    design: Path, tmp_path: Path, interrupted: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """An interruption is that of every search: test_sweep.py has one in each run of the tests."""
    into, slowly = str(tmp_path / "results.sqlite"), design.with_name("slowly")
    slowly.touch()  # the whole run would take half a minute
    kept = 0
    if interrupted:
        with start(design, into, processes=2) as first:
            wait_for(into, 10)
            first.send_signal(signal.SIGINT)
            _, said = first.communicate(timeout=120)
        assert first.returncode == 130
        assert "Traceback" not in said
        kept = len(read_results(into).evaluations)
        assert f"{kept} of {COUNT}" in said
    with start(design, into) as second:
        wait_for(into, kept + 10)
        second.kill()
    assert kept + 10 <= len(read_results(into).evaluations) < COUNT
    slowly.unlink()
    code, told, said = run_command(capsys, *words_of(design, into))
    assert code == 0, said
    assert json.loads(told)["designs"] == COUNT
    assert values_of(read_results(into)) == compute_alone(design)


@pytest.fixture(scope="module")
def database() -> Iterator[str]:
    with start_postgres() as place:
        yield place


@pytest.mark.slow
@pytest.mark.skipif(bool(explain_absence()), reason=explain_absence())
def test_two_optimisers_on_one_database_do_not_disturb_each_other(design: Path, database: str) -> None:
    both = [start(design, database, seed=seed) for seed in (1, 2)]
    for one in both:
        _, said = one.communicate(timeout=100)
        assert one.returncode == 0, said
    results = read_results(database)
    for seed in (1, 2):
        assert values_of(results, seed) == compute_alone(design, seed)


def test_a_run_that_another_program_writes_is_refused(
    design: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    into = str(tmp_path / "r.sqlite")
    with open_results(into, load_design(design), "nsga2", 7, settings={"population": POPULATION}):
        command = ["design", "optimise", str(design), "--into", into, "--processes", "1"]
        assert main([*command, "--seed", "7", "--population", str(POPULATION)]) == 2
        assert "another program is writing run" in " ".join(capsys.readouterr().err.split())
        with pytest.raises(SystemExit) as ended:
            main([*command, "--seed", "8", "--evaluations", "4", "--population", "4"])
        assert ended.value.code == 0


@pytest.mark.parametrize(
    ("options", "what"),
    [
        (["--generations", "2", "--evaluations", "9"], "either --generations or --evaluations"),
        (["--generations", "0"], "--generations must be 1 or more"),
        (["--population", "2"], "population"),
        (["--seed", "-1"], "seed"),
        (["--scheduler", "here"], "Dask scheduler"),
    ],
)
def test_options_that_cannot_be_are_named(
    options: list[str], what: str, design: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["design", "optimise", str(design), "--into", str(tmp_path / "r.sqlite"), *options]) == 2
    assert what in " ".join(capsys.readouterr().err.split())


#: the file that was sent in, with a base whose windings fit into every dome: a narrow range of one parameter harms the
#: process that computes it
HARMFUL = """
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
COST = """
import os
def cost(candidate):
    r = candidate.device.dome_radius
    if 0.0285 < r < 0.0287:
        {harm}
    return r
"""


@pytest.mark.parametrize(
    ("harm", "reason"),
    [
        ("os.kill(os.getpid(), 9)", "its process ended 2 times: signal SIGKILL"),
        # the other ways in which one harms its process: tests/design/workers/test_processes.py
        pytest.param("while True: pass", "not computed within 2 s of processor time", marks=pytest.mark.slow),
        pytest.param(
            "import numpy; kept = [numpy.empty(1 << 29) for _ in range(30)]", "MemoryError", marks=pytest.mark.slow
        ),  # never touched
    ],
)
def test_a_harmful_candidate_is_rejected_with_its_reason_and_the_search_goes_on(
    harm: str, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "kills_its_process.py").write_text(COST.format(harm=harm))
    (tmp_path / "kills.toml").write_text(HARMFUL)
    (tmp_path / "bare.toml").write_text(BARE)
    into = str(tmp_path / "results.sqlite")
    words = ["--evaluations", "24", "--population", "12", "--processes", "2", "--time-limit", "2", "--json"]
    code, out, err = run_command(capsys, "design", "optimise", str(tmp_path / "kills.toml"), "--into", into, *words)
    assert code == 0, err
    found = read_results(into).evaluations
    assert [one.number for one in found] == list(range(24))
    harmful = [one.number for one in found if 28.5 < float(one.values["radius"]) < 28.7]
    assert harmful
    assert [one.number for one in found if reason in one.reason] == harmful
    valid = {one.number: one.objectives["cost"] for one in found if one.valid}
    assert len(valid) == 24 - len(harmful)
    assert all(0.027 <= cost <= 0.03 for cost in valid.values())
    told = json.loads(out)
    assert (told["valid"], told["refused"]) == (len(valid), {"objective": len(harmful)})
