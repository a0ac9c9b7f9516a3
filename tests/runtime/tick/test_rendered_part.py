"""Rendered part of a wrench; limits that protect a hand from forces also apply to torques."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from haptorb import worlds
from haptorb.control.registry import make_allocator, make_choice
from haptorb.control.saturation import Saturation
from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.errors import InputError, UnknownName
from haptorb.estimation.types import HandGoal, TrackedPose
from haptorb.runtime.config import RunConfig
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.runtime.tick import Tick
from haptorb.worlds.base import World
from haptorb.worlds.user_world import FunctionWorld

OMNI = replace(load("omni"), tolerance=None)  # simulated as its file says
DT = 1e-3
FORCE, TORQUE, BOTH = 0.0, 1.0, 2.0


def hold(now):
    """A hand that holds the tool upright on the summit."""
    return HandGoal(np.array([0.0, 0.0, 0.0495]), np.array([0.0, 0.0, 0.0, 1.0]), now, False)


class Rig:
    """A tick over a simulated Omni, and its rows."""

    def __init__(self, world, render=None, age=0.0):
        self.driver = SimDriver.of(OMNI, DT, hold)
        choice = make_choice(OMNI, render)
        estimator = TrackedPose(OMNI, "exact")
        self.tick = Tick(OMNI, world, self.driver, estimator, make_allocator(OMNI), DT, choice=choice)
        self.row, self.n = self.tick.layout.empty(), 0
        self.driver.open()

    def go(self, ticks):
        rows = []
        for _ in range(ticks):
            self.tick.step(self.row, self.n * DT)
            self.n += 1
            rows.append(self.row.copy())
        self.rows = np.array(rows)
        return self

    def __getitem__(self, name):
        return self.row[self.tick.layout[name]]

    def course(self, name):
        return self.rows[:, self.tick.layout[name]]


@dataclass(frozen=True)
class Twist(World):
    """A constant wrench about x that says what it asks."""

    asks = "torque"

    torque: float = 0.010
    about: tuple[float, float, float] = (1.0, 0.0, 0.0)

    def wrench(self, state):
        return np.r_[np.zeros(3), self.torque * np.array(self.about)]


def test_ten_millinewtonmetres_arrive_through_the_whole_chain():
    """Estimator, allocator, guard, drive and coils: within 2 % of the exact torque on the tool."""
    rig = Rig(Twist()).go(500)
    assert rig["part"][0] == TORQUE
    given, asked = rig["wrench_actual"], rig["wrench_commanded"]
    assert asked[3] == pytest.approx(0.010)
    assert np.linalg.norm(given[3:] - asked[3:]) < 0.02 * 0.010
    assert rig["saturated"][0] == Saturation.NONE


def test_what_cannot_be_turned_is_shown_live():
    rig = Rig(Twist(about=(0.0, 0.0, 1.0), torque=0.004)).go(400)
    assert rig["wrench_commanded"][5] == pytest.approx(0.004)
    assert abs(rig["wrench_actual"][5]) < 1e-5
    assert rig["saturated"][0] == Saturation.AXIS
    assert Rig(Twist(torque=0.03)).go(400)["saturated"][0] in (Saturation.CURRENT, Saturation.POWER)


@pytest.mark.parametrize(("name", "part"), [("dome", FORCE), ("compass", TORQUE), ("compass_dome", BOTH)])
def test_what_the_world_asks_decides(name, part):
    rig = Rig(worlds.find_world(name)()).go(5)
    assert rig["part"][0] == part


@pytest.mark.parametrize(("render", "part"), [("force", FORCE), ("torque", TORQUE), ("both", BOTH)])
def test_a_person_can_choose_another_part(render, part):
    rig = Rig(worlds.CompassDome(), render).go(400)
    assert rig["part"][0] == part
    missing = np.abs(rig["wrench_commanded"] - rig["wrench_actual"])
    if render == "force":
        assert missing[:3].max() < 0.01
    if render == "torque":
        assert missing[3:].max() < 1e-4
    rig.tick.change_world(worlds.Dome())
    assert rig.go(1)["part"][0] == part


def test_force_worlds_get_the_same_currents_as_ever():
    """Bit for bit those of the force allocator alone."""
    chosen, alone = Rig(worlds.Dome()), Rig(worlds.Dome())
    alone.tick = Tick(OMNI, worlds.Dome(), alone.driver, TrackedPose(OMNI, "exact"), make_allocator(OMNI), DT)
    for rig in (chosen, alone):
        rig.go(300)
    assert (chosen.course("current_commanded") == alone.course("current_commanded")).all()
    assert alone["part"][0] == -1.0


def test_a_world_that_does_not_say_is_found_out_and_stays_so():
    """A user's own function: force at first, a torque from 100 ms on, none again after 200 ms."""

    def ask(state):
        wrench = np.zeros(6)
        wrench[2] = 0.1
        wrench[4] = 0.004 if 0.1 <= state.t < 0.2 else 0.0
        return wrench

    parts = Rig(FunctionWorld(ask)).go(300).course("part")[:, 0]
    assert (parts[:100] == FORCE).all()
    assert (parts[101:] == BOTH).all()
    only = FunctionWorld(lambda state: np.array([0, 0, 0, 0.003, 0, 0]))
    assert Rig(only).go(400)["part"][0] == TORQUE
    rig = Rig(FunctionWorld(ask)).go(150)
    rig.tick.change_world(FunctionWorld(lambda state: np.zeros(6)))  # another version of the own world
    assert rig.go(1)["part"][0] == BOTH
    rig.tick.change_world(worlds.Wall())
    assert rig.go(1)["part"][0] == FORCE


def test_choices_that_cannot_be_are_refused():
    with pytest.raises(UnknownName, match="torque"):
        RunConfig.of(OMNI, render="torqe")
    with pytest.raises(InputError, match="torque arm"):
        make_choice(OMNI, "both", -1.0)
    assert make_choice(load("pmsm")) is None
    with pytest.raises(InputError, match="no choice of force or torque"):
        make_choice(load("pmsm"), "force")


# -- safety: the same limits for torque ------------------------------------------------------------------------------


def test_a_torque_beyond_its_limit_is_clamped():
    rig = Rig(Twist(torque=5.0)).go(600)
    assert np.linalg.norm(rig.course("wrench_commanded")[:, 3:], axis=1).max() <= OMNI.limits.torque * (1 + 1e-9)
    assert np.abs(rig.course("current_commanded")).max() <= 20.0
    assert np.linalg.norm(np.nan_to_num(rig.course("wrench_actual"))[:, :3], axis=1).max() < OMNI.limits.force


def test_currents_for_a_torque_slew():
    """A torque that jumps to and fro in every tick."""
    rig = Rig(FunctionWorld(lambda s: np.array([0, 0, 0, 0.009 if round(s.t / DT) % 2 else -0.009, 0, 0])), "torque")
    wanted = rig.go(600).course("current_commanded")
    assert np.abs(np.diff(wanted, axis=0)).max() <= OMNI.limits.slew * DT * (1 + 1e-9)


def test_a_torque_fades_when_the_pose_expires():
    rig = Rig(Twist(torque=0.005)).go(500)
    frozen = rig.driver.read

    def stale(now):
        sample = frozen(now)
        return type(sample)(
            sample.t, sample.currents, sample.temperatures, sample.field,
            type(sample.pose)(0.499, *[getattr(sample.pose, name) for name in ("R_SR", "p", "w", "v")], True),
            sample.currents_age,
        )  # fmt: skip

    rig.driver.read = stale
    rig.go(200)
    assert rig["guard"][0] == GuardState.TRIPPED
    assert rig["trip"][0] == Trip.POSE_EXPIRED
    assert not rig["current_commanded"].any()


def test_a_turning_spring_beyond_the_loop_is_damped_and_a_soft_one_is_not():
    """What sampling makes of a stiff spring of torque is counted, at the arm of the hand that holds the tool."""
    choice = make_choice(OMNI)
    bound = 2 * choice.arm**2 / DT  # K T/2 of the loosest hand's damping [N·m/rad]
    for factor, acts in ((0.5, False), (4.0, True)):
        rig = Rig(worlds.Compass())
        protection = rig.tick.protection
        protection.state["guard"]["state"], protection.state["guard"]["gain"] = GuardState.RUNNING, 1.0
        protection.state["guard"]["torque"] = 1e9
        injected = 0.0
        estimate = rig.tick.estimator.update(rig.driver.read(0.0))
        for n in range(3000):
            angle = 0.01 * np.sin(2 * np.pi * 5 * n * DT)
            c, s = np.cos(angle), np.sin(angle)
            R = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
            state = State(n * DT, R, np.array([0, 0, 0.05]), np.zeros(3), np.zeros(3))
            wrench = np.array([0.0, 0, 0, -factor * bound * angle, 0, 0])
            now = type(estimate)(state, estimate.wrench_map, True, 0.0)
            asked = protection.protect_wrench(wrench, now, n * DT).copy()
            damping = float(protection.state["passivity"]["damping"][0])
            if damping > 0.0:
                rate = 0.01 * 2 * np.pi * 5 * np.cos(2 * np.pi * 5 * (n - 0.5) * DT)
                left = 1.0 - float(protection.state["passivity"]["softened"][0])
                assert (asked[3] - left * wrench[3]) * rate <= 1e-9  # against the turning
            assert not asked[:3].any()
            injected = max(injected, damping)
        assert (injected > 0) == acts


def test_moving_sideways_counts_nothing_where_only_torque_is_rendered():
    """A force that is asked but not rendered makes no energy, and needs no damping."""
    rig = Rig(worlds.CompassDome(), "torque")
    protection = rig.tick.protection
    protection.state["passivity"]["passive"] = True
    estimate = rig.tick.estimator.update(rig.driver.read(0.0))
    for n in range(500):
        x = 1e-3 * np.sin(2 * np.pi * 5 * n * DT)
        state = State(n * DT, np.eye(3), np.array([x, 0, 0.06]), np.zeros(3), np.zeros(3))
        now = type(estimate)(state, estimate.wrench_map, True, 0.0)
        protection.protect_wrench(np.array([-9e3 * x, 0, 0, 0, 0, 0]), now, n * DT)
    assert protection.state["passivity"]["energy"][0] == 0.0
    assert protection.state["passivity"]["damping"][0] == 0.0
