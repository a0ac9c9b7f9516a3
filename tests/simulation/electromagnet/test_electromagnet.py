"""Simulated Omni as a whole: actual against commanded wrench, yielding, heat, and reproducibility."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from haptorb.devices.base import DeviceKind
from haptorb.devices.loader import load
from haptorb.errors import DeviceError, DriverError, InputError
from haptorb.estimation.sensor_calibration import without_errors
from haptorb.simulation.electromagnet import SimulatedElectromagnet
from haptorb.simulation.registry import simulate

OMNI = without_errors(load("omni"))  # sensors with noise and steps only
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
OFF = np.zeros(3)


def hold_still(device=OMNI, **changes):
    """The Omni in a hand that does not yield, so that forces can be read at a known place."""
    hand = dataclasses.replace(
        device.hand, stiffness=1e7, damping=1e4, turn_stiffness=1e4, turn_damping=10.0, **changes
    )
    return SimulatedElectromagnet(dataclasses.replace(device, hand=hand))


def settle(omni, duties, p, q=UPRIGHT, seconds=0.05):
    for _ in range(round(seconds / 1e-3)):
        omni.advance(1e-3, omni.quantise(duties), p, q)
    return omni.wrench_actual()


@pytest.mark.parametrize(
    ("distance", "excess", "pull"), [(0.0501, 0.156, 52.2), (0.06, 0.107, 12.25), (0.07, 0.078, 3.74)]
)
def test_the_dipole_inverse_gives_too_much_and_the_core_pulls(distance, excess, pull):
    """Errata E16 and E18 as a user meets them, coils as points: what is given against what dipoles would give."""
    omni, p = hold_still(dataclasses.replace(OMNI, windings=None)), np.array([0.0, 0.0, distance])
    omni.place(p, UPRIGHT)
    passive = settle(omni, OFF, p)
    assert -1e3 * passive[2] == pytest.approx(pull, rel=0.02)
    state = omni.state()
    asked = np.array([0.0, 0.0, 0.1])
    matrix = OMNI.wrench_map(state, "published").matrix[:3]
    currents = np.linalg.solve(matrix, asked)
    duties = currents * OMNI.coils.resistance_at(omni.winding) / OMNI.supply.voltage
    given = settle(omni, duties, p)
    true_currents = omni.currents
    modelled = matrix @ true_currents
    assert modelled[2] == pytest.approx(0.1, rel=0.01)  # the drive gives the currents
    assert (given - passive)[2] / modelled[2] - 1 == pytest.approx(excess, abs=2e-3)


def test_truth_is_the_devices_exact_wrench_map():
    omni, q = hold_still(), np.array([0.15, -0.1, 0.05, 1.0])
    p = np.array([0.02, -0.01, 0.055])
    omni.place(p, q)
    settle(omni, np.array([0.3, -0.2, 0.1]), p, q)
    exact = OMNI.wrench_map(omni.state(), "exact").wrench(omni.currents)
    assert np.allclose(omni.wrench_actual(), exact, rtol=0, atol=1e-3 * np.linalg.norm(exact[:3]))


def test_the_stylus_visibly_yields():
    """0.4 N on a grip of 100 N/m: 4 mm."""
    omni, p = SimulatedElectromagnet(OMNI), np.array([0.0, 0.0, 0.056])
    omni.place(p, UPRIGHT)
    for _ in range(1500):
        wrench_map = OMNI.wrench_map(omni.state(), "exact")
        currents = np.linalg.lstsq(wrench_map.force, np.array([0, 0, 0.4]) - wrench_map.passive[:3], rcond=None)[0]
        duties = currents * OMNI.coils.resistance_at(omni.winding) / OMNI.supply.voltage
        omni.advance(1e-3, omni.quantise(duties), p, UPRIGHT)
    moved = omni.state().p - p
    assert moved[2] == pytest.approx(4e-3, rel=0.03)
    assert np.abs(moved[:2]).max() < 2e-4
    assert omni.wrench_actual()[2] == pytest.approx(0.4, rel=0.02)


def test_pressing_on_the_dome_the_tip_stays_outside():
    omni, goal = SimulatedElectromagnet(OMNI), np.array([0.0, 0.0, 0.045])
    omni.place((0, 0, 0.055), UPRIGHT)
    settle(omni, OFF, goal, seconds=1.0)
    assert 0.0 < omni.depth < 1e-4
    assert omni.state().distance == pytest.approx(OMNI.contact_distance, abs=1e-4)
    assert np.abs(omni.state().v).max() < 1e-3


def test_let_go_it_falls_and_in_the_hand_it_does_not():
    loose, held = SimulatedElectromagnet(OMNI, held=False), SimulatedElectromagnet(OMNI)
    for omni in (loose, held):
        omni.place((0.3, 0, 0.3), UPRIGHT)
        settle(omni, OFF, np.array([0.3, 0, 0.3]), seconds=0.1)
    assert loose.state().v[2] == pytest.approx(-0.980665, rel=1e-4)
    assert held.state().p == pytest.approx([0.3, 0, 0.3], abs=1e-5)


def test_a_moving_magnet_induces_currents_that_brake_it():
    """Shorted coils take exactly the power that they brake with."""
    omni = SimulatedElectromagnet(OMNI, held=False)
    omni.place((0, 0, 0.075), UPRIGHT)
    height, heat = omni.state().p[2], omni.winding.sum()
    settle(omni, OFF, OFF, seconds=0.05)
    assert omni.state().p[2] < height
    assert omni.currents[2] != 0.0
    assert omni.winding.sum() > heat
    braking = OMNI.wrench_map(omni.state(), "exact").matrix[2] @ omni.currents
    assert braking > 0.0  # upwards, while it falls


def test_energy_of_coils_tool_and_heat_adds_up():
    """Elastic dome, no supply: kinetic + height + magnetic in the coils + core's energy + heat stays what it was."""
    contact = dataclasses.replace(OMNI.contact, damping=0.0, friction=0.0)
    device = dataclasses.replace(OMNI, contact=contact)
    omni = SimulatedElectromagnet(device, held=False, step=2e-5)
    omni.place((0.0, 0.0, 0.065), UPRIGHT)
    heat = device.coils.heat

    def total():
        state = omni.state()
        stored = 0.5 * contact.stiffness * omni.depth**2
        warm = heat.winding_capacity * (omni.winding - heat.ambient).sum()
        warm += heat.body_capacity * (omni.boundary - heat.ambient).sum()  # 30 ms: nothing has left to the air
        return (
            omni.energy
            + device.tool.mass * 9.80665 * state.p[2]
            + 0.5 * device.coils.inductance @ omni.currents**2
            + device.passive_pull.energy(state.p, state.axis)
            + stored
            + warm
        )

    start, fallen = total(), []
    for _ in range(90):
        omni.advance(1e-3, OFF, OFF, UPRIGHT)
        fallen.append(total() - start)
    scale = device.tool.mass * 9.80665 * 0.015
    assert omni.state().v[2] > 0.0  # it has bounced
    assert np.abs(fallen).max() < 2e-2 * scale


def test_the_same_seed_and_calls_give_the_same_bits():
    def course(seed):
        omni, rows = SimulatedElectromagnet(OMNI, seed, specimen=0), []
        for n in range(300):
            duties = omni.quantise(0.3 * np.sin(0.05 * n + np.arange(3)))
            goal = np.array([0.02 * np.sin(0.01 * n), 0.0, 0.052])
            omni.advance(1e-3, duties, goal, UPRIGHT)
            sample = omni.sample(n * 1e-3, n * 1e-3, True)
            rows.append(
                np.concatenate(
                    [sample.currents, sample.temperatures, sample.field.ravel(), sample.pose.p, omni.wrench_actual()]
                )
            )
        return np.array(rows)

    first = course(1)
    assert np.array_equal(first, course(1))
    other = course(2)
    assert not np.array_equal(first[:, :3], other[:, :3])  # the noise differs
    assert np.array_equal(first[:, -9:], other[:, -9:])  # the world does not


def test_reset_begins_again():
    omni = SimulatedElectromagnet(OMNI, seed=4)
    start, first = omni.state(), omni.sample(0.0, 0.0, True)
    settle(omni, np.ones(3), np.array([0.01, 0, 0.05]), seconds=0.3)
    omni.reset(4)
    again = omni.sample(0.0, 0.0, True)
    assert np.array_equal(omni.state().p, start.p)
    assert not omni.currents.any()
    assert not omni.wrench_actual().any()
    assert (omni.winding == OMNI.coils.heat.ambient).all()
    assert np.array_equal(first.field, again.field)
    assert np.array_equal(first.currents, again.currents)


def test_finer_steps_change_little():
    ends = []
    for step in (2.5e-4, 2.5e-5):
        omni = SimulatedElectromagnet(OMNI, step=step)
        omni.place((0.0, 0.0, 0.055), UPRIGHT)
        settle(omni, np.array([0.1, 0.0, -0.2]), np.array([0.01, 0, 0.05]), seconds=0.4)
        ends.append(np.concatenate([omni.state().p, omni.currents / 1e3]))
    assert np.abs(ends[0] - ends[1]).max() < 1e-4


@settings(max_examples=25)
@given(
    arrays(float, 3, elements=st.floats(allow_nan=True, allow_infinity=True)),
    arrays(float, 4, elements=st.floats(allow_nan=True, allow_infinity=True)),
    arrays(float, 3, elements=st.floats(-0.2, 0.2)),
    arrays(float, 3, elements=st.floats(-1, 1)),
)
def test_no_goal_and_no_duty_takes_it_out_of_the_numbers(bad_p, bad_q, p, duties):
    omni = SimulatedElectromagnet(OMNI)
    omni.advance(5e-3, omni.quantise(duties), p, UPRIGHT)
    omni.advance(5e-3, omni.quantise(duties), np.where(np.abs(bad_p) < 1e3, bad_p, np.nan), bad_q)
    omni.advance(0.2, omni.quantise(duties), p, bad_q)
    state = omni.state()
    assert np.isfinite(state.p).all()
    assert np.allclose(state.R_SR @ state.R_SR.T, np.eye(3), atol=1e-9)
    assert np.isfinite(omni.wrench_actual()).all()
    assert np.isfinite(omni.sample(0.0, 0.0, True).field).all()


def test_a_pose_is_the_trackers_word_and_stays_what_it_was():
    omni = SimulatedElectromagnet(OMNI)
    sample = omni.sample(1.0, 0.9, False)
    p = sample.pose.p.copy()
    settle(omni, OFF, np.array([0.02, 0, 0.05]))
    assert (sample.t, sample.pose.t, sample.pose.valid) == (1.0, 0.9, False)
    assert np.array_equal(sample.pose.p, p)
    assert not np.array_equal(omni.state().p, p)
    assert sample.field.shape == (OMNI.sensors, 3)


def test_a_place_in_the_dome_is_lifted_to_contact():
    omni = SimulatedElectromagnet(OMNI)
    omni.place((0.0, 0.01, 0.01), UPRIGHT)
    assert omni.state().distance == pytest.approx(OMNI.contact_distance)


def test_bad_input_is_refused():
    omni = SimulatedElectromagnet(OMNI)
    for dt in (-1e-3, np.nan, 11.0):
        with pytest.raises(InputError, match="advance"):
            omni.advance(dt, OFF, OFF, UPRIGHT)
    with pytest.raises(InputError, match="step"):
        SimulatedElectromagnet(OMNI, step=0.0)
    with pytest.raises(InputError, match="seed"):
        SimulatedElectromagnet(OMNI, seed=-3)
    for p, q in (((0, 0, 0), UPRIGHT), ((0, 0, 0.05), (0, 0, 0, 0)), ((0, 0, np.nan), UPRIGHT), ((0, 0.05), UPRIGHT)):
        with pytest.raises(InputError):
            omni.place(p, q)
    hard = dataclasses.replace(OMNI, contact=dataclasses.replace(OMNI.contact, stiffness=1e12))
    with pytest.raises(InputError, match="soften the dome"):
        SimulatedElectromagnet(hard)


def test_a_device_that_cannot_be_built_is_told_not_simulated_into_nonsense():
    coils = dataclasses.replace(OMNI.coils, resistance=np.full(3, np.nan))
    omni = SimulatedElectromagnet(dataclasses.replace(OMNI, coils=coils))
    omni.advance(1e-2, np.ones(3), np.array([0, 0, 0.05]), UPRIGHT)
    with pytest.raises(DriverError, match="not finite"):
        omni.sample(0.0, 0.0, True)


def test_the_registry_knows_which_simulation_belongs_to_a_device():
    assert isinstance(simulate(OMNI, 2), SimulatedElectromagnet)

    class Unknown:
        name = "unknown"
        kind = DeviceKind(name="unknown", title="mystery", world="nothing")

    with pytest.raises(DeviceError, match="cannot be simulated"):
        simulate(Unknown())  # type: ignore[arg-type]
