"""Controller: lateral only, bounded, offset-free, zero for a resting hand, and warm-started."""

import numpy as np
import pytest

from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.errors import InputError
from haptorb.worlds import CATALOGUE, PathGuidance
from haptorb.worlds.path import make_shape

DT = 1e-3


@pytest.fixture(scope="module")
def guided():
    return PathGuidance(shape=0).for_device(load("omni"))


def place_hand(gone, aside, pace=0.03):
    """A hand `gone` [m] along the line over the summit, `aside` [m] beside it."""
    angle = gone / 0.05
    return State.at(
        (0.05 * np.sin(angle), aside, 0.05 * np.cos(angle)), v=(pace * np.cos(angle), 0, -pace * np.sin(angle))
    )


def drag(world, ticks, aside, pace=0.03):
    memory, wrench = world.begin(), None
    for n in range(ticks):
        wrench = world.advance(memory, place_hand(-0.01 + pace * DT * n, aside, pace), DT)
    return memory, wrench


def test_a_moving_hand_beside_the_path_is_pushed_back_and_not_along(guided):
    memory, wrench = drag(guided, 600, 0.002)
    tangent = np.array([np.cos((0.008) / 0.05), 0, -np.sin(0.008 / 0.05)])
    assert wrench[1] < -0.1
    assert abs(wrench[:3] @ tangent) < 0.02 * abs(wrench[1])
    assert np.linalg.norm(wrench[:3]) <= guided.bound + 1e-9
    assert not wrench[3:].any()
    assert memory["heat"][0] > 0.0


def test_on_the_path_next_to_nothing_is_asked(guided):
    _, wrench = drag(guided, 600, 0.0)
    assert np.linalg.norm(wrench) < 5e-3


def test_a_lasting_push_is_met_with_a_growing_force(guided):
    """A hand that stays 0.1 mm beside the path pushes: the observer's share grows until the bound."""
    first, last = drag(guided, 250, 1e-4)[1], drag(guided, 900, 1e-4)[1]
    assert abs(last[1]) > 2 * abs(first[1])


def test_a_hand_at_rest_is_left_alone(guided):
    _, wrench = drag(guided, 2000, 0.003, pace=0.0)
    assert np.linalg.norm(wrench) < 1e-6
    always = guided.replace(rest_pace=0.0)
    assert np.linalg.norm(drag(always, 500, 0.003, pace=0.0)[1]) > 0.1


def test_without_the_mode_nothing_is_asked_but_all_is_observed(guided):
    memory, wrench = drag(guided.replace(mode=0.0), 600, 0.002)
    assert not wrench.any()
    assert abs(memory["across"][0, 0]) == pytest.approx(0.002, rel=0.05)


def test_heat_costs(guided):
    thrifty, warm = (drag(guided.replace(heat_weight=w), 300, 0.001)[0]["heat"][0] for w in (0.5, 0.0))
    assert thrifty < warm


def test_the_same_memory_and_states_give_the_same_bits(guided):
    first, second = drag(guided, 300, 0.001), drag(guided, 300, 0.001)
    assert np.array_equal(first[0], second[0])
    assert np.array_equal(first[1], second[1])


def test_from_the_last_plan_a_solution_takes_few_steps(guided):
    memory, steps = guided.begin(), []
    for n in range(1000):
        guided.advance(memory, place_hand(-0.01 + 3e-5 * n, 3e-3 * np.sin(0.02 * n)), DT)
        steps.append(memory["steps"][0])
    assert min(steps) >= 0
    assert max(steps) <= 10
    assert np.mean(steps) < 3


def test_progress_stays_on_its_turn_of_a_spiral_where_another_is_as_near():
    world = PathGuidance(path=make_shape("spiral")).for_device(load("omni"))
    path, memory = world.curve, world.begin()
    for arc in np.arange(0.03, 0.08, 3e-5):
        here = path.find_place(float(arc))
        world.advance(memory, State.at(here * (1 + 2e-4)), DT)
    assert memory["arc"][0] == pytest.approx(0.08, abs=1e-3)


def test_a_hand_set_down_elsewhere_begins_there(guided):
    memory, _ = drag(guided, 300, 0.002)
    guided.advance(memory, place_hand(0.02, 0.03), DT)
    wrench = guided.advance(memory, place_hand(0.02, 0.001), DT)
    assert np.linalg.norm(wrench) < 0.01
    assert memory["arc"][0] > 0.038


def test_other_weights_go_on_and_another_path_begins_anew(guided):
    memory, _ = drag(guided, 300, 0.002)
    same, other = guided.replace(tolerance=0.002), PathGuidance(shape=2).for_device(load("omni"))
    kept, fresh = same.begin(), other.begin()
    same.keep(kept, guided, memory)
    other.keep(fresh, guided, memory)
    assert np.array_equal(kept, memory)
    assert fresh["started"][0] == 0.0


def test_maps_show_the_force_on_a_moving_hand(guided):
    assert guided.wrench(place_hand(0.0, 0.002))[1] < -0.05


def test_bad_input_is_refused_where_it_enters():
    with pytest.raises(InputError, match="above the shell"):
        PathGuidance(path=make_shape("circle", 25.0, 0.09)).for_device(load("omni"))
    with pytest.raises(InputError, match=r"has none"):
        PathGuidance().for_device(load("pmsm"))
    with pytest.raises(InputError, match="at least two"):
        PathGuidance(path=((0.0, 0.0, 0.05),))
    with pytest.raises(InputError, match="horizon"):
        PathGuidance(horizon=3.0)
    assert CATALOGUE["path_guidance"] is PathGuidance
