"""Simulated coil arrays: actual against commanded wrench, yielding, contact, and reproducibility."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from haptorb import worlds
from haptorb.control.array_allocation import array_allocator
from haptorb.devices.base import State, rotation_to_axis
from haptorb.devices.coil_array import BuildTolerance
from haptorb.devices.loader import load
from haptorb.devices.placed_coils import place_coils
from haptorb.errors import DriverError, InputError
from haptorb.simulation.coil_array import SimulatedCoilArray
from haptorb.simulation.coil_array_specimen import draw_coils, draw_strength, fill_array_truth, make_array_truth
from haptorb.simulation.force_map import force_map

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
DEVICES = {name: load(name) for name in ("planar", "tetrahedron")}
every = pytest.mark.parametrize("name", DEVICES)


def settle(simulated, duties, p, seconds=0.1):
    for _ in range(round(seconds / 1e-3)):
        simulated.advance(1e-3, simulated.quantise(duties), p, UPRIGHT)
    return simulated.wrench_actual()


def force_at_rest(device, asked):
    """What is given where `asked` is allocated by the device's own map, in a hand that does not yield."""
    hand = replace(device.hand, stiffness=1e7, damping=1e4, turn_stiffness=1e4, turn_damping=10.0)
    simulated = SimulatedCoilArray(replace(device, hand=hand), seed=1)
    p = device.rest_position
    known = device.wrench_map(State.at(p, axis=(0, 0, 1)), "exact")
    currents = array_allocator(device).allocate(known, np.array([*asked, 0, 0, 0])).currents
    duties = currents * device.coils.resistance_at(simulated.winding) / device.supply.voltage
    return settle(simulated, duties, p)[:3]


@pytest.mark.parametrize("name", [pytest.param("planar", marks=pytest.mark.slow), "tetrahedron"])
def test_the_truth_is_off_by_how_the_coils_are_built(name):
    device, asked = DEVICES[name], np.array([0.05, -0.03, 0.08])
    built = np.linalg.norm(force_at_rest(device, asked) - asked) / np.linalg.norm(asked)
    ideal = replace(device, tolerance=BuildTolerance())
    exact = np.linalg.norm(force_at_rest(ideal, asked) - asked) / np.linalg.norm(asked)
    assert exact < 0.01  # steps of the duty, and the windings warm a little
    assert 1e-3 < built < 0.15
    assert built > exact


@every
def test_a_tool_pressed_down_touches_the_surface_and_not_the_coils(name):
    device = DEVICES[name]
    simulated = SimulatedCoilArray(device, seed=1)
    settle(simulated, np.zeros(device.channels), np.array([0.005, 0.0, 0.0]), 0.4)
    assert simulated.depth > 0
    p = simulated.state().p
    distance = np.linalg.norm(p) if device.surface.is_dome else p[2]
    assert distance == pytest.approx(device.contact_height, abs=2e-3)  # over a dome it leans a little


def test_a_tool_that_nobody_holds_falls_onto_the_plate_and_stays_there():
    device = DEVICES["planar"]
    simulated = SimulatedCoilArray(device, seed=1, held=False)
    settle(simulated, np.zeros(16), np.zeros(3), 0.3)
    assert simulated.state().p[2] == pytest.approx(device.contact_height, abs=1e-3)


@every
def test_a_moving_magnet_brakes_itself_in_shorted_coils(name):
    """The power that the induced voltage drives into the copper is taken from the motion."""
    device = DEVICES[name]
    simulated = SimulatedCoilArray(device, seed=1)
    start, end = device.rest_position, device.rest_position + np.array([0.02, 0, 0])
    settle(simulated, np.zeros(device.channels), start)
    power = 0.0
    for _ in range(100):
        simulated.advance(1e-3, np.zeros(device.channels), end, UPRIGHT)
        state, wrench = simulated.state(), simulated.wrench_actual()
        passive = device.wrench_map(state, "exact").passive
        power += float((wrench - passive)[:3] @ state.v + (wrench - passive)[3:] @ state.w) * 1e-3
    assert power < 0


@every
def test_between_two_maps_the_wrench_follows_the_moving_tool(name):
    """The map is computed once a millisecond; what is used between is the exact one at the tool's place, nearly."""
    device = replace(DEVICES[name], tolerance=BuildTolerance())
    simulated = SimulatedCoilArray(device, seed=1)
    duties, errors, sizes, fastest = simulated.quantise(np.full(device.channels, 0.1)), [], [], 0.0
    goal = device.rest_position + np.array([0.03, 0.0, 4e-3])
    for _ in range(400):
        state = simulated.state()
        simulated.advance(2.5e-4, duties, goal, UPRIGHT)
        exact = device.wrench_map(state, "exact").wrench(simulated._coils["mean"])[:3]
        errors.append(np.linalg.norm(simulated.wrench_actual()[:3] - exact))
        sizes.append(np.linalg.norm(exact))
        fastest = max(fastest, float(np.linalg.norm(state.v)))
    assert fastest > 0.2
    assert max(errors) < 3e-3 * max(sizes)


@every
def test_the_same_seed_is_the_same_to_the_bit_and_another_specimen_is_not(name):
    device = DEVICES[name]
    runs = []
    for specimen in (0, 0, 1):
        simulated = SimulatedCoilArray(device, seed=3, specimen=specimen)
        settle(simulated, np.full(device.channels, 0.2), device.rest_position, 0.01)
        sample = simulated.sample(0.0, 0.0, True)
        runs.append(np.concatenate([sample.currents, simulated.wrench_actual()]))
    assert (runs[0] == runs[1]).all()
    assert (runs[0] != runs[2]).any()
    assert (draw_coils(device, 1).position != draw_coils(device).position).all()


def places(device, count):
    """(count, 4, 3) tool upright or radial, from contact on: R above p."""
    rng = np.random.default_rng(4)
    for number in range(count):
        height = device.contact_height + number / count * device.surface.thickness
        if not device.surface.is_dome:
            yield np.vstack([np.eye(3), [*(rng.uniform(-1, 1, 2) * device.surface.half_width), height]])
            continue
        axis = np.array([*rng.uniform(-0.5, 0.5, 2), 1.0])
        axis /= np.linalg.norm(axis)
        yield np.vstack([rotation_to_axis(axis), height * axis])


@every
def test_loops_and_currents_give_the_controllers_model_without_tolerances(name):
    """Which has the magnets as charges in closed-form fields of the windings: 1e-3 of the greatest entry."""
    device = DEVICES[name]
    truth, matrix, passive = make_array_truth(device, device.windings), np.empty((6, device.channels)), np.empty(6)
    for pose in places(device, 12):
        fill_array_truth(truth, pose, matrix, passive)
        known = device.wrench_map(State(0.0, pose[:3], pose[3], np.zeros(3), np.zeros(3)), "exact")
        for rows in (slice(3), slice(3, 6)):
            error = np.abs(matrix[rows] - known.matrix[rows]).max()
            assert error < 1e-3 * np.abs(known.matrix[rows]).max()


@every
def test_a_drawn_array_is_computed_as_it_is_drawn(name):
    """Drawn windings in closed form on the charges of drawn magnets, without tables; no core."""
    device = replace(DEVICES[name], core=None)
    coils, strength = draw_coils(device, 2), draw_strength(device, 2)
    truth, matrix, passive = make_array_truth(device, coils, strength), np.empty((6, device.channels)), np.empty(6)
    charges = np.hstack([magnet.charges(10, 60) for magnet in device.tool.magnets])
    for pose in places(device, 3):
        fill_array_truth(truth, pose, matrix, passive)
        at = charges[:3].T @ pose[:3].T + pose[3]
        field = np.stack([coil.field(at) for coil in place_coils(coils)])
        force = strength * charges[3][:, None] * field
        exact = np.hstack([force.sum(axis=1), np.cross(at - pose[3], force).sum(axis=1)]).T
        for rows in (slice(3), slice(3, 6)):
            assert np.abs(matrix[rows] - exact[rows]).max() < 1e-3 * np.abs(exact[rows]).max()
        nominal = device.wrench_map(State(0.0, pose[:3], pose[3], np.zeros(3), np.zeros(3)), "exact").matrix
        assert np.abs(matrix - nominal)[:3].max() > 5e-3 * np.abs(nominal[:3]).max()
        assert not passive.any()


def test_the_force_on_an_arrays_dome_can_be_painted():
    device = DEVICES["tetrahedron"]
    points = device.contact_height * np.array([[0.0, 0.0, 1.0], [0.3, 0.0, 0.954]])
    nothing, limited = force_map(device, worlds.Nothing(), points)
    assert abs(nothing).max() < 1e-3  # the core's pull is known and compensated
    assert not limited.any()
    pushed, limited = force_map(device, worlds.Wall(normal=(0, 0, 1), offset=0.06, stiffness=500.0), points)
    assert (pushed > 0.02).all()
    assert limited.any()


def test_what_cannot_be_simulated_is_refused():
    simulated = SimulatedCoilArray(DEVICES["tetrahedron"])
    with pytest.raises(InputError):
        simulated.advance(11.0, np.zeros(4), np.zeros(3), UPRIGHT)
    with pytest.raises(InputError):
        simulated.place((0, 0, 0.05), (0, 0, 0, 0))
    simulated._tool["v"] = np.nan
    with pytest.raises(DriverError):
        simulated.sample(0.0, 0.0, True)
