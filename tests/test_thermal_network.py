"""Thermally coupled coils: exact step and course against an integrator, and properties of a network."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from haptorb.devices.loader import load
from haptorb.errors import InputError
from haptorb.thermal import ThermalNetwork, TwoNode, network_step

COIL = TwoNode(15.0, 40.0, 1.4, 0.15)
conductances = st.lists(st.floats(0.05, 2.0), min_size=2, max_size=4)
networks = st.builds(
    lambda w, b, inside, air, to_core, core: ThermalNetwork.of_coils(TwoNode(w, b, inside, air), to_core, core),
    st.floats(5, 50), st.floats(20, 200), st.floats(0.5, 4), st.floats(0.05, 1), conductances, st.floats(10, 200),
)  # fmt: skip


def integrate(coil, to_core, core_capacity, t, power, start, coefficient=0.0):
    """The rises at t by a general-purpose integrator, written from the equations coil by coil."""
    m = len(to_core)

    def rate(_, x):
        w, b, c = x[:m], x[m : 2 * m], x[-1]
        inside, core = coil.winding_to_body * (w - b), np.asarray(to_core) * (w - c)
        heat = power * (1.0 + coefficient * w)
        return np.concatenate(
            [
                (heat - inside - core) / coil.winding_capacity,
                (inside - coil.body_to_air * b) / coil.body_capacity,
                [core.sum() / core_capacity],
            ]
        )

    return solve_ivp(rate, (0.0, t), start, method="LSODA", rtol=1e-10, atol=1e-10).y[:, -1]


@settings(max_examples=20, deadline=None)
@given(conductances, st.floats(10, 200), st.floats(0.1, 500.0), st.integers(0, 1000))
def test_step_and_course_are_those_of_the_equations(to_core, core, t, seed):
    draw, m = np.random.default_rng(seed), len(to_core)
    power, start = draw.uniform(0, 100, m), draw.uniform(0, 50, 2 * m + 1)
    network = ThermalNetwork.of_coils(COIL, to_core, core)
    truth = integrate(COIL, to_core, core, t, power, start)
    assert np.allclose(network.step(t) @ [*start, *power], truth, rtol=1e-6, atol=1e-6)
    assert np.allclose(network.rise(t, power, start), truth, rtol=1e-6, atol=1e-6)
    out = np.empty(2 * m + 1)
    network_step(network.step(t), start, power, out)
    assert np.allclose(out, truth, rtol=1e-6, atol=1e-6)


@settings(max_examples=30, deadline=None)
@given(networks)
def test_heat_goes_both_ways_alike_and_all_of_it_to_the_air(network):
    """Onsager's reciprocity; in the steady state what enters the windings leaves the nodes to the air."""
    rise = network.rise_per_watt
    assert np.allclose(rise, rise.T, rtol=1e-9)
    assert (rise > 0).all()
    assert (rise.diagonal()[:, None] >= rise).all()
    power = np.arange(1.0, network.windings + 1)
    assert network.to_air @ network.steady_rise(power) == pytest.approx(power.sum(), rel=1e-9)
    far = 100 * network.time_constants[0]
    assert np.allclose(network.rise(far, power), network.steady_rise(power), rtol=1e-9)


def test_without_a_core_every_coil_is_two_nodes():
    pair = ThermalNetwork.of_coils(COIL, (0.0, 0.0), 1.0)
    assert pair.nodes == 4
    course, single = pair.rise((3.0, 60.0), (17.0, 60.0)), [COIL.rise((3.0, 60.0), power) for power in (17.0, 60.0)]
    assert np.allclose(course[:, [0, 2]], single[0])
    assert np.allclose(course[:, [1, 3]], single[1])
    for drive in ("power", "current"):
        assert pair.time_to(60.0, (50.0, 40.0), drive=drive) == pytest.approx(
            COIL.time_to(60.0, 50.0, drive=drive), rel=1e-9
        )


@pytest.mark.parametrize(
    ("power", "coefficient"), [((60.0, 0, 0), 0.0), ((60.0, 30.0, 0), 3.93e-3), ((20.0,) * 3, 3.93e-3)]
)
def test_the_time_to_a_limit_is_when_the_course_gets_there(power, coefficient):
    to_core, start = (0.5, 0.4, 0.6), np.array([5.0, 0, 3, 2, 0, 1, 1])
    network = ThermalNetwork.of_coils(COIL, to_core, 50.0)
    drive = "current" if coefficient else "power"
    t = network.time_to(40.0, power, start, drive=drive, coefficient=coefficient)
    truth = integrate(COIL, to_core, 50.0, t, np.array(power), start, coefficient)
    assert truth[:3].max() == pytest.approx(40.0, abs=1e-5)
    before = integrate(COIL, to_core, 50.0, 0.99 * t, np.array(power), start, coefficient)
    assert before[:3].max() < 40.0


def test_two_coils_on_last_shorter_than_one():
    network = ThermalNetwork.of_coils(COIL, (0.5, 0.5, 0.5), 50.0)
    one, two = network.time_to(60.0, (40.0, 0, 0)), network.time_to(60.0, (40.0, 40.0, 0))
    assert two < 0.95 * one
    assert network.time_to(60.0, (12.0, 0, 0)) == np.inf
    assert np.isfinite(network.time_to(60.0, (12.0, 12.0, 12.0)))
    assert network.time_to(60.0, (0, 0, 0), np.full(7, 61.0)) == 0.0


def test_currents_that_run_away_reach_the_limit_all_the_same():
    """Constant currents whose heat grows faster than it leaves; pytest takes an overflow on the way for an error."""
    network = ThermalNetwork.of_coils(COIL, (0.5, 0.5, 0.5), 50.0)
    t = network.time_to(60.0, (400.0, 400.0, 0), drive="current")
    truth = integrate(COIL, (0.5, 0.5, 0.5), 50.0, t, np.array([400.0, 400.0, 0]), np.zeros(7), 3.93e-3)
    assert truth[:3].max() == pytest.approx(60.0, abs=1e-4)


def test_the_printed_endurances_are_those_of_one_coil_of_the_omni():
    """17 W for ever, 240 W for 5 s, 60 W for 60 s (Zárate 2020 §III, §V), whichever coil; together they last less."""
    omni = load("omni")
    heat, network = omni.coils.heat, omni.coils.heat.network(3)
    rise = heat.derate - heat.ambient
    for one in np.eye(3):
        assert rise / (one @ network.rise_per_watt @ one) == pytest.approx(17.0, abs=0.1)
        assert network.time_to(rise, 240.0 * one) == pytest.approx(5.0, abs=0.1)
        assert network.time_to(rise, 60.0 * one) == pytest.approx(60.0, abs=0.5)
    alone, together = omni.sustained_current, omni.sustained_current_together
    assert (together < 0.75 * alone).all()
    resistance = omni.coils.resistance_at(np.full(3, heat.derate))
    assert network.steady_rise(together**2 * resistance)[:3].max() == pytest.approx(rise, rel=1e-9)
    pmsm = load("pmsm")
    assert pmsm.sustained_current_together == pytest.approx(pmsm.sustained_current, rel=1e-6)


def test_what_is_no_network_is_refused():
    with pytest.raises(InputError, match="conduct heat to the air"):
        ThermalNetwork(np.ones(2), np.zeros((2, 2)), np.array([1.0, 0.0]), 1)
    with pytest.raises(InputError, match="positive"):
        ThermalNetwork.of_coils(COIL, (0.5,), 0.0)
    with pytest.raises(InputError, match="none negative"):
        ThermalNetwork.of_coils(COIL, (0.5, -0.5), 50.0)
    network = ThermalNetwork.of_coils(COIL, (0.5, 0.5), 50.0)
    for wrong in ({"power": (1.0,)}, {"power": (-1.0, 0.0)}, {"power": (1.0, 1.0), "drive": "hope"}):
        with pytest.raises(InputError):
            network.time_to(60.0, **wrong)
    with pytest.raises(InputError, match="dt"):
        network.step(-1.0)
