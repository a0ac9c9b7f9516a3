"""The guard: for every way in which a powered magnet could hurt, one test that goes red if the guard forgets it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haptorb.control.protection.guard import Guard
from haptorb.control.protection.trip import GuardState, Trip
from haptorb.devices.loader import load
from haptorb.devices.state import State
from haptorb.devices.wrench_map import WrenchMap
from haptorb.sensing.sample import Estimate, Pose, Sample

DT = 1e-3
OMNI = load("omni")
STATE = State.at((0, 0, 0.05))
MAP = WrenchMap(np.zeros((6, 3)), np.zeros(6))
FRESH = Estimate(STATE, MAP, True, 0.0)
PUSH = np.array([0, 0, 0.5, 0, 0, 0.0])
any_number = st.floats(allow_nan=True, allow_infinity=True, width=64)


def sample(currents=(0.0, 0.0, 0.0), temperatures=(298.15,) * 3):
    pose = Pose(0.0, STATE.R_SR, STATE.p, STATE.w, STATE.v, True)
    return Sample(0.0, np.array(currents), np.array(temperatures), np.zeros((0, 3)), pose)


def running():
    """A guard that has ramped up."""
    guard = Guard(OMNI, DT)
    guard.admit(PUSH, FRESH)
    assert guard.engage()
    for _ in range(400):
        guard.admit(PUSH, FRESH)
        guard.limit(np.array([1.0, 0, 0]), sample())
    assert guard.state is GuardState.RUNNING
    return guard


def is_off(guard, wrench=PUSH, estimate=FRESH):
    guard.admit(wrench, estimate)
    return not guard.limit(np.array([5.0, 5, 5]), sample()).any()


def test_off_is_the_default():
    guard = Guard(OMNI, DT)
    for _ in range(100):
        assert not guard.admit(PUSH, FRESH).any()
        assert is_off(guard)


def test_it_starts_from_zero_and_ramps():
    guard = Guard(OMNI, DT)
    guard.admit(PUSH, FRESH)
    guard.engage()
    asked = [float(guard.admit(PUSH, FRESH)[2]) for _ in range(400)]
    assert asked[0] < 0.01 * PUSH[2]
    assert (np.diff(asked) >= 0).all()
    assert np.max(np.diff(asked)) < 0.005 * PUSH[2]
    assert asked[-1] == PUSH[2]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", range(6))
def test_a_wrench_that_is_no_number_switches_off(bad, place):
    guard = running()
    wrench = PUSH.copy()
    wrench[place] = bad
    assert is_off(guard, wrench)
    assert guard.reason is Trip.WORLD_NOT_FINITE
    assert is_off(guard)  # and stays off when the world is sane again


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", range(3))
def test_currents_that_are_no_numbers_switch_off(bad, place):
    guard = running()
    guard.admit(PUSH, FRESH)
    currents = np.ones(3)
    currents[place] = bad
    assert not guard.limit(currents, sample()).any()
    assert guard.reason is Trip.CURRENTS_NOT_FINITE


@pytest.mark.parametrize("reading", [{"currents": (np.nan, 0, 0)}, {"temperatures": (300, np.inf, 300)}])
def test_readings_that_are_no_numbers_switch_off(reading):
    guard = running()
    guard.admit(PUSH, FRESH)
    assert not guard.limit(np.ones(3), sample(**reading)).any()
    assert guard.reason is Trip.SAMPLE_NOT_FINITE


@settings(max_examples=200, deadline=None)
@given(st.lists(any_number, min_size=6, max_size=6))
def test_no_wrench_is_let_through_above_its_limit(numbers):
    guard = running()
    wrench = np.array(numbers)
    out = guard.admit(wrench, FRESH)
    assert np.isfinite(out).all()
    assert np.linalg.norm(out[:3]) <= OMNI.limits.force * (1 + 1e-9)
    assert np.linalg.norm(out[3:]) <= OMNI.limits.torque * (1 + 1e-9)
    if np.isfinite(wrench).all() and 1e-9 < np.abs(wrench[:3]).max() < 1e9:  # the clamp keeps direction
        assert np.allclose(np.cross(out[:3], wrench[:3] / np.linalg.norm(wrench[:3])), 0, atol=1e-9)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3), min_size=1, max_size=60))
def test_no_current_beyond_its_limit_and_no_step_beyond_the_slew(wanted):
    guard = running()
    last = guard.limit(np.array([1.0, 0, 0]), sample()).copy()
    for currents in wanted:
        guard.admit(PUSH, FRESH)
        out = guard.limit(np.array(currents), sample())
        assert (np.abs(out) <= OMNI.coils.current_limit * (1 + 1e-12)).all()
        assert (np.abs(out - last) <= OMNI.limits.slew * DT * (1 + 1e-9)).all()
        last = out.copy()


def test_limited_currents_keep_their_direction():
    guard = running()
    for _ in range(50):
        guard.admit(PUSH, FRESH)
        out = guard.limit(np.array([80.0, -40, 20]), sample()).copy()
    assert np.allclose(out, (20, -10, 5))


def test_an_old_pose_ramps_to_zero_and_latches():
    guard = running()
    stale = replace(FRESH, age=OMNI.limits.expiry * 1.01)
    asked = [float(guard.admit(PUSH, stale)[2]) for _ in range(60)]
    assert guard.reason is Trip.POSE_EXPIRED
    assert 0 < asked[10] < asked[0] < PUSH[2]  # a ramp, no cliff
    assert asked[-1] == 0.0
    assert is_off(guard)  # a fresh pose alone does not bring it back
    assert guard.tripped


def test_just_fresh_enough_is_fresh():
    guard = running()
    guard.admit(PUSH, replace(FRESH, age=OMNI.limits.expiry * 0.99))
    assert not guard.tripped


def test_an_age_that_is_no_number_is_not_fresh():
    guard = running()
    guard.admit(PUSH, replace(FRESH, age=np.nan))
    assert guard.tripped


def test_a_lost_pose_switches_off_at_once():
    guard = running()
    assert is_off(guard, estimate=replace(FRESH, valid=False))
    assert guard.reason is Trip.POSE_LOST


def test_it_cannot_be_engaged_blind():
    guard = Guard(OMNI, DT)
    assert not guard.engage()  # nothing has been seen yet
    guard.admit(PUSH, replace(FRESH, valid=False))
    assert not guard.engage()
    guard.admit(PUSH, FRESH)
    assert guard.engage()


def test_stop_latches_until_engaged_and_then_ramps_again():
    guard = running()
    guard.trip(Trip.STOPPED)
    for _ in range(100):
        assert is_off(guard)
    assert guard.engage()
    assert guard.state is GuardState.RAMPING
    assert guard.admit(PUSH, FRESH)[2] < 0.01 * PUSH[2]


def test_the_first_reason_stands():
    guard = running()
    guard.trip(Trip.OVERHEATED)
    guard.trip(Trip.STOPPED)
    assert guard.reason is Trip.OVERHEATED
    assert guard.trips == 1


def test_full_power_derates_after_about_five_seconds():
    """15 × P_ave is for 5 s (Zárate 2020 §V): then the guard begins to take current away."""
    guard = running()
    ticks = 0
    out = np.zeros(3)
    while guard.state is GuardState.RUNNING and ticks < 20_000:
        guard.admit(PUSH, FRESH)
        out = guard.limit(np.array([20.0, 0, 0]), sample(out)).copy()
        ticks += 1
    assert guard.state is GuardState.DERATED
    assert 3.5 < ticks * DT < 5.5  # copper's warming resistance makes it a little shorter than at constant power


def test_derating_takes_current_away_but_never_reaches_the_stop():
    guard = running()
    out = np.zeros(3)
    hottest = 0.0
    for _ in range(60_000):
        guard.admit(PUSH, FRESH)
        out = guard.limit(np.array([20.0, 0, 0]), sample(out, (guard.heat.body[0], 298.15, 298.15))).copy()
        hottest = max(hottest, guard.heat.winding[0])
    assert guard.state is GuardState.DERATED
    assert hottest < OMNI.coils.heat.stop
    assert 0 < out[0] < 12


def test_a_winding_above_the_stop_switches_off_and_cannot_be_engaged():
    guard = running()
    guard.heat.winding[1] = OMNI.coils.heat.stop + 0.1
    assert is_off(guard)
    assert guard.reason is Trip.OVERHEATED
    guard.heat.winding[1] = OMNI.coils.heat.derate + 1
    assert not guard.engage()
    guard.heat.winding[1] = OMNI.coils.heat.derate - 1
    assert guard.engage()


def test_a_temperature_that_is_no_number_switches_off():
    guard = running()
    guard.heat.winding[0] = np.nan
    assert is_off(guard)
    assert guard.reason is Trip.OVERHEATED


def test_more_current_than_allowed_is_a_broken_driver():
    guard = running()
    guard.admit(PUSH, FRESH)
    assert not guard.limit(np.zeros(3), sample((0, 26.0, 0))).any()
    assert guard.reason is Trip.OVERCURRENT


def test_the_remaining_time_is_what_then_happens():
    guard = running()
    load_current = np.array([10.0, 0, 0])
    for _ in range(8000):  # eight windows: the mean load has settled
        guard.admit(PUSH, FRESH)
        guard.limit(load_current, sample(load_current, guard.heat.body))
    predicted = guard.heat.remaining
    ticks = 0
    while guard.heat.winding[0] < OMNI.coils.heat.derate:
        guard.admit(PUSH, FRESH)
        guard.limit(load_current, sample(load_current, guard.heat.body))
        ticks += 1
    assert predicted == pytest.approx(ticks * DT, rel=0.02)


def test_a_load_that_may_last_is_not_counted_down():
    guard = running()
    for _ in range(3000):
        guard.admit(PUSH, FRESH)
        guard.limit(np.array([3.0, 0, 0]), sample((3.0, 0, 0), guard.heat.body))
    assert guard.heat.remaining == np.inf


def test_every_reason_has_its_sentence():
    assert all(trip.text for trip in Trip if trip is not Trip.NONE)
