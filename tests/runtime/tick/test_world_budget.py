"""Time budget of a world in a tick: what is left out after an overrun, and when it returns."""

from __future__ import annotations

import time
from threading import Thread

import numpy as np
import pytest

from haptorb.arrays import Records
from haptorb.devices.base import State
from haptorb.runtime.tick import WorkThread, WorldBudget
from haptorb.runtime.tick_log import TickFailure
from haptorb.worlds import RollingBall, Scene
from haptorb.worlds.dynamic import BoundWorld, WorldWork


@pytest.fixture
def bound() -> BoundWorld:
    return BoundWorld(Scene("peg"), 1e-3)


def judge(budget: WorldBudget, bound: BoundWorld, took: float, times: int) -> TickFailure:
    found = TickFailure(0)
    for _ in range(times):
        found |= budget.judge(bound, took)
    return found


def test_long_steps_shed_detail_level_by_level_and_it_comes_back_when_there_is_time(bound: BoundWorld) -> None:
    budget = WorldBudget(1e-3)
    assert judge(budget, bound, 0.5e-3, 20) == TickFailure.LESS_DETAIL
    assert bound.memory["detail"][0] == 1
    judge(budget, bound, 0.9e-3, 60)
    assert bound.memory["detail"][0] == 5
    assert judge(budget, bound, 0.05e-3, 400_000) == TickFailure.MORE_DETAIL
    assert bound.memory["detail"][0] == 0


@pytest.mark.parametrize(("one", "rest", "every"), [(50e-3, 0.1e-3, 40), (0.6e-3, 0.1e-3, 4), (0.7e-3, 0.02e-3, 2)])
def test_single_long_steps_shed_nothing(bound: BoundWorld, one: float, rest: float, every: int) -> None:
    budget = WorldBudget(1e-3)
    for n in range(2000):
        budget.judge(bound, rest if n % every else one)
    assert bound.memory["detail"][0] == 0


def test_steps_longer_than_a_tick_go_to_the_background_although_they_are_rare(bound: BoundWorld) -> None:
    budget = WorldBudget(1e-3)
    judge(budget, bound, 0.9e-3, 6)
    assert bound.memory["detail"][0] == 1
    for n in range(60):
        budget.judge(bound, 0.05e-3 if n % 8 else 2.5e-3)
    assert bound.memory["detail"][0] == 5


def run_until(budget: WorldBudget, bound: BoundWorld, found: TickFailure) -> None:
    """Ticks of a scene at rest, until one says `found`."""
    end, still = time.monotonic() + 20.0, State.at((0.0, 0.0, 0.0), R_SR=np.eye(3))
    while time.monotonic() < end:
        budget.begin(bound)
        bound.wrench(still)
        if budget.end(bound) & found:
            return
        time.sleep(1e-3)
    raise AssertionError(f"no tick said {found!r}")


def wait(budget: WorldBudget) -> None:
    """Until the thread has computed its work."""
    end = time.monotonic() + 20.0
    while budget.is_computing and time.monotonic() < end:
        time.sleep(1e-3)


def test_what_a_thread_computed_is_what_the_scene_computes(bound: BoundWorld) -> None:
    budget, other = WorldBudget(1e-3), BoundWorld(RollingBall(), 1e-3)
    bound.memory["detail"] = 5
    run_until(budget, bound, TickFailure.WORK)
    assert bound.memory["state"][0][0] > 0.0  # the scene's time
    # Another world, or the same restarted, does not get the step that is on its way.
    wait(budget)
    budget.begin(other)
    assert budget.end(other) == TickFailure(0)
    run_until(budget, bound, TickFailure.WORK)
    wait(budget)
    bound.restart()
    bound.memory["detail"] = 5
    bound.wrench(State.at((0.0, 0.0, 0.0), R_SR=np.eye(3)))  # waits for a step of its own
    bound.memory["due"] = 1.0
    budget.begin(bound)
    assert bound.memory["state"][0][0] == 0.0
    budget.end(bound)
    run_until(budget, bound, TickFailure.WORK)


def test_a_fault_in_the_background_is_raised_in_the_tick_that_takes_its_result() -> None:
    class Faulty(WorldWork):
        def compute(self) -> None:
            raise ValueError("out of range")

        def fits(self, memory: Records) -> bool:
            return True

    thread = WorkThread()
    thread.submit(Faulty())
    end = time.monotonic() + 20.0
    while not thread.done and time.monotonic() < end:
        time.sleep(1e-3)
    with pytest.raises(ValueError, match="out of range"):
        thread.collect()


def test_where_no_thread_can_begin_the_work_is_done_at_once(bound: BoundWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(Thread, "start", refuse)
    bound.memory["detail"] = 5
    run_until(WorldBudget(1e-3), bound, TickFailure.WORK)


def test_steps_in_between_neither_shed_nor_restore(bound: BoundWorld) -> None:
    bound.world.lighten(bound.memory)
    assert judge(WorldBudget(1e-3), bound, 0.3e-3, 5000) == TickFailure(0)
    assert bound.memory["detail"][0] == 1


def test_a_world_with_nothing_to_shed_is_not_said_to_have_shed_it() -> None:
    ball = BoundWorld(RollingBall(), 1e-3)
    assert judge(WorldBudget(1e-3), ball, 0.9e-3, 100) == TickFailure(0)
    assert judge(WorldBudget(1e-3), ball, 1e-6, 5000) == TickFailure(0)


def test_waiting_for_a_processor_is_not_the_worlds_time(bound: BoundWorld) -> None:
    budget = WorldBudget(1e-3)
    for _ in range(20):
        budget.begin(bound)
        time.sleep(2e-3)
        budget.end(bound)
    assert bound.memory["detail"][0] == 0
