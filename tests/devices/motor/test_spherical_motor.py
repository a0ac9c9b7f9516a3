"""The PMSM: published and independent numbers, symmetries, models against each other, and variants."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import haptorb
from haptorb.devices.base import State
from haptorb.devices.motor import workspace_sample
from haptorb.errors import DeviceError, InputError, UnknownName
from haptorb.rotations import rotation_from_euler

TILTED = rotation_from_euler(*np.radians((10.0, 5.0, 5.0)))

#: K at TILTED from an independent computation, converged to 1e-9 N·m/A: number of the coil → components
INDEPENDENT = {
    17: (0.0, -0.188419, 0.026007),
    1: (0.072417, 0.031309, 0.161740),
    9: (0.076864, -0.036335, -0.117090),
}


@pytest.fixture(scope="module")
def pmsm():
    return haptorb.load("pmsm")


def random_rotations(count, seed, tilt=np.radians(22.5)):
    rng = np.random.default_rng(seed)
    return rotation_from_euler(*rng.uniform(-tilt, tilt, (2, count)), rng.uniform(0, 2 * np.pi, count))


@pytest.fixture(scope="module")
def tilted(pmsm):
    """Level → K (3, 24) at TILTED; the exact model takes seconds."""
    return {model: haptorb.torque_characteristic(pmsm, TILTED, model=model) for model in pmsm.models}


@pytest.mark.parametrize("model", ["table", "exact"])
def test_torque_characteristic_is_that_of_an_independent_computation(tilted, model):
    K = tilted[model]
    assert K.shape == (3, 24)
    for coil, expected in INDEPENDENT.items():
        np.testing.assert_allclose(K[:, coil - 1], expected, atol=1e-6)


def test_peaks_on_the_trajectory_of_figure_4(pmsm):
    t = np.linspace(0, 2 * np.pi, 721)
    R = rotation_from_euler(np.radians(10) * np.sin(t), np.radians(5) * np.sin(t), np.radians(5))
    peaks = np.abs(haptorb.torque_characteristic(pmsm, R)[:, :, 16]).max(axis=0)
    np.testing.assert_allclose(peaks, [0, 0.21063, 0.02601], atol=1e-5)


def test_table_equals_exact(pmsm, tilted):
    assert np.abs(tilted["table"] - tilted["exact"]).max() < 1e-7 * np.abs(tilted["exact"]).max()
    R = random_rotations(40, 2)
    table, exact = (haptorb.sensor_field(pmsm, R, model=model) for model in ("table", "exact"))
    assert table.shape == (40, 48, 3)
    assert np.abs(table - exact).max() < 1e-6 * np.abs(exact).max()


def test_published_multipole_model_against_exact(pmsm):
    R = random_rotations(40, 3)
    exact, model = (haptorb.torque_characteristic(pmsm, R, model=model) for model in ("table", "published"))
    scale = (exact * model).sum() / (exact**2).sum()
    shape = np.sqrt(((model - scale * exact) ** 2).mean()) / np.abs(exact).max()
    assert 1.03 < scale < 1.06  # about +4 %
    assert shape < 0.013  # of the greatest torque


def test_other_lengths_of_the_coils_disagree_with_the_published_model_by_a_quarter():
    R = random_rotations(20, 4)
    device = haptorb.load("pmsm-thick-coils", override=True)
    exact, model = (haptorb.torque_characteristic(device, R, model=model) for model in ("table", "published"))
    scale = (exact * model).sum() / (exact**2).sum()
    assert abs(scale - 1) > 0.2


def test_dipoles_are_the_right_order_of_magnitude_and_no_better(pmsm):
    R = random_rotations(20, 5)
    exact, far = (haptorb.torque_characteristic(pmsm, R, model=model) for model in ("table", "dipole"))
    cosine = (exact * far).sum() / np.linalg.norm(exact) / np.linalg.norm(far)
    assert 0.4 < cosine < 0.9


@pytest.mark.parametrize("model", ["table", "dipole", "published"])
@given(psi=st.floats(-0.39, 0.39), lam=st.floats(-0.39, 0.39), phi=st.floats(0, 6.28))
@settings(max_examples=8, deadline=None)
def test_spin_by_60_degrees_changes_nothing_and_by_30_the_sign(pmsm, model, psi, lam, phi):
    here, by_60, by_30 = (
        haptorb.torque_characteristic(pmsm, rotation_from_euler(psi, lam, phi + np.radians(turn)), model=model)
        for turn in (0, 60, 30)
    )
    # a published multipole loop has ten dipoles: it is not quite round, and 30° does not map it onto itself
    tolerance = 2e-3 if model == "published" else 1e-9
    np.testing.assert_allclose(by_60, here, atol=tolerance)
    np.testing.assert_allclose(by_30, -here, atol=tolerance)


@given(psi=st.floats(-0.39, 0.39), lam=st.floats(-0.39, 0.39), phi=st.floats(0, 6.28))
@settings(max_examples=25, deadline=None)
def test_field_at_the_sensors_has_the_same_periods(pmsm, psi, lam, phi):
    here, by_60, by_30 = (
        haptorb.sensor_field(pmsm, rotation_from_euler(psi, lam, phi + np.radians(turn))) for turn in (0, 60, 30)
    )
    np.testing.assert_allclose(by_60, here, atol=1e-9)
    np.testing.assert_allclose(by_30, -here, atol=1e-9)


@pytest.mark.parametrize("model", ["table", "exact", "dipole", "published"])
def test_no_torque_about_a_coils_own_axis(pmsm, tilted, model):
    own = np.einsum("ij,ji->j", tilted[model], pmsm.electromagnets.directions)
    # coils of sixteen dipoles a loop are not quite round
    assert np.abs(own).max() < (1e-3 if model == "published" else 1e-9)


def test_torque_is_the_slope_of_flux_linkage(pmsm):
    """Virtual work by finite differences of the coils' flux in the magnets' field, a different integral."""
    from haptorb.magnetics.source import PlacedSource
    from oracles.magnetics.formulations import flux_linkage
    from oracles.magnetics.source_sum import SourceSum

    coil = 16
    frame = pmsm.electromagnets.frames[coil]
    step = 1e-4

    def flux(psi):
        R = rotation_from_euler(psi, np.radians(5), np.radians(5))
        near = np.argsort(-(pmsm.magnets.directions @ R.T) @ frame[:, 2])
        magnets = [
            PlacedSource(pmsm.magnet, R @ pmsm.magnets.positions[i], R @ pmsm.magnets.frames[i]) for i in range(24)
        ]
        total = 0.0
        for i in near:
            linked = flux_linkage(
                SourceSum([magnets[i]]), pmsm.electromagnet, pmsm.electromagnets.positions[coil], frame, precision=1e-6
            )
            total += pmsm.polarity[i] * linked.value[0]
        return total

    slope = (flux(np.radians(10) + step) - flux(np.radians(10) - step)) / (2 * step)
    K = haptorb.torque_characteristic(pmsm, TILTED)[:, coil]
    # turning by ψ is turning about X
    assert slope == pytest.approx(K[0], abs=2e-5)


def test_grouped_characteristic_is_better_conditioned_than_in_phase(pmsm):
    R = workspace_sample(pmsm.workspace_tilt, 7, 36)
    least = [
        np.linalg.svd(haptorb.torque_characteristic(device, R, grouped=True), compute_uv=False)[:, 2].min()
        for device in (pmsm, haptorb.load("pmsm-in-phase"))
    ]
    assert least[0] / least[1] == pytest.approx(1.6, abs=0.1)


def test_groups_are_pairs_in_series(pmsm):
    single = haptorb.torque_characteristic(pmsm, TILTED)
    grouped = haptorb.torque_characteristic(pmsm, TILTED, grouped=True)
    assert grouped.shape == (3, 12)
    np.testing.assert_allclose(grouped[:, 0], single[:, 0] - single[:, 12], atol=1e-15)
    np.testing.assert_allclose(grouped[:, 0], 2 * single[:, 0], atol=1e-9)  # both do the same


def test_wrench_map_is_torque_per_channel_and_the_bearing_carries_force(pmsm):
    wrench_map = pmsm.wrench_map(State.from_rotation(TILTED), "table")
    np.testing.assert_array_equal(wrench_map.matrix[3:], haptorb.torque_characteristic(pmsm, TILTED, grouped=True))
    assert not wrench_map.force.any()
    assert wrench_map.passive.shape == (6,)


def test_batches_and_single_orientations_agree(pmsm):
    R = random_rotations(5, 6)
    for door in (haptorb.torque_characteristic, haptorb.sensor_field):
        batch = door(pmsm, R)
        for number in range(5):
            np.testing.assert_array_equal(door(pmsm, R[number]), batch[number])


def test_field_is_that_of_the_sensors_and_currents_add(pmsm):
    at = pmsm.hall.positions
    magnets = haptorb.field(pmsm, TILTED, at)
    np.testing.assert_allclose(magnets, haptorb.sensor_field(pmsm, TILTED, model="exact"), atol=1e-12)
    currents = np.zeros(12)
    currents[8] = 0.5  # EM 17 and 21, the second wound the other way: on the X axis both push along +X
    with_coils = haptorb.field(pmsm, TILTED, at, currents) - magnets
    assert with_coils[32, 0] > 1e-3
    np.testing.assert_allclose(with_coils[40], with_coils[32] * [1, -1, -1], atol=1e-12)


def test_the_regulator_takes_most_of_the_weight_over_the_workspace(pmsm):
    for tilt in np.radians((1.0, 10.0, 20.0)):
        leaning = rotation_from_euler(tilt, 0.0, 0.3)
        bare = replace(pmsm, regulator=None).passive(leaning)
        held = pmsm.passive(leaning)
        assert bare[3] > 0.15 * np.sin(tilt)  # gravity tilts it further
        assert abs(held[3]) < 0.2 * bare[3]
        weight = pmsm.rotor.mass * 9.80665 * pmsm.rotor.centre_of_mass
        assert bare[3] == pytest.approx(weight * np.sin(tilt), rel=1e-12)
        exact = pmsm.regulator.torque(tilt)
        assert bare[3] - held[3] == pytest.approx(exact, rel=1e-5)


def test_upright_nothing_pulls(pmsm):
    np.testing.assert_allclose(pmsm.passive(np.eye(3)), 0, atol=1e-15)


def test_winding_follows_from_turns_section_and_fill(pmsm):
    section = 7.62e-3 * (15.88e-3 - 4.764e-3)
    mean = np.pi * (15.88e-3 + 4.764e-3)
    expected = 2 * 1.7241e-8 * mean * 1000**2 / (0.58 * section)
    np.testing.assert_allclose(pmsm.coils.resistance, expected, rtol=1e-12)
    assert pmsm.coils.resistance.shape == (12,)
    assert 5e-3 < pmsm.coils.inductance[0] < 5e-2
    assert pmsm.supply.voltage > pmsm.coils.current_limit[0] * pmsm.coils.resistance[0]


def test_everything_the_paper_does_not_give_is_marked(pmsm):
    for key in ("rotor.mass", "rotor.inertia", "rotor.viscous_friction", "electromagnets.fill", "supply.voltage"):
        assert len(pmsm.assumed[key]) > 10
    assert "coils.current_limit" in pmsm.assumed
    assert "regulator.stator.outer_radius" in pmsm.assumed
    assert "magnets.distance" not in pmsm.assumed


@pytest.mark.parametrize(
    "bad",
    [np.full((3, 3), np.nan), 2 * np.eye(3), np.diag([1.0, 1.0, -1.0]), np.eye(4), np.zeros((2, 3)), "north"],
)
def test_what_is_not_a_rotation_is_refused(pmsm, bad):
    for door in (haptorb.torque_characteristic, haptorb.sensor_field):
        with pytest.raises(InputError, match="R_SR"):
            door(pmsm, bad)


def test_other_doors_are_checked(pmsm):
    with pytest.raises(UnknownName, match="did you mean 'table'"):
        haptorb.torque_characteristic(pmsm, np.eye(3), model="tabel")
    with pytest.raises(UnknownName):
        haptorb.sensor_field(pmsm, np.eye(3), model="fem")
    with pytest.raises(InputError, match="works for spherical motors"):
        haptorb.torque_characteristic("omni", np.eye(3))
    with pytest.raises(InputError, match=r"points must have shape \(p, 3\)"):
        haptorb.field(pmsm, np.eye(3), (0.0, 0, 0))
    with pytest.raises(InputError, match="one per channel"):
        haptorb.field(pmsm, np.eye(3), [[0.0, 0, 0]], currents=[1.0])
    with pytest.raises(InputError, match="finite"):
        haptorb.field(pmsm, np.eye(3), [[np.nan, 0, 0]])


def test_the_multipole_level_needs_its_model(pmsm):
    with pytest.raises(DeviceError, match=r"magnets\.multipole"):
        haptorb.torque_characteristic(replace(pmsm, magnet_model=None), np.eye(3), model="published")
