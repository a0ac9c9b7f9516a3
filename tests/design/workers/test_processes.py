"""Worker processes give identical results; a candidate that ends one is rejected; none outlives the program."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import pytest

from haptorb.errors import InputError
from haptorb.own_code import pickle_with_code
from haptorb.runtime.liveness import StarvedTime
from haptorb_design.problem import Evaluation
from haptorb_design.sampling import sample
from haptorb_design.search import Optimiser, optimise
from haptorb_design.workers import LocalWorker, ProcessWorkers, compute_base_values, open_processes
from oracles.designs.small_design import CODE, TEXT, make_design
from oracles.repetitions import repetitions

SLOW = CODE.replace("def reach(candidate):", "def reach(candidate):\n    import time\n    time.sleep(0.01)")


def test_one_process_or_two_give_the_same_set_of_a_sweep_and_of_an_optimiser(tmp_path: Path) -> None:
    design = make_design(tmp_path)
    jobs = list(enumerate(sample(design, "sobol", 40, 1)))
    with open_processes(design, 1) as workers:
        alone = [replace(one, seconds=0.0) for one in workers.evaluate(jobs)]
    with open_processes(design, 2) as workers:
        first = list(workers.evaluate(jobs[:11]))
        second = list(workers.evaluate(jobs[11:]))  # the same processes, as an optimiser's generations have them
        assert list(workers.evaluate([])) == []
        searched = list(optimise(Optimiser(design, seed=3, population=12), workers.evaluate, {}, 36))
    assert _order(searched) == _order(
        optimise(Optimiser(design, seed=3, population=12), LocalWorker(design).evaluate, {}, 36)
    )
    assert len(searched) == 36
    both = _order(first + second)
    assert both == alone
    assert sum(one.valid for one in both) > 10


def _order(found: Iterable[Evaluation]) -> list[Evaluation]:
    """By number, without the time that each took."""
    return sorted((replace(one, seconds=0.0) for one in found), key=lambda one: one.number)


night = pytest.mark.slow  # each starts several processes: one of each way to end runs in every suite


@pytest.mark.parametrize("many", [pytest.param(1, marks=night), 2])
@pytest.mark.parametrize(
    ("harm", "reason"),
    [
        pytest.param("import os; os._exit(9)", "exit code 9", marks=night),
        ("import os; os.kill(os.getpid(), 9)", "SIGKILL, perhaps because memory ran out"),
        pytest.param("import sys; sys.exit(3)", "exit code 3", marks=night),
        pytest.param("import ctypes; ctypes.string_at(0)", "SIGSEGV", marks=night),
        ("\n        while True: pass", "not computed within 1 s of processor time"),
        pytest.param("import time; time.sleep(1000)", "not computed within 2 s of processor time", marks=night),
        ("import numpy; x = [numpy.empty(2 ** 29) for _ in range(30)]", "MemoryError"),  # never touched
    ],
)
def test_a_candidate_that_harms_its_process_is_rejected_and_all_others_are_computed(
    harm: str, reason: str, many: int, tmp_path: Path
) -> None:
    code = CODE.replace(
        "def reach(candidate):",
        f"def reach(candidate):\n    if candidate.device.workspace_half_angle > 1.2:\n        {harm}",
    )
    design = make_design(tmp_path, code=code)
    # A process that ended is replaced, which takes most of a second each time: twice as many at night.
    angles = [60.0, 70.0, 61.0, 62.0, *[70.0, 63.0][repetitions(1, 0) :]]
    jobs = [(number, {"radius": 30.0, "angle": angle, "shell": "thin"}) for number, angle in enumerate(angles)]
    with open_processes(design, many, limit=float(reason.split()[3]) if "not computed" in reason else 60.0) as workers:
        found = _order(workers.evaluate(jobs))
    assert [one.number for one in found] == list(range(len(angles)))
    harmful = [number for number, angle in enumerate(angles) if angle == 70.0]
    assert [one.number for one in found if one.refused_by == "objective"] == harmful
    assert all(reason in one.reason for one in found if not one.valid)
    assert sum(one.valid for one in found) == len(angles) - len(harmful)


def test_a_candidate_that_waited_for_a_processor_is_not_called_slow(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever sleeps here stands for one whose process is ready to run all the time, and gets no processor."""
    code = CODE.replace("def reach(candidate):", "def reach(candidate):\n    import time\n    time.sleep(2.5)")
    monkeypatch.setattr(StarvedTime, "read", lambda self: time.monotonic())
    with open_processes(make_design(tmp_path, code=code), 1, limit=0.3) as workers:
        (found,) = workers.evaluate([(0, {"radius": 30.0, "angle": 60.0, "shell": "thin"})])
    assert found.valid, found.reason


def test_a_function_that_ends_its_process_at_the_base_device_costs_its_number_there_and_no_more(
    tmp_path: Path,
) -> None:
    """The base device is not a candidate: it is computed for the report, and for bounds that are shares of it."""
    harm = "import os; os.kill(os.getpid(), 9)"
    code = CODE.replace("def reach(candidate):", f"def reach(candidate):\n    {harm}")
    values = compute_base_values(make_design(tmp_path, code=code))
    assert values == {"objectives.cost": pytest.approx(0.032), "constraints.room": pytest.approx(0.03)}
    text = TEXT.replace('at_most = "31 mm"', 'at_most = "1.1 base"')
    code = CODE.replace("def room(candidate):", f"def room(candidate):\n    {harm}")
    with pytest.raises(InputError, match=r"base device has no number for it: its process ended 2 times: .*SIGKILL"):
        make_design(tmp_path, text, code)


@night
def test_a_function_that_never_ends_at_the_base_device_costs_its_number_there_too(tmp_path: Path) -> None:
    code = CODE.replace("def reach(candidate):", "def reach(candidate):\n    while True: pass")
    values = compute_base_values(make_design(tmp_path, code=code), 1.0)
    assert values == {"objectives.cost": pytest.approx(0.032), "constraints.room": pytest.approx(0.03)}


def test_a_process_that_ends_once_by_itself_costs_no_candidate(tmp_path: Path) -> None:
    mark = tmp_path / "once"
    code = CODE.replace(
        "def reach(candidate):",
        f"def reach(candidate):\n    import os, pathlib\n    mark = pathlib.Path({str(mark)!r})\n"
        "    if not mark.exists():\n        mark.touch()\n        os._exit(1)",
    )
    design = make_design(tmp_path, code=code)
    jobs = [(number, {"radius": 30.0, "angle": 60.0 + number, "shell": "thin"}) for number in range(5)]
    with open_processes(design, 1) as workers:
        found = _order(workers.evaluate(jobs))
    assert [(one.number, one.valid) for one in found] == [(number, True) for number in range(5)]
    with pytest.raises(InputError, match="between 1 and 1000"), open_processes(design, 0):
        pass


def test_a_process_that_ended_while_it_had_no_candidate_costs_the_next_one_nothing(tmp_path: Path) -> None:
    """Beside a worker of a cluster, an idle process ends by itself."""
    design = make_design(tmp_path)
    job = (0, {"radius": 30.0, "angle": 60.0, "shell": "thin"})
    workers = ProcessWorkers(pickle_with_code(design), 1, 60.0, idle=0.1)
    try:
        assert next(iter(workers.evaluate([job]))).valid
        children = multiprocessing.active_children()
        assert len(children) == 1
        children[0].join(60.0)
        assert not multiprocessing.active_children()
        assert next(iter(workers.evaluate([job]))).valid
    finally:
        workers.close()


PROGRAM = """
import sys
sys.path[:0] = {paths}
from multiprocessing import active_children
from pathlib import Path
from oracles.designs.small_design import make_design
from haptorb_design.workers import open_processes
if __name__ == "__main__":
    values = {{"radius": 30.0, "angle": 60.0, "shell": "thin"}}
    design = make_design(Path({folder!r}), code={code!r})
    with open_processes(design, 2) as workers:
        for number, one in enumerate(workers.evaluate((n, values) for n in range(100_000))):
            if number == 20:
                print(*(child.pid for child in active_children()), flush=True)
"""


def test_no_process_outlives_its_program(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    paths = [str(Path(__file__).parents[2]), *filter(None, sys.path)]
    program.write_text(PROGRAM.format(paths=paths, folder=str(tmp_path), code=SLOW))
    with subprocess.Popen([sys.executable, str(program)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        children = [int(word) for word in process.stdout.readline().split()]
        os.kill(process.pid, signal.SIGKILL)
    assert len(children) == 2
    end = time.monotonic() + 60.0
    while any(is_running(child) for child in children):
        assert time.monotonic() < end
        time.sleep(0.05)


def is_running(number: int) -> bool:
    try:
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
