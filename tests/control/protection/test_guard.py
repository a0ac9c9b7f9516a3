"""Guard: for each hazard of a powered magnet one test that fails if the guard ignores it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haptorb.control.trip_reasons import GuardState, Trip

from .protected import DT, FRESH, OMNI, PUSH, Loop, is_off, sample

any_number = st.floats(allow_nan=True, allow_infinity=True, width=64)


def test_off_is_the_default():
    loop = Loop()
    for _ in range(100):
        assert not loop.ask().any()
        assert is_off(loop)


def test_it_starts_from_zero_and_ramps():
    loop = Loop()
    loop.ask()
    loop.protection.engage()
    asked = [float(loop.ask()[2]) for _ in range(400)]
    assert asked[0] < 0.01 * PUSH[2]
    assert (np.diff(asked) >= 0).all()
    assert np.max(np.diff(asked)) < 0.005 * PUSH[2]
    assert asked[-1] == PUSH[2]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", range(6))
def test_a_wrench_that_is_no_number_switches_off(bad, place):
    loop = Loop().run()
    wrench = PUSH.copy()
    wrench[place] = bad
    assert is_off(loop, wrench)
    assert loop.protection.reason is Trip.WORLD_NOT_FINITE
    assert is_off(loop)  # and stays off when the world is sane again


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", range(3))
def test_currents_that_are_no_numbers_switch_off(bad, place):
    loop = Loop().run()
    currents = np.ones(3)
    currents[place] = bad
    assert not loop.tick(currents).any()
    assert loop.protection.reason is Trip.CURRENTS_NOT_FINITE


@pytest.mark.parametrize("reading", [{"currents": (np.nan, 0, 0)}, {"temperatures": (300, np.inf, 300)}])
def test_readings_that_are_no_numbers_switch_off(reading):
    loop = Loop().run()
    loop.ask()
    loop.drive(np.ones(3), sample(**reading), applied=np.zeros(3))
    assert not loop.held.any()
    assert loop.protection.reason is Trip.SAMPLE_NOT_FINITE


@settings(max_examples=200, deadline=None)
@given(st.lists(any_number, min_size=6, max_size=6))
def test_no_wrench_is_let_through_above_its_limit(numbers):
    loop = Loop().run()
    wrench = np.array(numbers)
    out = loop.ask(wrench)
    assert np.isfinite(out).all()
    assert np.linalg.norm(out[:3]) <= OMNI.limits.force * (1 + 1e-9)
    assert np.linalg.norm(out[3:]) <= OMNI.limits.torque * (1 + 1e-9)
    if np.isfinite(wrench).all() and 1e-9 < np.abs(wrench[:3]).max() < 1e9:  # the clamp keeps direction
        assert np.allclose(np.cross(out[:3], wrench[:3] / np.linalg.norm(wrench[:3])), 0, atol=1e-9)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3), min_size=1, max_size=60))
def test_no_current_beyond_its_limit_and_no_step_beyond_the_slew(wanted):
    loop = Loop().run()
    last = loop.tick((1.0, 0, 0))
    for currents in wanted:
        out = loop.tick(currents)
        assert (np.abs(out) <= OMNI.coils.current_limit * (1 + 1e-12)).all()
        assert (np.abs(out - last) <= OMNI.limits.slew * DT * (1 + 1e-9)).all()
        last = out


def test_the_supply_gives_no_more_than_its_power_whatever_is_wanted():
    """All coils at 20 A would take 720 W of cold and more of warm windings; of 360 W each gets the same share."""
    loop = Loop().run()
    hot = OMNI.coils.resistance_at(np.full(3, OMNI.coils.heat.stop))
    for wanted in ((20.0, -20, 20), (-20.0, 3, 20), (20.0, 20, 0)):
        for _ in range(60):
            out = loop.tick(wanted)
            assert hot @ out**2 <= OMNI.supply.power * (1 + 1e-9)
        assert hot @ out**2 == pytest.approx(OMNI.supply.power)
        assert np.allclose(out / out[0], np.array(wanted) / wanted[0])


def test_saturation_keep_their_direction():
    loop = Loop().run()
    for _ in range(50):
        out = loop.tick((80.0, -20, 10))
    assert np.allclose(out, (20, -5, 2.5))


def test_an_old_pose_ramps_to_zero_and_latches():
    loop = Loop().run()
    stale = replace(FRESH, age=OMNI.limits.expiry * 1.01)
    asked = [float(loop.ask(PUSH, stale)[2]) for _ in range(60)]
    assert loop.protection.reason is Trip.POSE_EXPIRED
    assert 0 < asked[10] < asked[0] < PUSH[2]  # a ramp, no cliff
    assert asked[-1] == 0.0
    assert is_off(loop)  # a fresh pose alone does not bring it back
    assert loop.protection.tripped


def test_just_fresh_enough_is_fresh():
    loop = Loop().run()
    loop.ask(PUSH, replace(FRESH, age=OMNI.limits.expiry * 0.99))
    assert not loop.protection.tripped


def test_an_age_that_is_no_number_is_not_fresh():
    loop = Loop().run()
    loop.ask(PUSH, replace(FRESH, age=np.nan))
    assert loop.protection.tripped


def test_a_lost_pose_switches_off_at_once():
    loop = Loop().run()
    assert is_off(loop, estimate=replace(FRESH, valid=False))
    assert loop.protection.reason is Trip.POSE_LOST


def test_it_cannot_be_engaged_blind():
    loop = Loop()
    assert not loop.protection.engage()  # nothing has been seen yet
    loop.ask(PUSH, replace(FRESH, valid=False))
    assert not loop.protection.engage()
    loop.ask()
    assert loop.protection.engage()


def test_it_does_not_start_with_a_pose_that_is_lost_or_old():
    for bad in (replace(FRESH, valid=False), replace(FRESH, age=1.0)):
        loop = Loop()
        loop.protection.start(bad)
        assert loop.protection.guard_state is GuardState.OFF
        loop.protection.start(FRESH)
        assert loop.protection.guard_state is GuardState.RAMPING


def test_stop_latches_until_engaged_and_then_ramps_again():
    loop = Loop().run()
    loop.protection.trip(Trip.STOPPED)
    for _ in range(100):
        loop.protection.start(FRESH)  # as the loop does with every pose that may be believed
        assert is_off(loop)
    assert loop.protection.engage()
    assert loop.protection.guard_state is GuardState.RAMPING
    assert loop.ask()[2] < 0.01 * PUSH[2]


def test_the_first_reason_stands():
    loop = Loop().run()
    loop.protection.trip(Trip.OVERHEATED)
    loop.protection.trip(Trip.STOPPED)
    assert loop.protection.reason is Trip.OVERHEATED
    assert loop.protection.state["guard"]["trips"][0] == 1


def test_full_power_derates_after_about_five_seconds():
    """15 × P_ave is for 5 s (Zárate 2020 §V): then the guard begins to take current away."""
    loop = Loop().run()
    ticks = 0
    while loop.protection.guard_state is GuardState.RUNNING and ticks < 20_000:
        loop.tick((20.0, 0, 0))
        ticks += 1
    assert loop.protection.guard_state is GuardState.DERATED
    assert 3.5 < ticks * DT < 5.5  # copper's warming resistance makes it a little shorter than at constant power


def test_derating_takes_current_away_but_never_reaches_the_stop():
    loop = Loop().run()
    coils = loop.protection.coils
    hottest = 0.0
    for _ in range(60_000):
        out = loop.tick((20.0, 0, 0), sample(loop.held, (coils["body"][0], 298.15, 298.15)))
        hottest = max(hottest, coils["winding"][0])
    assert loop.protection.guard_state is GuardState.DERATED
    assert hottest < OMNI.coils.heat.stop
    assert 0 < out[0] < 12


def test_a_winding_above_the_stop_switches_off_and_cannot_be_engaged():
    loop = Loop().run()
    coils = loop.protection.coils
    coils["winding"][1] = OMNI.coils.heat.stop + 0.1
    assert is_off(loop)
    assert loop.protection.reason is Trip.OVERHEATED
    coils["winding"][1] = OMNI.coils.heat.derate + 1
    assert not loop.protection.engage()
    coils["winding"][1] = OMNI.coils.heat.derate - 1
    assert loop.protection.engage()


def test_a_temperature_that_is_no_number_switches_off():
    loop = Loop().run()
    loop.protection.coils["winding"][0] = np.nan
    assert is_off(loop)
    assert loop.protection.reason is Trip.OVERHEATED


def test_more_current_than_allowed_is_a_broken_driver():
    loop = Loop().run()
    reading = sample((0, 26.0, 0))
    assert not loop.tick(np.zeros(3), reading).any()
    assert loop.protection.reason is Trip.OVERCURRENT


def test_the_remaining_time_is_what_then_happens():
    loop = Loop().run()
    coils, load = loop.protection.coils, np.array([10.0, 0, 0])
    for _ in range(8000):  # eight windows: the mean load has settled
        loop.tick(load, sample(load, coils["body"]))
    predicted = loop.protection.state["heat"]["remaining"][0]
    ticks = 0
    while coils["winding"][0] < OMNI.coils.heat.derate:
        loop.tick(load, sample(load, coils["body"]))
        ticks += 1
    assert predicted == pytest.approx(ticks * DT, rel=0.02)


def test_a_load_that_may_last_is_not_counted_down():
    loop = Loop().run()
    for _ in range(3000):
        loop.tick((3.0, 0, 0), sample((3.0, 0, 0), loop.protection.coils["body"]))
    assert loop.protection.state["heat"]["remaining"][0] == np.inf


def test_every_reason_has_its_sentence():
    assert all(trip.text for trip in Trip if trip is not Trip.NONE)


def test_a_loop_that_was_absent_for_half_a_second_waits_for_a_person():
    """A pause of the computer restarts the ramp; a process that was stopped switches nothing on by itself."""
    loop = Loop().run()
    loop.now += 0.1
    loop.ask()
    assert loop.protection.guard_state is GuardState.RAMPING
    loop.run()
    loop.now += 0.6
    assert is_off(loop)
    assert loop.protection.reason is Trip.OVERRUN
    assert is_off(loop)
