"""Simulated sensors: the field from its three parts, and noise and quantisation as in the device file."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from haptorb.devices.loader import load
from haptorb.estimation.sensor_calibration import without_errors
from haptorb.magnetics.magnets import RingMagnet
from haptorb.magnetics.soft_sphere import SoftSphere
from haptorb.simulation.electromagnet import SimulatedElectromagnet
from oracles import wound_coils

OMNI = without_errors(load("omni"))  # sensors with noise and steps only
REST = np.zeros(3)
ways = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.2)


def fields(omni, count):
    return np.array([omni.sample(0.0, 0.0, True).field for _ in range(count)])


@settings(max_examples=15)
@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.05, 0.1), ways, st.tuples(*[st.floats(-1, 1)] * 3))
def test_the_field_is_electromagnet_ring_and_the_cores_answer(x, y, distance, turn, duties):
    direction = np.array([x, y, 1.0])
    p = direction / np.linalg.norm(direction) * distance
    R = Rotation.from_rotvec(turn)
    omni = SimulatedElectromagnet(OMNI, seed=5)
    omni.place(p, R.as_quat())
    goal = omni.state().p
    for _ in range(3):
        omni.advance(1e-3, np.array(duties), goal, R.as_quat())
    state = omni.state()
    ring = RingMagnet(*(getattr(OMNI.tool, name) for name in ("outer_radius", "inner_radius", "length", "remanence")))
    at = OMNI.hall.positions
    truth = wound_coils.coil_fields(OMNI, at) @ omni.currents
    truth = truth + ring.field((at - state.p) @ state.R_SR) @ state.R_SR.T
    core = SoftSphere(OMNI.core_radius, OMNI.core_permeability)
    truth += core.compute_induced_field(*omni.ring.place(state.R_SR, state.p), at)
    read = fields(omni, 400)
    error = read.mean(axis=0) - truth
    assert np.abs(error).max() < 5 * OMNI.hall.noise / 20 + 2e-7
    spread = np.hypot(OMNI.hall.noise, OMNI.hall.step / np.sqrt(12))
    assert np.allclose(read.std(axis=0).mean(), spread, rtol=0.03)


def test_currents_and_temperatures_have_the_noise_and_steps_of_the_file():
    omni = SimulatedElectromagnet(OMNI, seed=6)
    duties, goal, upright = omni.quantise(np.array([0.2, -0.1, 0.0])), omni.state().p, np.array([0, 0, 0, 1.0])
    for _ in range(200):
        omni.advance(1e-2, duties, goal, upright)
    samples = [omni.sample(0.0, 0.0, True) for _ in range(2000)]
    currents = np.array([s.currents for s in samples])
    boundary = np.array([s.temperatures for s in samples])
    supply = OMNI.supply
    assert np.allclose(currents.mean(axis=0), omni.currents, atol=5 * supply.current_noise / np.sqrt(2000))
    assert np.allclose(currents.std(axis=0), np.hypot(supply.current_noise, supply.current_step / 12**0.5), rtol=0.1)
    assert np.allclose(currents / supply.current_step, np.rint(currents / supply.current_step), atol=1e-6)
    assert np.allclose(boundary / OMNI.thermometer_step, np.rint(boundary / OMNI.thermometer_step), atol=1e-6)
    assert np.allclose(boundary.mean(axis=0), omni.boundary, atol=0.01)
    assert np.abs(np.corrcoef(currents.T) - np.eye(3)).max() < 0.1


@pytest.mark.parametrize("sign", [1, -1])
def test_a_wrong_polarity_can_be_seen(sign):
    omni = SimulatedElectromagnet(OMNI, seed=1)
    omni.place((0, 0, 0.055), (0, 0, 0, 1) if sign > 0 else (1, 0, 0, 0))
    below = int(np.argmin(OMNI.hall.positions[:, 2]))
    assert sign * fields(omni, 100)[:, below, 2].mean() > 1e-5
