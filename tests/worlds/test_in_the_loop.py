"""Worlds with memory in the whole chain of the simulated Omni: noisy sensors, guard, currents, magnets."""

from dataclasses import replace

import numpy as np
import pytest

from haptorb.analysis.stability import GRIPS
from haptorb.control.registry import make_allocator
from haptorb.devices.electromagnet import Hand
from haptorb.devices.loader import load
from haptorb.estimation.registry import make_estimator
from haptorb.estimation.types import HandGoal
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.runtime.tick import Tick
from haptorb.worlds import Button, Friction

DT = 1e-3


def run(world, place, seconds, *fields):
    """Fields of all rows while a light hand follows `place(now)` [m] above an Omni."""
    omni, grip = load("omni"), GRIPS["light"]
    held = Hand(grip.mass, grip.damping, grip.stiffness, omni.hand.turn_damping, omni.hand.turn_stiffness)
    upright = np.array([0.0, 0.0, 0.0, 1.0])
    device = replace(omni, hand=held)
    driver = SimDriver.of(device, DT, lambda now: HandGoal(np.asarray(place(now)), upright, now, False))
    tick = Tick(device, world, driver, make_estimator(device, "tracker", "exact"), make_allocator(device), DT)
    row, out = tick.layout.empty(), []
    with tick.driver:
        for n in range(round(seconds / DT)):
            tick.step(row, n * DT)
            out.append(np.concatenate([row[tick.layout[field]] for field in fields]))
    return np.array(out)


@pytest.mark.parametrize("elastic", [0.8, 0.0])
def test_a_tool_that_sticks_creeps_less_than_a_micrometre_a_second(elastic):
    """A hand leans sideways with 0.1 N on friction that breaks away at 0.25 N; also as published in 1995."""

    def lean(now):
        return [1.5e-3 * min(max(now - 1.0, 0.0), 1.0), 0.0, 0.060]

    x = run(Friction(elastic=elastic), lean, 8.0, "p", "wrench_actual")
    late = np.arange(len(x)) * DT > 4.0
    creep = np.polyfit(np.arange(len(x))[late] * DT, x[late, 0], 1)[0]
    assert np.mean(x[late, 3]) < -0.05  # it holds against the hand
    assert abs(creep) < 1e-6


def test_a_button_is_pressed_and_stays_pressed_by_a_hand():
    def press(now):
        down = np.interp(now % 2.0, [0.5, 1.0, 1.3, 1.8], [0.0, 1.0, 1.0, 0.0])
        return [0.0, 0.0, 0.062 - 0.020 * down]

    pressed = run(Button(), press, 4.0, "memory")[:, 0]
    assert pressed[[400, 1990, 3990]].tolist() == [0.0, 1.0, 0.0]
