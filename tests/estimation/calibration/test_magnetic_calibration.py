"""Magnetic calibration identifies the parameters, and names wiring mistakes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from haptorb.devices.loader import load
from haptorb.errors import CalibrationError, InputError
from haptorb.estimation.coil_calibration import excitation, magnetic_calibration
from oracles import wound_coils

OMNI = load("omni")


def measure(M, noise=0.0, seed=0, **schedule):
    """What the sensors read on a device whose moments per ampere are M, with `noise` as a share of the rms signal."""
    rng = np.random.default_rng(seed)
    currents = excitation(OMNI, **schedule)
    fields = np.einsum("sim,nm->nsi", wound_coils.coil_fields(OMNI, OMNI.hall.positions, M), currents)
    rms = np.sqrt((fields[np.abs(currents).sum(axis=1) > 0] ** 2).mean())
    offsets = 1e-4 * rng.normal(size=(1, *fields.shape[1:]))
    return currents, fields + offsets + noise * rms * rng.normal(size=fields.shape), offsets[0]


def test_without_noise_it_is_as_exact_as_the_fields():
    M = OMNI.moment_per_current * 1.07
    currents, fields, offsets = measure(M)
    found = magnetic_calibration(OMNI, currents, currents, fields)
    assert np.allclose(found.moment_per_current, M, rtol=0, atol=2e-5)
    assert np.allclose(found.offsets, offsets, atol=1e-12)
    assert found.condition < 10


def test_one_percent_of_noise_leaves_three_permille():
    for seed in range(10):
        M = OMNI.moment_per_current @ (np.eye(3) + 0.05 * np.random.default_rng(seed).normal(size=(3, 3)))
        currents, fields, _ = measure(M, 0.01, seed)
        found = magnetic_calibration(OMNI, currents, currents, fields)
        error = np.abs(found.moment_per_current - M) / np.linalg.norm(M, axis=0)
        assert error.max() < 0.003
        assert (np.abs(found.moment_per_current - M) < 5 * found.uncertainty).all()
        assert found.repeatability < 0.006


@pytest.mark.parametrize("degrees", [2.0, -2.0])
def test_two_degrees_of_skew_are_found_to_a_tenth(degrees):
    M = np.diag([0.2, 0.2, 0.2])
    M[:, 1] = Rotation.from_euler("z", degrees, degrees=True).apply(M[:, 1])  # away from (towards) coil x
    for seed in range(5):
        currents, fields, _ = measure(M, 0.01, seed)
        skew = magnetic_calibration(OMNI, currents, currents, fields).skew(("x", "y", "z"))
        assert np.degrees(skew["x", "y"]) == pytest.approx(degrees, abs=0.1)
        assert np.degrees(skew["x", "z"]) == pytest.approx(0, abs=0.1)


def refusal(wanted, currents, fields):
    with pytest.raises(CalibrationError) as failure:
        magnetic_calibration(OMNI, wanted, currents, fields)
    return str(failure.value)


def test_an_unplugged_coil_is_named():
    M = OMNI.moment_per_current
    wanted, _, _ = measure(M)
    currents = wanted.copy()
    currents[:, 1] = 0.0
    fields = np.einsum("sim,nm->nsi", wound_coils.coil_fields(OMNI, OMNI.hall.positions, M), currents)
    assert "coil 'y'" in refusal(wanted, currents, fields)
    assert "unplugged" in refusal(wanted, currents, fields)


def test_a_coil_that_does_not_switch_is_named():
    wanted, fields, _ = measure(OMNI.moment_per_current)
    for flowing, message in (
        (np.full(len(wanted), 4.0), "coil 'y' carries 4 A where 0 A should flow: it does not switch"),
        (np.maximum(wanted[:, 1], 0.0), "coil 'y' carries 0 A instead of -3 A: the coil is unplugged"),
    ):
        currents = wanted.copy()
        currents[:, 1] = flowing
        assert message in refusal(wanted, currents, fields)


def test_swapped_coils_are_named():
    currents, fields, _ = measure(OMNI.moment_per_current[:, [0, 2, 1]])
    message = refusal(currents, currents, fields)
    assert "coil 'y' produces the moment of coil 'z'" in message
    assert "swap" in message


def test_a_reversed_coil_is_named():
    M = OMNI.moment_per_current.copy()
    M[:, 2] *= -1
    currents, fields, _ = measure(M)
    assert "coil 'z' produces a reversed moment" in refusal(currents, currents, fields)


def test_a_sensor_that_does_not_follow_is_named():
    currents, fields, _ = measure(OMNI.moment_per_current, 0.002)
    fields[:, 4] = -fields[:, 4]
    assert "field sensor 5 of 9" in refusal(currents, currents, fields)


def test_a_dead_sensor_is_named_and_the_rest_is_used():
    currents, fields, _ = measure(OMNI.moment_per_current, 0.002)
    whole = magnetic_calibration(OMNI, currents, currents, fields)
    fields[:, 4] = 1e-4
    found = magnetic_calibration(OMNI, currents, currents, fields)
    assert found.failed == (4,)
    assert whole.failed == ()
    assert np.abs(found.moment_per_current - OMNI.moment_per_current).max() < 5e-4
    fields[:, :3] = 0.0
    assert "field sensors 1, 2, 3, 5 of 9" in refusal(currents, currents, fields)


def test_a_schedule_that_excites_nothing_is_refused():
    currents, fields, _ = measure(OMNI.moment_per_current)
    with pytest.raises(InputError, match="never excited"):
        magnetic_calibration(OMNI, currents * (1, 1, 0), currents * (1, 1, 0), fields)
    together = np.outer(np.linspace(-3, 3, len(currents)), np.ones(3))
    with pytest.raises(InputError, match="separately"):
        magnetic_calibration(OMNI, together, together, fields)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2), st.integers(0, 100))
def test_readings_that_are_no_numbers_are_refused(axis, row):
    currents, fields, _ = measure(OMNI.moment_per_current, levels=3, repeats=3)
    fields[row % len(fields), 0, axis] = np.nan
    with pytest.raises(InputError, match="finite"):
        magnetic_calibration(OMNI, currents, currents, fields)


def test_shapes_are_told():
    with pytest.raises(InputError, match="needs currents"):
        magnetic_calibration(OMNI, np.zeros((4, 3)), np.zeros((4, 3)), np.zeros((4, 8, 3)))


def test_it_is_applied_to_the_device():
    M = OMNI.moment_per_current * 0.9
    currents, fields, _ = measure(M)
    device = magnetic_calibration(OMNI, currents, currents, fields).apply(OMNI)
    assert np.allclose(device.moment_per_current, M, rtol=0, atol=2e-5)
    assert replace(device, moment_per_current=OMNI.moment_per_current).name == OMNI.name
