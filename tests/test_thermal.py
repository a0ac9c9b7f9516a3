"""Two-node thermal model: exact step against an integrator, times to a limit, and the published endurances."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from haptorb.errors import InputError
from haptorb.thermal import TwoNode, heat_step, resistance_ratio, single_time_constant, warm_ratio
from oracles.endurance_fit import endurance_fit

COIL = TwoNode(15.0, 73.0, 1.9, 1 / 3)
coils = st.builds(TwoNode, st.floats(1, 50), st.floats(20, 500), st.floats(0.2, 10), st.floats(0.05, 3))


def integrate(coil, t, power, start=(0.0, 0.0)):
    """The rises at t by a general-purpose integrator; power is a function of the winding's rise."""

    def rate(_, x):
        flow = coil.winding_to_body * (x[0] - x[1])
        return [(power(x[0]) - flow) / coil.winding_capacity, (flow - coil.body_to_air * x[1]) / coil.body_capacity]

    return solve_ivp(rate, (0.0, t), start, rtol=1e-10, atol=1e-10).y[:, -1]


@given(coils, st.floats(0.0, 250.0), st.floats(0.01, 500.0), st.floats(0, 80), st.floats(0, 80))
def test_step_and_course_are_those_of_the_equations(coil, power, t, winding, body):
    truth = integrate(coil, t, lambda _: power, (winding, body))
    assert np.allclose(coil.step(t) @ [winding, body, power], truth, rtol=1e-6, atol=1e-6)
    assert np.allclose(coil.rise(t, power, (winding, body)), truth, rtol=1e-6, atol=1e-6)
    stepped = heat_step(coil.step(t), 298.15 + winding, 298.15 + body, 298.15, power)
    assert np.allclose(np.array(stepped) - 298.15, truth, rtol=1e-6, atol=1e-6)


@given(coils, st.floats(1e-5, 10.0))
def test_many_small_steps_are_one_large(coil, dt):
    step = np.vstack([coil.step(dt), [0, 0, 1]])
    whole = np.vstack([coil.step(64 * dt), [0, 0, 1]])
    assert np.allclose(np.linalg.matrix_power(step, 64), whole, rtol=1e-9, atol=1e-12)


def test_a_tick_keeps_its_precision_over_an_hour():
    step = COIL.step(1e-3)
    x = np.zeros(2)
    for _ in range(100_000):
        x = step @ [x[0], x[1], 17.0]
    assert np.allclose(x, COIL.rise(100.0, 17.0), rtol=1e-9)


def test_steady_state_is_where_it_stays():
    assert np.allclose(COIL.rise(1e5, 17.0), COIL.steady_rise(17.0), rtol=1e-9)
    assert np.allclose(COIL.step(3.0) @ [*COIL.steady_rise(17.0), 17.0], COIL.steady_rise(17.0))


@given(st.floats(20.0, 250.0), st.floats(0.0, 50.0), st.floats(0.0, 50.0))
def test_time_to_a_limit_is_when_the_course_gets_there(power, winding, body):
    t = COIL.time_to(60.0, power, (winding, body))
    assert np.isfinite(t)
    assert COIL.rise(t, power, (winding, body))[0] == pytest.approx(60.0, abs=1e-6)
    before = COIL.rise(np.linspace(0, t, 50)[:-1], power, (winding, body))[:, 0]
    assert (before < 60.0).all()


def test_a_hot_body_can_lift_a_cooler_winding_over_the_limit_and_down_again():
    t = COIL.time_to(40.0, 0.0, (30.0, 50.0))
    assert 0.0 < t < 30.0
    assert COIL.rise(t, 0.0, (30.0, 50.0))[0] == pytest.approx(40.0, abs=1e-6)
    assert COIL.time_to(49.0, 0.0, (30.0, 50.0)) == np.inf


@pytest.mark.parametrize("drive", ["current", "voltage"])
def test_times_with_resistance_that_follows_temperature(drive):
    alpha, power = 3.93e-3, 60.0
    t = COIL.time_to(60.0, power, drive=drive, coefficient=alpha)

    def heating(x):
        return power * (1 + alpha * x) if drive == "current" else power / (1 + alpha * x)

    assert integrate(COIL, t, heating)[0] == pytest.approx(60.0, abs=1e-3)


def test_constant_current_runs_away_where_constant_power_settles():
    assert COIL.time_to(1e4, 90.0) == np.inf
    t = COIL.time_to(1e4, 90.0, drive="current")
    assert np.isfinite(t)
    assert integrate(COIL, t, lambda x: 90.0 * (1 + 3.93e-3 * x))[0] == pytest.approx(1e4, rel=1e-5)
    assert COIL.time_to(1e4, 90.0, drive="voltage") == np.inf


def test_already_there_never_there_and_no_load():
    assert COIL.time_to(60.0, 10.0, (61.0, 0.0)) == 0.0
    assert COIL.time_to(60.0, 17.0 * 60 / 59.95 * 0.999) == np.inf
    assert COIL.time_to(1.0, 0.0) == np.inf


def test_one_time_constant_contradicts_itself():
    full, half = single_time_constant(230.0, 5.0, 17.0), single_time_constant(57.5, 60.0, 17.0)
    assert full == pytest.approx(65.1, abs=0.05)
    assert half == pytest.approx(171.2, abs=0.05)


@pytest.mark.parametrize(
    ("full", "limit", "inside"), [(240, 60, 0.15), (230, 60, 0.15), (255, 45, 0.1), (240, 80, 0.25)]
)
def test_two_nodes_hold_all_three_endurances(full, limit, inside):
    coil = endurance_fit(limit, full=full, half=full / 4, inside=inside)
    assert coil.steady_rise(17.0)[0] == pytest.approx(limit, rel=1e-12)
    assert coil.time_to(limit, full) == pytest.approx(5.0, rel=1e-6)
    assert coil.time_to(limit, full / 4) == pytest.approx(60.0, rel=1e-6)
    assert (coil.steady_rise(17.0)[0] - coil.steady_rise(17.0)[1]) / limit == pytest.approx(inside)


def test_the_fit_for_60_kelvin_in_numbers():
    coil = endurance_fit(60.0)
    assert coil.winding_capacity == pytest.approx(15.05, abs=0.01)
    assert coil.body_capacity == pytest.approx(72.9, abs=0.05)
    assert coil.winding_to_body == pytest.approx(1.889, abs=0.001)
    assert coil.body_to_air == pytest.approx(1 / 3, abs=1e-4)
    assert coil.time_constants == pytest.approx((6.57, 265.2), rel=2e-3)


@pytest.mark.parametrize(
    "bad",
    [
        {"inside": 0.0},
        {"inside": 0.9},
        {"sustained": 70.0},
        {"limit_rise": -1.0},
        {"full_time": np.nan},
        {"full_time": 61.0},
        {"inside": 0.01},
    ],
)
def test_endurances_that_no_two_bodies_have_are_refused(bad):
    with pytest.raises(InputError):
        endurance_fit(**bad)


def test_bad_input_is_refused():
    with pytest.raises(InputError, match="winding_capacity"):
        TwoNode(0.0, 1, 1, 1)
    with pytest.raises(InputError, match="body_to_air"):
        TwoNode(1.0, 1, 1, np.nan)
    with pytest.raises(InputError, match="dt"):
        COIL.step(-1.0)
    with pytest.raises(InputError, match="drive"):
        COIL.time_to(60, 10, drive="hope")
    with pytest.raises(InputError, match="start"):
        COIL.time_to(60, 10, (1, 2, 3))
    with pytest.raises(InputError, match="power"):
        COIL.time_to(60, -1)
    with pytest.raises(InputError, match="sustained"):
        single_time_constant(10.0, 5.0, 17.0)


def test_copper_warms_as_the_rule_for_machines_says():
    """IEC 60034-1: the resistances of copper are as 235 + t, with t in °C."""
    for celsius in (-20.0, 20.0, 75.0, 120.0):
        ratio = (235.0 + celsius) / (235.0 + 20.0)
        assert warm_ratio(3.93e-3, 293.15, 273.15 + celsius) == pytest.approx(ratio, rel=1e-3)
        assert resistance_ratio(3.93e-3, 293.15, np.array([273.15 + celsius])) == pytest.approx(ratio, rel=1e-3)
