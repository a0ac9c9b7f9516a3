"""A Dask cluster computes what this process computes, to the last bit, though workers come, go and die."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from haptorb import cluster as dask_cluster
from haptorb import cluster as versions
from haptorb.errors import InputError
from haptorb_design.design_file import parse_design
from haptorb_design.evaluate import evaluate
from haptorb_design.problem import Design, Evaluation
from haptorb_design.search import Optimiser, optimise
from haptorb_design.workers import Job, LocalWorker, open_cluster_workers
from oracles.designs.small_design import BARE

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.filterwarnings("ignore")  # of the cluster's own sockets and loops

COUNT, POPULATION = 60, 20
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
    with distributed.LocalCluster(
        n_workers=3, threads_per_worker=1, processes=True, dashboard_address=":0", memory_limit=0
    ) as made:
        yield made


def values_of(found: list[Evaluation]) -> dict[int, tuple[object, ...]]:
    """All but the seconds, by number; every number once."""
    assert len({one.number for one in found}) == len(found)
    return {one.number: (one.values, one.objectives, one.constraints, one.refused_by, one.reason) for one in found}


def an_optimiser(design: Design) -> Optimiser:
    return Optimiser(design, seed=3, population=POPULATION)


def test_one_of_three_workers_is_killed_and_nothing_is_lost_or_doubled(design: Design, cluster: Any) -> None:
    alone = list(optimise(an_optimiser(design), LocalWorker(design).evaluate, {}, COUNT))
    found = []
    with open_cluster_workers(design, cluster.scheduler_address) as workers:
        for evaluation in optimise(an_optimiser(design), workers.evaluate, {}, COUNT):
            found.append(evaluation)
            if len(found) == COUNT // 3 + 4:  # within the second generation
                os.kill(next(iter(cluster.workers.values())).process.pid, signal.SIGKILL)
            if len(found) == 2 * COUNT // 3:
                cluster.scale(4)
    assert values_of(found) == values_of(alone)
    assert any(one.refused_by == "room" for one in found)
    assert sum(one.valid for one in found) > COUNT // 3


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
