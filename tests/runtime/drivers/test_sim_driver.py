"""Simulated driver: whole periods, expiring pointer goals, and coils off at every exit."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haptorb.devices.base import DeviceKind
from haptorb.devices.loader import load
from haptorb.errors import DeviceError, DriverError, InputError
from haptorb.estimation.types import HandGoal
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.simulation.base import Simulation
from oracles.repetitions import repetitions

OMNI = load("omni")
PERIOD = 1e-3


def hand_goal(p=(0.0, 0.0, 0.055), stamp=0.0, held=False):
    return HandGoal(np.array(p), np.array([0.0, 0.0, 0.0, 1.0]), stamp, held)


class Counting(Simulation):
    """Remembers what was asked of it."""

    def __init__(self, inner):
        self.inner, self.device, self.passed, self.duties, self.resets = inner, inner.device, [], [], []

    def advance(self, dt, duties, goal_p, goal_q):
        self.passed.append(dt)
        self.duties.append(np.array(duties))
        self.inner.advance(dt, duties, goal_p, goal_q)

    def sample(self, t, pose_stamp, pose_valid):
        return self.inner.sample(t, pose_stamp, pose_valid)

    def wrench_actual(self):
        return self.inner.wrench_actual()

    def state(self):
        return self.inner.state()

    def quantise(self, duties):
        return self.inner.quantise(duties)

    def place(self, p, q):
        self.inner.place(p, q)

    def reset(self, seed=0):
        self.resets.append(seed)
        self.inner.reset(seed)


@cache
def make_simulation():
    """One for all examples: a driver that opens resets it."""
    return SimDriver.of(OMNI, PERIOD).simulation


def counting(goal=None, seed=0):
    simulation = Counting(make_simulation())
    return SimDriver(simulation, PERIOD, goal, seed=seed), simulation


@settings(max_examples=repetitions(12, 30))
@given(st.lists(st.floats(0.0, 4.3e-3), min_size=1, max_size=40))
def test_simulated_time_is_whole_periods_and_does_not_drift(gaps):
    driver, simulation = counting()
    with driver:
        now = 5.0
        driver.read(now)
        assert simulation.passed == []
        for gap in gaps:
            now += gap
            driver.read(now)
    for passed in simulation.passed:
        assert passed / PERIOD == pytest.approx(round(passed / PERIOD))
    assert abs(sum(simulation.passed) - (now - 5.0)) <= 0.5 * PERIOD + 1e-9


def test_a_long_pause_of_the_loop_is_a_pause_of_the_world():
    driver, simulation = counting()
    with driver:
        driver.read(0.0)
        driver.read(60.0)
        driver.read(60.001)
    # 20 ms until the device has switched off by itself, the rest without current
    assert simulation.passed == pytest.approx([0.02, 0.08, 1e-3])


def test_duties_are_held_until_the_next_write_and_told_as_applied():
    driver, simulation = counting()
    with driver:
        driver.read(0.0)
        applied = driver.write(np.array([2.0, -0.12345, np.nan]))
        assert applied.tolist() == [1.0, round(-0.12345 * 4096) / 4096, 0.0]
        driver.read(1e-3)
        driver.read(2e-3)
    assert all(np.array_equal(duties, applied) for duties in simulation.duties)
    assert len(simulation.duties) == 2


def test_coils_are_off_after_leaving_in_any_way():
    driver, simulation = counting()

    def failing():
        with driver:
            driver.read(0.0)
            driver.write(np.ones(3))
            raise RuntimeError("oops")

    with pytest.raises(RuntimeError, match="oops"):
        failing()
    assert driver.write(np.ones(3)).tolist() == [0.0, 0.0, 0.0]
    driver.close()  # twice is fine
    with driver:
        driver.read(10.0)
        driver.read(10.001)
    assert not simulation.duties[-1].any()


def test_opening_begins_at_the_start_with_the_seed():
    driver, simulation = counting(seed=9)
    with driver:
        driver.read(0.0)
    with driver:
        driver.read(3.0)
    assert simulation.resets == [9, 9]


def test_the_hand_begins_where_it_wants_to_be_and_goes_where_it_is_told():
    places = {0.0: (0.03, 0.0, 0.05)}
    driver = SimDriver.of(OMNI, PERIOD, lambda now: hand_goal(places.get(now, (0.0, 0.02, 0.055))))
    with driver:
        assert driver.read(0.0).pose.p == pytest.approx([0.03, 0.0, 0.05])
        for n in range(1, 1001):
            sample = driver.read(n * PERIOD)
        assert driver.hand_goal()[:3] == pytest.approx([0.0, 0.02, 0.055])
    assert np.linalg.norm(sample.pose.p - [0.0, 0.02, 0.055]) < 2e-3  # but for the core's pull


@pytest.mark.parametrize("nowhere", [(0.0, 0.0, 0.0), (np.nan, 0.0, 0.05), (np.inf, 0.0, 0.05)])
def test_a_goal_that_is_no_place_leaves_the_hand_where_numbers_are(nowhere):
    with SimDriver.of(OMNI, PERIOD, lambda now: hand_goal(nowhere)) as driver:
        for n in range(100):
            sample = driver.read(n * PERIOD)
    assert np.isfinite(sample.pose.p).all()
    assert np.linalg.norm(sample.pose.p) > 0.9 * OMNI.contact_distance


def test_without_a_goal_the_hand_stays():
    with SimDriver.of(OMNI, PERIOD) as driver:
        start = driver.read(0.0).pose.p
        for n in range(1, 300):
            sample = driver.read(n * PERIOD)
        assert driver.hand_goal()[:3] == pytest.approx(start)
        assert driver.hand_goal()[3:] == pytest.approx([0, 0, 0, 1])
    assert np.linalg.norm(sample.pose.p - start) < 1e-3


@pytest.mark.parametrize(
    ("stamp", "held", "age", "valid"),
    [
        (0.7, True, 0.3, True),  # a pointer that was last heard of 0.3 s ago
        (0.7, False, 0.0, True),  # nobody holds it: the tool's place is known anyway
        (1.5, True, 0.0, True),  # a stamp from the future is now
        (np.nan, True, 0.0, False),
        (-np.inf, True, 0.0, False),
    ],
)
def test_a_held_pose_is_as_old_as_its_pointer(stamp, held, age, valid):
    with SimDriver.of(OMNI, PERIOD, lambda now: hand_goal(stamp=stamp, held=held)) as driver:
        sample = driver.read(1.0)
    assert sample.t - sample.pose.t == pytest.approx(age)
    assert sample.pose.valid is valid


def test_truth_is_the_last_ticks_mean_and_the_same_times_give_the_same_bits():
    def course():
        rows = []
        with SimDriver.of(OMNI, PERIOD, lambda now: hand_goal((0.01, 0.0, 0.052)), seed=3) as driver:
            for n in range(200):
                sample = driver.read(n * PERIOD)
                driver.write(np.array([0.2, 0.1, -0.3]) * np.sin(0.1 * n))
                rows.append(
                    np.concatenate([sample.currents, sample.field.ravel(), sample.pose.p, driver.wrench_actual()])
                )
        return np.array(rows)

    rows = course()
    assert np.array_equal(rows, course())
    assert np.isfinite(rows).all()
    assert np.abs(rows[50:, -4]).max() > 0.05  # newtons


def test_bad_use_is_refused():
    driver = SimDriver.of(OMNI, PERIOD)
    with pytest.raises(DriverError, match="not open"):
        driver.read(0.0)
    with driver:
        driver.read(1.0)
        with pytest.raises(DriverError, match="went back"):
            driver.read(0.9)
        with pytest.raises(DriverError, match="finite"):
            driver.read(np.nan)
    for period in (0.0, -1.0, np.nan, 1.0):
        with pytest.raises(InputError, match="period"):
            SimDriver.of(OMNI, period)

    class Unknown:
        name, channels, kind = (
            "unknown",
            1,
            DeviceKind(name="unknown", title="device of an unknown kind", world="nothing"),
        )

    with pytest.raises(DeviceError):
        SimDriver.of(Unknown(), PERIOD)


def test_it_says_what_it_is():
    driver = SimDriver.of(OMNI, PERIOD)
    assert (driver.name, driver.simulated) == ("sim", True)


def _drive(prepares):
    """Five ticks, `prepares` saying for which instants each is prepared: truth, currents and poses, as bytes.

    Each is read twice: the sensors' noise is another one then.
    """
    told = b""
    with SimDriver.of(OMNI, PERIOD, lambda now: hand_goal((0.01 * now, 0.0, 0.052)), seed=5) as driver:
        for n, instants in enumerate(prepares):
            for instant in instants:
                driver.prepare(instant * PERIOD)
            for sample in (driver.read(n * PERIOD), driver.read(n * PERIOD)):
                told += driver.wrench_actual().tobytes() + sample.currents.tobytes() + sample.pose.p.tobytes()
            driver.write(np.full(3, 0.1 * n))
    return told


def test_what_is_prepared_is_what_would_have_been_read():
    unprepared = _drive([[]] * 5)
    assert _drive([[0], [1], [2], [3], [4]]) == unprepared
    assert _drive([[0, 0], [], [2, 2, 2], [3], [4]]) == unprepared


def test_time_passes_while_the_loop_waits_and_reading_only_hands_over():
    simulation = Counting(SimDriver.of(OMNI, PERIOD).simulation)
    with SimDriver(simulation, PERIOD) as driver:
        driver.read(0.0)
        driver.prepare(PERIOD)
        assert simulation.passed == [PERIOD]
        assert driver.read(PERIOD).t == PERIOD
        assert simulation.passed == [PERIOD]
        driver.prepare(2 * PERIOD)
        assert driver.read(4 * PERIOD).t == 4 * PERIOD  # the loop slept through two deadlines: the rest passes now
        assert simulation.passed == [PERIOD, PERIOD, 2 * PERIOD]


def test_what_fails_in_preparing_fails_again_in_reading():
    driver = SimDriver.of(OMNI, PERIOD)
    for door in (driver.prepare, driver.read):
        with pytest.raises(DriverError, match="not open"):
            door(0.0)
    with driver:
        driver.prepare(1.0)
    with pytest.raises(DriverError, match="not open"):  # closed since: what was prepared is not handed over
        driver.read(1.0)
