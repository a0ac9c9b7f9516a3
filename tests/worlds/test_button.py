"""Button: travel, click, latch, and passivity of all of them."""

import numpy as np
import pytest

from haptorb.devices.loader import load
from haptorb.errors import InputError
from haptorb.worlds import Button
from haptorb.worlds.dynamic import bind_world
from worlds.hands import DT, feel, sum_work, wander

TRAVEL = Button().travel
TOP = Button().bottom + TRAVEL


def press(bound, depths, aside=0.0):
    """Force outwards [N] while the tool goes through `depths` below the top [m], `aside` [rad] from the middle."""
    d = TOP - np.asarray(depths)
    p = np.column_stack([d * np.sin(aside), 0 * d, d * np.cos(aside)])
    forces, _ = feel(None, p, bound=bound)
    return (forces * p / d[:, None]).sum(axis=1), forces, p


DOWN = np.linspace(-1e-3, 0.98 * TRAVEL, 400)


def test_it_stays_pressed_until_it_is_pressed_again():
    bound = bind_world(Button(), DT)
    rests = []
    for _ in range(4):
        press(bound, DOWN)
        press(bound, DOWN[::-1])
        press(bound, np.full(100, -2e-3))
        rests.append((bound.memory["pressed"].item(), round(bound.memory["depth"].item() / TRAVEL, 2)))
    assert rests == [(1.0, 0.45), (0.0, 0.0), (1.0, 0.45), (0.0, 0.0)]


def test_one_press_counts_once_however_it_trembles_at_the_bottom():
    bound = bind_world(Button(), DT)
    press(bound, DOWN)
    press(bound, TRAVEL * (0.88 + 0.1 * np.sin(np.arange(300))))
    assert bound.memory["pressed"].item() == 1.0


def test_half_a_press_is_none():
    bound = bind_world(Button(), DT)
    press(bound, np.linspace(0, 0.8 * TRAVEL, 300))
    press(bound, np.linspace(0.8 * TRAVEL, 0, 300))
    assert bound.memory["pressed"].item() == 0.0


def test_it_clicks():
    force, *_ = press(bind_world(Button(), DT), DOWN)
    peak = np.argmax(force[:260])
    valley = peak + np.argmin(force[peak:])
    assert 0.35 < DOWN[peak] / TRAVEL < 0.55 < DOWN[valley] / TRAVEL < 0.75
    assert force[peak] - force[valley] > 0.1
    assert force[-1] > force[valley] + 0.05  # and then the bottom


def test_a_pressed_key_is_only_touched_where_it_rests():
    bound = bind_world(Button(), DT)
    press(bound, DOWN)
    press(bound, DOWN[::-1])
    force, *_ = press(bound, np.linspace(0, 0.44 * TRAVEL, 100))
    assert not force.any()


def test_its_force_has_no_steps():
    for pressed in (0.0, 1.0):
        changes = []
        for steps in (500, 2000):
            bound = bind_world(Button(), DT)
            bound.memory["pressed"], bound.memory["armed"] = pressed, 0.0
            force, *_ = press(bound, np.linspace(-1e-3, 1.2 * TRAVEL, steps), aside=0.22)
            changes.append(np.abs(np.diff(force)).max())
        assert changes[1] < 0.5 * changes[0]


def test_changing_over_at_the_bottom_makes_no_step():
    bound = bind_world(Button(), DT)
    force, *_ = press(bound, np.linspace(0.8 * TRAVEL, 0.98 * TRAVEL, 2000))
    assert bound.memory["pressed"].item() == 1.0
    assert np.abs(np.diff(force)).max() < 2e-3


@pytest.mark.parametrize("seed", range(4))
def test_nobody_gets_energy_out_of_it(seed):
    """Pressing here, letting up there, over the edge and back: never more than the latch was given."""
    world = Button()
    p, v = wander(seed, 6.0, centre=(0.002, 0, TOP - 0.004), size=0.006)
    forces, bound = feel(world, p, v)
    work = sum_work(forces, p)
    flow = np.abs(np.diff(work)).sum()
    assert flow > 1e-3
    start = bind_world(world, DT)
    first = feel(None, p[:1], bound=start)[1].energy
    assert work.max() < first + 0.01 * flow
    assert bound.energy - first == pytest.approx(-work[-1], abs=0.01 * flow)


def test_it_stays_pressed_when_its_spring_is_changed():
    bound = bind_world(Button(), DT)
    press(bound, DOWN)
    press(bound, DOWN[::-1])
    assert bind_world(Button(spring=80.0), DT, bound).memory["pressed"].item() == 1.0


def test_it_belongs_on_a_dome():
    with pytest.raises(InputError, match="'pmsm' has none"):
        Button().for_device(load("pmsm"))
    with pytest.raises(InputError, match="below the rim"):
        Button(summit=(1, 0, -1)).for_device(load("omni"))
    with pytest.raises(InputError, match="zero vector"):
        Button(summit=(0, 0, 0))
