"""A Dask cluster gives bit-identical results, also when workers join, leave or fail."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from haptorb import cluster as dask_cluster
from haptorb import cluster as versions
from haptorb.errors import HaptorbError, InputError
from haptorb_design.design_file import load_design, parse_design
from haptorb_design.evaluate import evaluate
from haptorb_design.problem import Design, Evaluation
from haptorb_design.search import Optimiser, optimise
from haptorb_design.store import read_results
from haptorb_design.workers import Job, LocalWorker, open_cluster_workers
from oracles.designs.small_design import BARE
from oracles.repetitions import repetitions

pytestmark = [
    pytest.mark.filterwarnings("ignore"),  # of the cluster's own sockets and loops
    # Importing it takes most of a second, in every process that collects tests.
    pytest.mark.skipif(find_spec("distributed") is None, reason="distributed is not installed"),
]

COUNT, POPULATION = 60, 20
#: workers: the one that takes the place of a killed one joins too, and a third takes five seconds of processor time
MOST = repetitions(2, 3)
TOY = """
name = "toy"
base = "bare.toml"
[parameters.radius]
low = "26 mm"
high = "34 mm"
places = ["dome.radius"]
[parameters.angle]
low = "50 deg"
high = "70 deg"
step = "1 deg"
places = ["dome.workspace_half_angle"]
[objectives.cost]
function = "cost.py:cost"
[constraints.room]
function = "cost.py:room"
at_most = 0.031
"""
#: slow enough that a worker can be killed within it
CODE = """
import time

def cost(candidate):
    time.sleep(0.02)
    shape = candidate.device
    return (shape.dome_radius - 0.03) ** 2 * 1e4 + shape.workspace_half_angle

def room(candidate):
    return candidate.device.dome_radius
"""


@pytest.fixture(scope="module")
def design(tmp_path_factory: pytest.TempPathFactory) -> Design:
    """A design whose objective is a file that the workers have not."""
    folder: Path = tmp_path_factory.mktemp("toy")
    (folder / "cost.py").write_text(CODE)
    (folder / "bare.toml").write_text(BARE)
    found = parse_design(TOY, "toy", folder)
    (folder / "cost.py").unlink()
    return found


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    import distributed

    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0", memory_limit=0
    ) as made:
        yield made


def values_of(found: list[Evaluation]) -> dict[int, tuple[object, ...]]:
    """All but the seconds, by number; every number once."""
    assert len({one.number for one in found}) == len(found)
    return {one.number: (one.values, one.objectives, one.constraints, one.refused_by, one.reason) for one in found}


def an_optimiser(design: Design) -> Optimiser:
    return Optimiser(design, seed=3, population=POPULATION)


def test_one_of_two_workers_is_killed_and_nothing_is_lost_or_doubled(design: Design, cluster: Any) -> None:
    alone = list(optimise(an_optimiser(design), LocalWorker(design).evaluate, {}, COUNT))
    found = []
    with open_cluster_workers(design, cluster.scheduler_address) as workers:
        for evaluation in optimise(an_optimiser(design), workers.evaluate, {}, COUNT):
            found.append(evaluation)
            if len(found) == COUNT // 3 + 4:  # within the second generation
                os.kill(next(iter(cluster.workers.values())).process.pid, signal.SIGKILL)
            if len(found) == 2 * COUNT // 3:
                cluster.scale(MOST)
    assert values_of(found) == values_of(alone)
    assert any(one.refused_by == "room" for one in found)
    assert sum(one.valid for one in found) > COUNT // 3


HARM = """
import os, sys, time, numpy

def cost(candidate):
    angle = round(candidate.device.workspace_half_angle * 57.29578)
    if angle == 51: os.kill(os.getpid(), 9)
    if angle == 52: sys.exit(3)
    if angle == 53:
        while True: pass
    if angle == 54: return len([numpy.empty(2 ** 29) for _ in range(30)])
    if angle == 55: raise KeyError("no row")
    return candidate.device.dome_radius

def room(candidate):
    return candidate.device.dome_radius
"""


@pytest.mark.slow  # without a cluster: test_processes.py
def test_candidates_that_harm_their_process_are_rejected_no_worker_ends_and_none_waits(
    tmp_path: Path, cluster: Any
) -> None:
    (tmp_path / "cost.py").write_text(HARM)
    (tmp_path / "bare.toml").write_text(BARE)
    jobs: list[Job] = [(angle, {"radius": 30.0, "angle": float(angle)}) for angle in range(50, 59)]
    wait_until(lambda: len(cluster.scheduler.workers) == MOST, "all workers")  # one may have been killed before
    workers_before = set(cluster.scheduler.workers)
    arrived = []
    with open_cluster_workers(parse_design(TOY, "toy", tmp_path), cluster.scheduler_address, 2.0) as workers:
        for one in workers.evaluate(jobs):
            arrived.append(one.number)
            reason = REASONS.get(one.number)
            assert (reason or "") in one.reason
            assert one.valid is (reason is None)
    assert sorted(arrived) == list(range(50, 59))
    assert arrived[0] != 53  # the others do not wait for it
    assert set(cluster.scheduler.workers) == workers_before


REASONS = {
    51: "its process ended 2 times: signal SIGKILL",
    52: "its process ended 2 times: exit code 3",
    53: "not computed within 2 s of processor time",
    54: "MemoryError",
    55: "KeyError: 'no row'",
}


def wait_until(holds: Callable[[], bool], what: str) -> None:
    for _ in range(1200):  # of a busy machine; it is seconds
        if holds():
            return
        time.sleep(0.1)
    raise AssertionError(f"never: {what}")


def list_session(leader: int) -> list[int]:
    """Processes of the session that `leader` began, but those that only wait to be collected."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, _, _, session, *_ = (folder / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue  # it has just ended
        if int(session) == leader and state != "Z":
            found.append(int(folder.name))
    return found


def interrupt_search(tmp_path: Path, cluster: Any) -> tuple[list[str], str]:
    """Ctrl-C in the middle of a search on the cluster: its command, and its file of results in `tmp_path`."""
    (tmp_path / "cost.py").write_text(CODE)
    (tmp_path / "bare.toml").write_text(BARE)
    (tmp_path / "toy.toml").write_text(TOY)
    results, workers = str(tmp_path / "r.sqlite"), set(cluster.scheduler.workers)
    command = [sys.executable, "-m", "haptorb", "design", "optimise", "toy.toml", "--into", "r.sqlite"]
    command += ["--evaluations", str(COUNT), "--population", str(POPULATION), "--scheduler", cluster.scheduler_address]

    def count_stored() -> int:
        try:
            return len(read_results(results).evaluations)
        except HaptorbError:
            return 0  # it is not there yet

    def has_begun() -> bool:
        time.sleep(0.2)  # each look takes a few hundredths of a second of the processor
        return count_stored() >= 5

    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as first:
        wait_until(has_begun, "five designs")
        os.killpg(first.pid, signal.SIGINT)  # as a terminal does
        _, said = first.communicate(timeout=60)
    assert first.returncode == 130
    assert "Traceback" not in said
    kept = count_stored()
    assert f"{kept} of {COUNT} designs are in r.sqlite" in said
    wait_until(lambda: not list_session(first.pid), "no process left")
    wait_until(lambda: not cluster.scheduler.tasks, "no job left on the cluster")
    assert set(cluster.scheduler.workers) == workers
    assert 5 <= kept < COUNT
    return command, results


@pytest.mark.slow  # without a cluster: tests/design/cli/test_sweep.py
def test_ctrl_c_of_a_search_on_a_cluster_leaves_nothing_behind(tmp_path: Path, cluster: Any) -> None:
    _, results = interrupt_search(tmp_path, cluster)
    toy = load_design(tmp_path / "toy.toml")
    whole = optimise(Optimiser(toy, seed=1, population=POPULATION), LocalWorker(toy).evaluate, {}, COUNT)
    assert values_of(list(read_results(results).evaluations)).items() <= values_of(list(whole)).items()


@pytest.mark.slow  # a search that goes on without a cluster: tests/design/cli/test_optimise.py
def test_a_search_on_a_cluster_goes_on_after_ctrl_c(tmp_path: Path, cluster: Any) -> None:
    command, results = interrupt_search(tmp_path, cluster)
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=200)
    assert done.returncode == 0, done.stderr
    toy = load_design(tmp_path / "toy.toml")
    whole = optimise(Optimiser(toy, seed=1, population=POPULATION), LocalWorker(toy).evaluate, {}, COUNT)
    assert values_of(list(read_results(results).evaluations)) == values_of(list(whole))


@pytest.mark.slow
def test_workers_of_another_version_are_refused_with_both(
    design: Design, cluster: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = versions.__version__
    monkeypatch.setattr(versions, "__version__", "99.0")
    message = rf"have haptorb {here}, this computer has 99\.0: install the same version"
    with pytest.raises(InputError, match=message), open_cluster_workers(design, cluster.scheduler_address):
        pass
    # one that joins after that look
    monkeypatch.setattr(dask_cluster, "_check_cluster", lambda client, address: None)
    with (
        pytest.raises(InputError, match=rf"haptorb {here}, this computer has 99\.0"),
        open_cluster_workers(design, cluster.scheduler_address) as workers,
    ):
        list(workers.evaluate([(0, {"radius": 30.0, "angle": 60.0})]))


def compute_until(
    design: Design, address: str, jobs: list[Job], found: list[Evaluation], end: Callable[[], None]
) -> None:
    """Compute into `found`; after the tenth, call `end`."""
    with open_cluster_workers(design, address) as workers:
        for evaluation in workers.evaluate(jobs):
            found.append(evaluation)
            if len(found) == 10:
                end()


@pytest.mark.slow
def test_a_scheduler_that_goes_away_leaves_what_was_computed(design: Design) -> None:
    program = (
        "import distributed, sys\n"
        "if __name__ == '__main__':\n"
        "    options = {'protocol': 'tcp://', 'dashboard_address': ':0'}\n"
        "    with distributed.LocalCluster(n_workers=1, processes=False, **options) as made:\n"
        "        print(made.scheduler_address, flush=True)\n"
        "        sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL, text=True,
    ) as scheduler:  # fmt: skip
        assert scheduler.stdout is not None
        address = scheduler.stdout.readline().strip()
        jobs: list[Job] = [(number, {"radius": 30.0 + 0.001 * number, "angle": 60.0}) for number in range(200)]
        found: list[Evaluation] = []
        with pytest.raises(InputError, match="repeat the command to continue") as told:
            compute_until(design, address, jobs, found, scheduler.kill)
    assert "\n" not in str(told.value)
    assert values_of(found).items() <= values_of([evaluate(design, *job) for job in jobs]).items()
