"""Network and linear map from field to torque per ampere: symmetry, accuracy, faulty sensors, files."""

from dataclasses import replace

import numpy as np
import pytest

import haptorb
from haptorb.devices.motor_layout import Layout
from haptorb.errors import InputError, UnknownName
from haptorb.estimation.motor_orientation import LeastSquaresOrientation
from haptorb.estimation.network import (
    FieldToTorque,
    LinearTorque,
    NetworkTorque,
    neighbourhoods,
    networks_path,
    read_networks,
    squash,
    train,
    workspace_grid,
    write_networks,
)
from haptorb.estimation.registry import FIELD_ESTIMATORS, field_estimator
from haptorb.estimation.types import Pose, Sample
from haptorb.rotations import rotation_from_euler

TILT = np.radians(22.5)
NOBODY = Pose(0.0, np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3), False)


@pytest.fixture(scope="module")
def pmsm():
    return haptorb.load("pmsm")


@pytest.fixture(scope="module")
def networks(pmsm):
    """Trained in a hurry: good to a few per cent, which is enough to see that everything is in its place."""
    return train(pmsm, starts=3, iterations=25, grid=(9, 9, 32))


@pytest.fixture(scope="module")
def maps(pmsm, networks):
    return {"network": NetworkTorque(pmsm, networks), "linear": LinearTorque(pmsm)}


def random_orientations(count, seed):
    rng = np.random.default_rng(seed)
    psi, lam = rng.uniform(-TILT, TILT, (2, count))
    return rotation_from_euler(psi, lam, rng.uniform(-np.pi, np.pi, count))


def sample(motor, R, t=0.0, currents=None):
    flowing = np.zeros(motor.channels) if currents is None else currents
    field = motor.sensor_field(R[None], "table")[0] + motor.coil_field(motor.sensor_layout.positions, flowing)
    return Sample(t, flowing, np.full(motor.channels, 293.0), field, NOBODY)


def ask(torque_map, motor, R):
    """K of all coils at R (n, 3, 3)."""
    out, known = np.empty((len(R), 3, len(motor.electromagnets))), np.empty(len(motor.electromagnets))
    for number, field in enumerate(motor.sensor_field(R, "table")):
        torque_map.torque(field, np.ones(motor.sensors), out[number], known)
        assert known.all()
    return out


def test_two_networks_serve_all_coils_with_at_most_27_inputs(pmsm):
    found = neighbourhoods(pmsm)
    assert sorted(np.concatenate([near.coils for near in found]).tolist()) == list(range(24))
    assert [near.sensors.shape for near in found] == [(16, 6), (8, 9)]


def test_coils_that_share_a_network_see_and_feel_the_same_when_the_rotor_is_turned_along(pmsm):
    R = random_orientations(5, 1)
    for near in neighbourhoods(pmsm):
        for member in range(1, len(near.coils)):
            along = near.frames[member] @ near.frames[0].T  # takes the first coil's surroundings to this one's
            turned = along @ R
            for method, of in ((near.inputs, pmsm.sensor_field), (near.outputs, pmsm.torque_characteristic)):
                here, there = method(of(R, "table"), 0), method(of(turned, "table"), member)
                np.testing.assert_allclose(there, here, atol=1e-9 * np.abs(here).max() + 1e-12)


def test_a_coil_without_sensors_is_an_error(pmsm):
    few = Layout(pmsm.sensor_layout.distance, pmsm.sensor_layout.directions[:4])
    with pytest.raises(InputError, match="has no sensor within 35°"):
        neighbourhoods(replace(pmsm, sensor_layout=few))


def test_kernel_equals_the_networks_it_was_folded_from(pmsm, networks, maps):
    R = random_orientations(20, 2)
    found = ask(maps["network"], pmsm, R)
    field = pmsm.sensor_field(R, "table")
    for near, network in zip(neighbourhoods(pmsm), networks.networks, strict=True):
        for member in range(len(near.coils)):
            np.testing.assert_allclose(
                near.outputs(found, member), network(near.inputs(field, member)), rtol=1e-9, atol=1e-12
            )
    axial = np.einsum("nij,ji->nj", found, pmsm.electromagnets.directions)
    assert np.abs(axial).max() < 1e-12  # no torque about a coil's own axis


def test_tanh_of_many_numbers_at_once():
    x = np.concatenate([np.linspace(-25, 25, 20_001), np.linspace(-1e-3, 1e-3, 101), [-np.inf, np.inf, np.nan]])
    found = x.copy()
    squash(found)
    np.testing.assert_allclose(found, np.tanh(x), rtol=0, atol=5e-16)


@pytest.mark.parametrize(("name", "least", "most"), [("network", 0.0, 0.08), ("linear", 0.05, 0.12)])
def test_error_over_the_workspace(pmsm, maps, name, least, most):
    R = random_orientations(300, 3)
    true = pmsm.torque_characteristic(R, "table")
    error = np.sqrt(((ask(maps[name], pmsm, R) - true) ** 2).mean() / (true**2).mean())
    assert least < error < most


@pytest.mark.parametrize("name", ["network", "linear"])
def test_by_itself_it_says_that_orientation_is_not_estimated(pmsm, maps, name):
    estimator = FieldToTorque(pmsm, maps[name])
    R = random_orientations(1, 4)[0]
    currents = 0.5 * np.cos(np.arange(12.0))
    estimate, at_rest = estimator.update(sample(pmsm, R, currents=currents)), estimator.update(sample(pmsm, R))
    assert estimate.valid
    assert not estimate.oriented
    assert np.isnan(estimate.state.R_SR).all()
    assert np.isnan(estimate.state.w).all()
    np.testing.assert_allclose(estimate.wrench_map.matrix, at_rest.wrench_map.matrix, atol=1e-9)  # coil field is out
    assert not estimate.wrench_map.matrix[:3].any()


@pytest.mark.parametrize(
    ("wrong", "beside"), [(np.nan, False), (0.65, False), (np.nan, True), (0.65, True), (0.0, True), (-0.1, True)]
)
def test_channels_near_a_broken_sensor_rest_and_the_others_work(pmsm, maps, wrong, beside):
    estimator = FieldToTorque(pmsm, maps["network"], LeastSquaresOrientation(pmsm) if beside else None)
    R = random_orientations(1, 5)[0]
    whole = estimator.update(sample(pmsm, R)).wrench_map.torque.copy()
    broken = sample(pmsm, R)
    broken.field[32] = wrong  # the sensor on the axis of EM17, seen by five coils
    estimate = estimator.update(broken)
    resting = ~estimate.wrench_map.torque.any(axis=0)
    assert estimate.valid
    assert estimate.disbelieved == 1
    assert resting[np.flatnonzero(pmsm.groups[16])].all()
    assert 1 <= np.count_nonzero(resting) <= 6
    np.testing.assert_array_equal(estimate.wrench_map.torque[:, ~resting], whole[:, ~resting])


def test_the_linear_map_replaces_a_broken_sensor_by_what_the_others_say(pmsm, maps):
    estimator = FieldToTorque(pmsm, maps["linear"])
    R = random_orientations(200, 6)
    true = pmsm.torque_characteristic(R, "table") @ pmsm.groups
    errors = {}
    for broken in (None, 20):
        found = np.empty_like(true)
        for number, turn in enumerate(R):
            read = sample(pmsm, turn)
            if broken is not None:
                read.field[broken] = np.nan
            estimate = estimator.update(read)
            assert estimate.valid
            found[number] = estimate.wrench_map.torque
        errors[broken] = np.sqrt(((found - true) ** 2).mean() / (true**2).mean())
    assert errors[20] < 1.2 * errors[None]


@pytest.mark.parametrize("name", ["network", "linear"])
@pytest.mark.parametrize("value", [np.nan, 0.65], ids=str)
def test_without_sensors_nothing_is_valid(pmsm, maps, name, value):
    blind = replace(sample(pmsm, np.eye(3)), field=np.full((48, 3), value))
    estimate = FieldToTorque(pmsm, maps[name]).update(blind)
    assert not estimate.valid
    assert not estimate.wrench_map.matrix.any()


@pytest.mark.parametrize("name", ["network", "linear"])
def test_beside_least_squares_it_has_an_orientation_and_knows_the_edge_of_what_it_learnt(pmsm, maps, name):
    estimator = FieldToTorque(pmsm, maps[name], LeastSquaresOrientation(pmsm))
    inside = rotation_from_euler(0.3, -0.3, 0.2)
    estimate = estimator.update(sample(pmsm, inside))
    assert estimate.valid
    assert estimate.oriented
    np.testing.assert_allclose(estimate.state.R_SR, inside, atol=1e-6)
    assert estimate.wrench_map.passive.any()
    outside = estimator.update(sample(pmsm, rotation_from_euler(0.0, 0.45, 0.2), 1.0))
    assert outside.oriented
    assert not outside.valid


def test_estimators_are_found_by_name(pmsm, networks, tmp_path):
    path = tmp_path / "pmsm.network"
    write_networks(networks, path)
    for name in FIELD_ESTIMATORS:
        assert field_estimator(name, pmsm, path).update(sample(pmsm, np.eye(3))).valid
    with pytest.raises(UnknownName, match="did you mean 'network'"):
        field_estimator("netwrk", pmsm)


def test_a_network_file_tells_the_same_again(pmsm, networks, maps, tmp_path):
    path = tmp_path / "folder" / "pmsm.network"
    write_networks(networks, path)
    again = read_networks(path)
    assert (again.device, again.digest, again.reach) == (networks.device, networks.digest, networks.reach)
    assert again.record == networks.record
    R = random_orientations(3, 7)
    np.testing.assert_array_equal(ask(NetworkTorque(pmsm, again), pmsm, R), ask(maps["network"], pmsm, R))
    assert list(path.parent.iterdir()) == [path]  # nothing half written is left


def test_networks_of_another_device_are_refused(networks):
    other = haptorb.load("pmsm-in-phase")
    with pytest.raises(InputError, match=r"trained for device 'pmsm'.*haptorb train pmsm-in-phase"):
        NetworkTorque(other, networks)


@pytest.mark.parametrize("damage", ["cut", "bit", "head", "empty", "text", "absent"])
def test_a_damaged_network_file_is_refused(networks, tmp_path, damage):
    path = tmp_path / "pmsm.network"
    write_networks(networks, path)
    whole = bytearray(path.read_bytes())
    if damage == "cut":
        path.write_bytes(whole[:-100])
    elif damage == "bit":
        whole[-9] ^= 1
        path.write_bytes(whole)
    elif damage == "head":
        path.write_bytes(whole.replace(b'"reach": 0.6', b'"reach": 0.7', 1))
    elif damage == "empty":
        path.write_bytes(b"")
    elif damage == "text":
        path.write_text("[1, 2]\n")
    else:
        path.unlink()
    with pytest.raises(InputError, match=r"haptorb train|train again"):
        read_networks(path)


def test_a_file_that_cannot_be_written_is_an_error_and_changes_nothing(networks, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("mine")
    with pytest.raises(InputError, match="cannot be written"):
        write_networks(networks, blocked / "pmsm.network")
    assert blocked.read_text() == "mine"


def test_the_place_of_a_devices_networks_is_its_own(pmsm):
    assert networks_path(pmsm) != networks_path(haptorb.load("pmsm-in-phase"))


@pytest.mark.parametrize(
    ("grid", "nodes"), [((1, 1, 1), 10), ((2, 1, 10), 10), ((0, 3, 3), 10), ((1, 1, 400), 200), ((3, 3, 12), 10)]
)
def test_degenerate_training_sets_are_refused(pmsm, grid, nodes):
    with pytest.raises(InputError, match=r"grid|samples"):
        train(pmsm, starts=1, iterations=5, grid=grid, nodes=nodes)


def test_a_linear_map_needs_orientations_that_differ(pmsm):
    with pytest.raises(InputError, match="need at least 288 orientations"):
        LinearTorque(pmsm, orientations=workspace_grid(pmsm, (2, 2, 3)))
    with pytest.raises(InputError, match="do not change"):
        LinearTorque(pmsm, orientations=np.repeat(np.eye(3)[None], 300, axis=0))
    with pytest.raises(InputError, match="noise"):
        LinearTorque(pmsm, noise=-1.0)
