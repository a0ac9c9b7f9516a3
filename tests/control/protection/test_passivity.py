"""Energy from sampling and delay: detected where the analysis predicts it, with bounded damping only on demand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haptorb.control.guard import ENERGY_CREDIT_J
from haptorb.control.passivity import OWN_DAMPING
from haptorb.devices.base import State, WrenchMap
from haptorb.estimation.types import Estimate

from .protected import DT, Loop

UPRIGHT, STILL = np.eye(3), np.zeros(3)
NOTHING = WrenchMap(np.zeros((6, 3)), np.zeros(6))


class PassivityTrial:
    """A loop without limits, of which only the passivity control remains."""

    def __init__(self, arm=0.0, lag=0.0):
        self.loop = Loop(arm=arm).unlimit()
        self.passivity = self.loop.protection.state["passivity"]
        self.passivity["lag"] = lag

    def damp(self, wrench, p, R, now, age, *, passive=True):
        """(6,) what is asked for `wrench` at a pose that is `age` old at `now`."""
        estimate = Estimate(State(now, R, np.asarray(p, float), STILL, STILL), NOTHING, True, age)
        self.passivity["passive"] = passive
        self.loop.open().now = now
        return self.loop.ask(wrench, estimate)

    def __getattr__(self, name):
        return float(self.passivity[name][0])

    @property
    def numbers(self):
        return [self.energy, self.balance, self.damping]


def spring(K, *, seconds=2.0, late=0, every=1, lag=0.0, passive=True, still=False, stamped=True):
    """A hand that swings ±1 mm at 5 Hz across a spring K, its pose told every `every` ticks and `late` ticks old.

    Returns the control, what was injected in each tick or, as a share, softened, and the energy that the held, late
    force really gave.
    """
    control, acts, true = PassivityTrial(lag=lag), [], 0.0
    x = 1e-3 * np.sin(2 * np.pi * 5 * np.arange(int(seconds / DT) + 1) * DT) * (not still)
    for n in range(int(seconds / DT)):
        m = max((n - late) // every * every, 0)
        wrench = np.array([-K * x[m], 0, 0, 0, 0, 0])
        out = control.damp(wrench, (x[m], 0, 0.06), UPRIGHT, n * DT, (n - m) * DT if stamped else 0.0, passive=passive)
        true += out[0] * (x[n + 1] - x[n])
        acts.append(max(control.damping, control.softened))
    return control, np.array(acts), true


@pytest.mark.parametrize(("late", "every"), [(0, 1), (3, 1), (5, 4), (10, 8)])
def test_it_acts_just_where_the_analysis_draws_the_line(late, every):
    """K (T/2 + t_d) against the loosest hand's damping: 15 % inside nothing is injected, 15 % outside something is."""
    bound = OWN_DAMPING / (every * DT / 2 + late * DT)
    _, quiet, _ = spring(0.85 * bound, late=late, every=every)
    assert not quiet.any()
    _, busy, _ = spring(1.15 * bound, late=late, every=every, seconds=8.0)
    assert busy.any()


def test_the_coils_lag_counts_as_delay():
    K = 0.85 * OWN_DAMPING / (DT / 2)
    assert not spring(K)[1].any()
    assert spring(K, lag=0.4 * DT, seconds=8.0)[1].any()


def test_the_energy_is_the_one_that_the_hand_got():
    """Late poses are paired with the forces of their own time: the observer ends with the true energy."""
    for late, every in ((0, 1), (7, 1), (5, 4)):
        control, _, true = spring(100.0, late=late, every=every, passive=False)
        assert control.energy == pytest.approx(true, abs=0.02 * abs(true) + 2e-6)
        assert true > 0  # a late spring gives


def test_a_stored_energy_that_is_given_back_is_no_sin():
    """A tool that starts high on a spring and is let go slowly: millijoules come out, nothing is injected."""
    control = PassivityTrial()
    for n in range(3000):
        x = 0.02 * (1 - n / 3000)
        control.damp(np.array([-200.0 * x, 0, 0, 0, 0, 0]), np.array([x, 0, 0.06]), UPRIGHT, n * DT, 0.0)
        assert control.damping == 0.0
    assert control.energy == pytest.approx(0.5 * 200.0 * 0.02**2, rel=0.01)


def test_an_active_world_is_watched_and_left_alone():
    control, injected, true = spring(3000.0, late=5, passive=False)
    assert not injected.any()
    assert control.balance < 0
    assert true > 0.01


def test_what_is_injected_brakes_and_is_bounded():
    control, injected, _ = spring(5000.0, late=5, seconds=4.0)
    assert 0 < injected.max() <= 0.25 * 0.1 / (2 * DT + 5 * DT) + 1e-9
    control, late, braked = PassivityTrial(), 5, 0
    x = 1e-3 * np.sin(2 * np.pi * 5 * np.arange(2000) * DT)
    for n in range(late + 1, 2000):
        wrench = np.array([-5000.0 * x[n - late], 0, 0, 0, 0, 0])
        out = control.damp(wrench, np.array([x[n - late], 0, 0.06]), UPRIGHT, n * DT, late * DT)
        added, speed = out - (1 - control.softened) * wrench, (x[n - late] - x[n - late - 1]) / DT
        assert added[0] * speed <= 1e-12  # against the motion
        assert abs(added[0]) <= 10.0 * abs(speed) + 1e-9
        assert not added[1:].any()
        braked += added[0] * speed < 0
    assert braked > 500


def test_a_rotor_is_watched_in_its_turning():
    """The same spring as a torque on a handle of 0.1 m: K r² about the axis."""
    arm, K = 0.1, 3000.0
    for factor, acts in ((0.5, False), (1.5, True)):
        control = PassivityTrial(arm)
        injected = 0.0
        for n in range(6000):
            angle = 0.01 * np.sin(2 * np.pi * 5 * n * DT)
            c, s = np.cos(angle), np.sin(angle)
            R = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
            torque = -factor * 2 * OWN_DAMPING / DT * arm**2 * angle
            out = control.damp(np.array([0, 0, 0, torque, 0, 0]), np.zeros(3), R, n * DT, 0.0)
            injected = max(injected, control.damping, control.softened)
            assert not out[:3].any()
        assert (injected > 0) == acts
    assert K


def test_poses_that_move_though_their_stamp_stands_are_of_now():
    """A predicted pose keeps the stamp of its measurement: it is taken for what it says of the present."""
    control, x = PassivityTrial(), 0.0
    for n in range(4000):
        x = 1e-3 * np.sin(2 * np.pi * 5 * n * DT)
        age = (n % 16) * DT + 0.01
        control.damp(np.array([-150.0 * x, 0, 0, 0, 0, 0]), np.array([x, 0, 0.06]), UPRIGHT, n * DT, age)
        assert control.damping == 0.0
    assert control.balance == ENERGY_CREDIT_J


def test_another_world_begins_anew():
    control, _, _ = spring(5000.0, late=5)
    assert control.balance < ENERGY_CREDIT_J
    control.loop.protection.change_world(passive=True)
    assert control.numbers == [0.0, ENERGY_CREDIT_J, 0.0]
    control.damp(np.full(6, 1e3), np.array([0.0, 0.0, 0.05]), UPRIGHT, 100.0, 0.0)
    assert control.numbers == [0.0, ENERGY_CREDIT_J, 0.0]  # a first pose has moved nowhere


def test_what_the_hand_loses_in_free_flight_is_no_credit():
    """After a spring that made energy the tool flies freely: the balance stays where it was."""
    control, _, _ = spring(2000.0, late=5, seconds=0.5, passive=False)
    before, x = control.balance, 1e-3 * np.sin(2 * np.pi * 5 * np.arange(500) * DT)
    assert -9e-3 < before < 0.5 * ENERGY_CREDIT_J
    for n in range(500):
        control.damp(np.zeros(6), np.array([x[n], 0, 0.06]), UPRIGHT, 0.5 + n * DT, 0.0, passive=False)
        if n == 10:  # forces that were asked in the wall no longer act
            before = control.balance
    assert control.balance == before


def test_a_pause_is_no_movement():
    control = PassivityTrial()
    for n, now in enumerate((0.0, DT, 0.3, 0.3 + DT)):
        at = np.array([0.01 * n, 0.0, 0.05])
        control.damp(np.array([5.0, 0, 0, 0, 0, 0]), at, UPRIGHT, now, 0.0)
    assert abs(control.energy) <= 0.1 + 1e-9  # two steps of 10 mm at 5 N; the pause counts for nothing


numbers = st.floats(-1e3, 1e3) | st.sampled_from([float("nan"), float("inf"), 0.0])


@settings(max_examples=150, deadline=None)
@given(st.lists(st.tuples(numbers, numbers, st.floats(-1, 1), st.floats(0, 0.1) | st.just(float("nan"))), max_size=40))
def test_whatever_comes_it_stays_finite_and_adds_only_bounded_braking(course):
    control = PassivityTrial(0.1)
    for n, (force, torque, place, age) in enumerate(course):
        wrench = np.array([force, 0, 0, torque, 0, 0])
        out = control.damp(wrench, np.array([place, 0, 0.05]), UPRIGHT, n * DT, age)
        assert np.isfinite(control.numbers).all()
        assert 0.0 <= control.damping <= 10.0
        assert -1e-2 <= control.balance <= ENERGY_CREDIT_J
        if np.isfinite(wrench).all():
            assert np.isfinite(out).all()
