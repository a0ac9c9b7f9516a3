"""A world's budget in a tick: what is shed when it is overrun, and when it comes back."""

from __future__ import annotations

from haptorb.runtime.tick.world_budget import WorldBudget
from haptorb.worlds import Scene
from haptorb.worlds.bound_world import BoundWorld


def test_two_long_steps_shed_detail_one_does_not_and_it_comes_back_when_there_is_time() -> None:
    bound, budget = BoundWorld(Scene("peg"), 1e-3), WorldBudget(1e-3)
    budget.judge(bound, 0.9e-3)
    for _ in range(20):
        budget.judge(bound, 0.2e-3)
    assert bound.memory["detail"][0] == 0  # the computer's doing
    for _ in range(2):
        budget.judge(bound, 0.5e-3)
    assert bound.memory["detail"][0] == 1
    for _ in range(6):
        budget.judge(bound, 0.5e-3)
    assert bound.memory["detail"][0] > 1
    for _ in range(200_000):
        budget.judge(bound, 0.05e-3)
    assert bound.memory["detail"][0] == 0


def test_a_step_in_between_neither_sheds_nor_restores() -> None:
    bound, budget = BoundWorld(Scene("peg"), 1e-3), WorldBudget(1e-3)
    bound.world.lighten(bound.memory)
    for _ in range(5000):
        budget.judge(bound, 0.3e-3)
    assert bound.memory["detail"][0] == 1
