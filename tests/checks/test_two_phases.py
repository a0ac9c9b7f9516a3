"""The order of the tests where several processes share them: each runs once, and what needs the machine is alone."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

FILES = {
    "worlds/test_a.py": 5,
    "worlds/test_b.py": 1,
    "sensing/test_c.py": 4,
    "browser/test_d.py": 3,
    "browser/e.py": 1,
}
TESTS = [f"{file}::test_{n}" for file, count in FILES.items() for n in range(count)]


class Process:
    """A pytest process as xdist's worker is one: it begins a test when it knows the next, or that there is none."""

    def __init__(self, name: str) -> None:
        self.gateway = SimpleNamespace(id=name)
        self.shutting_down = False
        self.waiting: list[int] = []

    def send_runtest_some(self, numbers: list[int]) -> None:
        assert not self.shutting_down
        self.waiting += numbers

    def shutdown(self) -> None:
        self.shutting_down = True


@pytest.fixture
def scheduler(root: Path) -> Any:
    pytest.importorskip("xdist")
    spec = importlib.util.spec_from_file_location("two_phases", root / "tests" / "two_phases.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    config: Any = SimpleNamespace(getvalue=lambda name: ["popen", "popen"], option=SimpleNamespace(tx=[]))
    return lambda heavy=(): module.TwoPhases(config, None, lambda file: "browser" in file, heavy)


def played(sched: Any, tests: list[str], crashing: str = "") -> tuple[list[tuple[str, str, int]], list[str]]:
    """(test, process, processes alive) in the order in which they began, and what is said to have crashed."""
    alive = [Process("0"), Process("1")]
    sched.numnodes = len(alive)
    for process in alive:
        sched.add_node(process)
    for process in alive:
        sched.add_node_collection(process, tests)
    sched.schedule()
    began, crashed = [], []
    for turn in range(1000):
        if not alive or (sched.tests_finished and not any(process.waiting for process in alive)):
            return began, crashed
        process = alive[turn % len(alive)]
        if len(process.waiting) > 1 or (process.waiting and process.shutting_down):
            number = process.waiting.pop(0)
            began.append((tests[number], process.gateway.id, len(alive)))
            if tests[number] != crashing:
                sched.mark_test_complete(process, number)
                continue
            alive.remove(process)
            crashed.append(sched.remove_node(process))
            alive.append(Process(f"instead of {process.gateway.id}"))
            sched.add_node(alive[-1])
            sched.add_node_collection(alive[-1], tests)
            sched.schedule()
        elif process.shutting_down:
            alive.remove(process)
            assert sched.remove_node(process) is None
    raise AssertionError(f"waits for ever after {began}")


@pytest.mark.parametrize("tests", [TESTS, TESTS[:10], TESTS[10:], TESTS[:1], TESTS[-1:]], ids=len)
def test_every_test_runs_once_and_those_beside_a_clock_alone(scheduler: Any, tests: list[str]) -> None:
    began, crashed = played(scheduler(), tests)
    assert sorted(test for test, *_ in began) == sorted(tests)
    assert crashed == []
    assert {alive for test, _, alive in began if "browser" in test} <= {1}
    if len(tests) == len(TESTS):
        assert {process for test, process, _ in began if "browser" not in test} == {"0", "1"}


def test_a_files_tests_stay_together_and_what_is_heavy_comes_first(scheduler: Any) -> None:
    began, _ = played(scheduler(("test_c.py",)), TESTS)
    for file in FILES:
        assert len({process for test, process, _ in began if test.startswith(file)}) == 1
    assert began[0][0] == "sensing/test_c.py::test_0"
    began, _ = played(scheduler(("worlds",)), TESTS)
    assert len({process for test, process, _ in began if test.startswith("worlds")}) == 1
    assert began[0][0] == "worlds/test_a.py::test_0"


@pytest.mark.parametrize("crashing", TESTS)
def test_one_that_ends_its_process_is_told_and_the_others_still_run(scheduler: Any, crashing: str) -> None:
    began, crashed = played(scheduler(), TESTS, crashing)
    assert crashed == [crashing]
    assert sorted(test for test, *_ in began) == sorted(TESTS)
