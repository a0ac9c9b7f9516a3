"""Passivity control with all worlds: inactive where the loop is fast enough, active where it is not."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from haptorb import worlds
from haptorb.analysis.stability import GRIPS
from haptorb.cli.check_world import PoseDelay
from haptorb.control.registry import make_allocator
from haptorb.devices.electromagnet import Hand
from haptorb.devices.loader import load
from haptorb.estimation.registry import make_estimator
from haptorb.estimation.types import HandGoal
from haptorb.runtime.assembly import assemble
from haptorb.runtime.config import RunConfig
from haptorb.runtime.drivers.sim import ImperfectTracker, SimDriver
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.tick import Tick
from haptorb.worlds.base import World

HOMES = {name: "pmsm" if name in ("outlet", "outlet-published", "snap_fit") else "omni" for name in worlds.CATALOGUE}
PASSIVE = [name for name in worlds.CATALOGUE if worlds.find_world(name).passive]


def rows_of(tick, seconds, *fields):
    """One array per field over a run at 1 kHz."""
    row, out = tick.layout.empty(), []
    with tick.driver:
        for n in range(round(1e3 * seconds)):
            tick.step(row, n * 1e-3)
            out.append(np.concatenate([row[tick.layout[field]] for field in fields]))
    return np.array(out).T


@pytest.mark.parametrize("name", PASSIVE)
def test_a_passive_world_stays_untouched_in_a_well_sampled_loop(name):
    """Zero injection over the guided motion, landing, sliding and circling: not little, none."""
    device = load(HOMES[name])
    tick = assemble(RunConfig(device=device, world=worlds.find_world(name)()), PointerTracker())
    seconds = 4.0 if HOMES[name] == "omni" else 1.5
    energy, balance, injected, softened = rows_of(tick, seconds, "energy", "balance", "injected", "softened")
    assert not injected.any()
    assert not softened.any()
    assert (balance > 0.0).all()
    assert np.isfinite(energy).all()


@dataclass(frozen=True)
class Spring(World):
    """Back to the plane x = 0."""

    stiffness: float = 0.0
    passive = True

    def wrench(self, state):
        wrench = np.zeros(6)
        wrench[0] = -self.stiffness * state.p[0]
        return wrench


class DeclaredSpring(Spring):
    """The same, declared active."""

    passive = False


def push_across(world, tracker_rate, latency, seconds=2.5, grip_name="light"):
    """The tool's place across `world` in a hand that leans on it once; what was injected [N·s/m], or softened [1]."""
    omni, grip = load("omni"), GRIPS[grip_name]
    held = Hand(grip.mass, grip.damping, grip.stiffness, omni.hand.turn_damping, omni.hand.turn_stiffness)
    device = replace(omni, hand=held)
    middle, upright = np.array([0.0, 0.0, 0.06]), np.array([0.0, 0.0, 0.0, 1.0])

    def goal(now):
        leaning = 0.45 <= now < 0.5
        return HandGoal(middle + np.array([1e-3 * leaning, 0, 0]), upright, now, False)

    driver = ImperfectTracker(SimDriver.of(device, 1e-3, goal), PoseDelay(tracker_rate, latency))
    tick = Tick(device, world, driver, make_estimator(device, "tracker", "exact"), make_allocator(device), 1e-3)
    p, injected, softened = rows_of(tick, seconds, "p", "injected", "softened")[[0, 3, 4]]
    return p, np.maximum(injected, softened)


@pytest.mark.parametrize(("tracker_rate", "latency", "stiffness"), [(240.0, 5e-3, 400.0), (120.0, 10e-3, 165.0)])
def test_a_spring_beyond_the_loops_bound_is_quieted(tracker_rate, latency, stiffness):
    """1.6 and 1.2 times what the loop stands: left alone it ends in the limits, with the control it dies away."""
    alone, nothing = push_across(DeclaredSpring(stiffness=stiffness), tracker_rate, latency)
    damped, acts = push_across(Spring(stiffness=stiffness), tracker_rate, latency)
    assert not nothing.any()
    assert acts.max() > 0.25
    assert np.std(damped[-500:]) < 0.1 * np.std(alone[-500:])


def test_a_loose_hand_is_not_kept_swinging_by_the_whole_chain():
    """240 Hz, 5 ms, twice the limit: estimator, allocator, guard, drive, coils and magnets; at rest within 5 s."""
    world = Spring(stiffness=256.0)
    p, _ = push_across(world, 240.0, 5e-3, 6.5, "loose")
    assert np.ptp(p[5500:]) < 0.05e-3
    alone, _ = push_across(DeclaredSpring(stiffness=256.0), 240.0, 5e-3, 1.5, "loose")
    assert np.ptp(alone[1000:]) > 0.5e-3


def test_a_sum_is_passive_only_if_all_its_parts_are():
    assert (worlds.Wall() + worlds.Magnet()).passive
    assert not (worlds.Wall() + worlds.Dome()).passive
    assert not (worlds.Wall() + worlds.Dome() + worlds.Magnet()).continuous
    assert (worlds.Wall() + worlds.Magnet()).for_device(load("omni")).continuous
