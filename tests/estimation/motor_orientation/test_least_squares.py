"""Orientation by least squares: exact without noise; consistent uncertainty, spin and faulty sensors."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import haptorb
from haptorb.control.protection import Protection
from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.errors import InputError
from haptorb.estimation.motor_orientation import LeastSquaresOrientation, nearest_branch, spin_period
from haptorb.estimation.types import Pose, Sample
from haptorb.rotations import rotation_from_euler
from oracles.repetitions import repetitions

TILT = np.radians(22.5)
NOBODY = Pose(0.0, np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3), False)


@pytest.fixture(scope="module")
def pmsm():
    return haptorb.load("pmsm")


@pytest.fixture(scope="module")
def shared(pmsm):
    """One estimator for tests that begin with a pause, after which it searches anew where it must."""
    return LeastSquaresOrientation(pmsm)


def sample(motor, R, t=0.0, noise=0.0, rng=None, currents=None, strength=1.0):
    flowing = np.zeros(motor.channels) if currents is None else np.asarray(currents, dtype=float)
    field = strength * motor.sensor_field(R[None], "table")[0]
    if currents is not None:
        field = field + motor.coil_field(motor.sensor_layout.positions, flowing)
    if noise:
        field = field + noise * rng.standard_normal(field.shape)
    return Sample(t, flowing, np.full(motor.channels, 293.0), field, NOBODY)


def forget(estimator, motor):
    """Nothing is read: with the next sample it searches anew, from nowhere."""
    assert not estimator.update(replace(sample(motor, np.eye(3)), field=np.full((48, 3), np.nan))).valid


def angle(A, B):
    """[°] between two orientations."""
    M = A @ B.T
    v = 0.5 * np.array([M[2, 1] - M[1, 2], M[0, 2] - M[2, 0], M[1, 0] - M[0, 1]])
    return float(np.degrees(np.arctan2(np.linalg.norm(v), 0.5 * (np.trace(M) - 1))))


def but_for_spin(motor, found, true):
    """[°] between them on the branch that suits best."""
    return angle(nearest_branch(found, true, spin_period(motor)), true)


def random_orientations(count, seed):
    rng = np.random.default_rng(seed)
    psi, lam = rng.uniform(-TILT, TILT, (2, count))
    return rotation_from_euler(psi, lam, rng.uniform(-np.pi, np.pi, count))


def relative_error(motor, estimate, R, strength=1.0):
    K = strength * motor.torque_characteristic(R[None], "table")[0] @ motor.groups
    return float(np.abs(estimate.wrench_map.torque - K).max() / np.abs(K).max())


tilts = st.floats(-TILT, TILT)


@settings(max_examples=repetitions(20, 60))
@given(psi=tilts, lam=tilts, phi=st.floats(-np.pi, np.pi), amperes=st.floats(-1, 1), strength=st.floats(0.9, 1.1))
def test_without_noise_it_is_exact_whatever_flows_and_however_strong_the_magnets(
    pmsm, shared, psi, lam, phi, amperes, strength
):
    R = rotation_from_euler(psi, lam, phi)
    currents = amperes * np.cos(np.arange(pmsm.channels))
    forget(shared, pmsm)
    estimate = shared.update(sample(pmsm, R, currents=currents, strength=strength))
    assert estimate.valid
    assert but_for_spin(pmsm, estimate.state.R_SR, R) < 0.005
    assert relative_error(pmsm, estimate, R, strength) < 1e-4
    assert estimate.strength == pytest.approx(strength, abs=1e-6)
    assert estimate.age == 0.0


def test_cold_start_finds_every_one_of_1000_orientations(pmsm):
    estimator = LeastSquaresOrientation(pmsm)
    worst = 0.0
    for number, R in enumerate(random_orientations(1000, 5)):
        estimate = estimator.update(sample(pmsm, R, t=10.0 * number))
        assert estimate.valid
        worst = max(worst, but_for_spin(pmsm, estimate.state.R_SR, R))
    assert worst < 0.005


def test_with_a_tenth_of_a_millitesla_of_noise(pmsm):
    estimator, rng = LeastSquaresOrientation(pmsm), np.random.default_rng(1)
    gaps, errors, stated, actual = [], [], [], []
    for n in range(1500):
        x = 6e-3 * n
        R = rotation_from_euler(0.17 * np.sin(x), 0.09 * np.sin(x), 0.1 + 0.3 * np.sin(2 * x))
        estimate = estimator.update(sample(pmsm, R, 1e-3 * n, 1e-4, rng))
        gaps.append(angle(estimate.state.R_SR, R))
        errors.append(relative_error(pmsm, estimate, R))
        stated.append(np.trace(estimate.covariance))
        actual.append(np.radians(gaps[-1]) ** 2)
    assert np.sqrt(np.mean(np.square(gaps))) < 0.02
    assert np.percentile(gaps, 99) < 0.02
    assert np.sqrt(np.mean(np.square(errors))) < 5e-4
    assert np.sqrt(np.mean(stated) / np.mean(actual)) == pytest.approx(1.0, abs=0.1)  # it knows its own error


def test_magnets_that_are_two_per_cent_off_change_the_torque_per_ampere_not_the_orientation(pmsm):
    R = random_orientations(1, 3)[0]
    estimate = LeastSquaresOrientation(pmsm).update(sample(pmsm, R, strength=0.98))
    assert estimate.strength == pytest.approx(0.98, abs=1e-6)
    assert relative_error(pmsm, estimate, R, 0.98) < 1e-4


def test_spin_is_followed_through_its_period_and_the_period_is_stated(pmsm):
    estimator = LeastSquaresOrientation(pmsm)
    for n in range(1500):
        phi = 2e-3 * n  # three radians: almost half a turn, three periods
        R = rotation_from_euler(0.1, -0.05, phi)
        estimate = estimator.update(sample(pmsm, R, 1e-3 * n))
        assert angle(estimate.state.R_SR, R) < 0.005
    assert np.degrees(estimate.spin_period) == pytest.approx(60.0)


@pytest.mark.parametrize("branch", range(6))
def test_the_branch_of_spin_is_the_one_nearest_to_the_start_and_to_what_was_believed_last(pmsm, branch):
    R = rotation_from_euler(0.2, 0.1, 0.05 + branch * np.pi / 3)
    estimator = LeastSquaresOrientation(pmsm, start=rotation_from_euler(0, 0, 0.2 + branch * np.pi / 3))
    assert angle(estimator.update(sample(pmsm, R)).state.R_SR, R) < 0.005
    blind = replace(sample(pmsm, R, 0.001), field=np.zeros((48, 3)))
    assert not estimator.update(blind).valid
    further = rotation_from_euler(0.1, 0.15, 0.25 + branch * np.pi / 3)
    assert angle(estimator.update(sample(pmsm, further, 3.0)).state.R_SR, further) < 0.005


@pytest.mark.parametrize("wrong", [0.0, np.nan, np.inf, 0.65, -0.3, 0.1], ids=str)
@pytest.mark.parametrize("cold", [True, False], ids=["cold", "warm"])
def test_one_broken_sensor_is_left_out_whatever_it_says(pmsm, shared, wrong, cold):
    rng = np.random.default_rng(2)
    for k, R in zip(range(0, 48, 5), random_orientations(10, 4), strict=True):
        forget(shared, pmsm)
        if not cold:
            shared.update(sample(pmsm, R))
        broken = sample(pmsm, R, 1e-3, 5e-5, rng)
        broken.field[k] = wrong
        estimate = shared.update(broken)
        assert estimate.valid
        near = np.linalg.norm(pmsm.sensor_field(R[None], "table")[0, k] - wrong) < 5e-3  # it may be right by chance
        assert estimate.disbelieved == 1 or near
        assert but_for_spin(pmsm, estimate.state.R_SR, R) < 0.01


def test_between_four_magnets_a_reading_of_zero_is_true(pmsm):
    upright = sample(pmsm, np.eye(3))
    assert (np.linalg.norm(upright.field, axis=1) < 1e-9).any()
    assert LeastSquaresOrientation(pmsm).update(upright).disbelieved == 0


def test_a_dozen_broken_sensors_are_left_out_while_it_tracks(pmsm):
    rng = np.random.default_rng(6)
    R = random_orientations(1, 8)[0]
    estimator = LeastSquaresOrientation(pmsm)
    estimator.update(sample(pmsm, R))
    broken = sample(pmsm, R, 1e-3, 5e-5, rng)
    broken.field[::4] = rng.uniform(-0.3, 0.3, (12, 3))
    estimate = estimator.update(broken)
    assert estimate.valid
    assert estimate.disbelieved == 12
    assert but_for_spin(pmsm, estimate.state.R_SR, R) < 0.01


def test_a_sensor_that_comes_back_is_believed_again(pmsm):
    R = random_orientations(1, 9)[0]
    estimator = LeastSquaresOrientation(pmsm)
    broken = sample(pmsm, R)
    broken.field[7] += 0.2
    assert estimator.update(broken).disbelieved == 1
    assert estimator.update(sample(pmsm, R, 1e-3)).disbelieved == 0


@pytest.mark.parametrize(
    "spoil",
    [
        lambda field: np.zeros_like(field),
        lambda field: np.full_like(field, np.nan),
        lambda field: np.full_like(field, 0.6),
        lambda field: field * (np.arange(48) < 3)[:, None],
        lambda field: field[::-1].copy(),
        lambda field: np.random.default_rng(0).uniform(-0.2, 0.2, field.shape),
        lambda field: field + 0.03,
    ],
    ids=["dead", "nan", "saturated", "three left", "wired in reverse", "noise", "a foreign magnet"],
)
def test_what_no_orientation_explains_is_not_valid_and_the_guard_trips(pmsm, spoil):
    R = random_orientations(1, 11)[0]
    estimator, protection = LeastSquaresOrientation(pmsm), Protection(pmsm, 1e-3)
    good = estimator.update(sample(pmsm, R))
    protection.protect_wrench(np.zeros(6), good, 0.0)
    assert protection.engage()
    spoilt = sample(pmsm, R, 1e-3)
    lost = estimator.update(replace(spoilt, field=spoil(spoilt.field)))
    assert not lost.valid
    assert lost.age == pytest.approx(1e-3)
    assert np.isfinite(lost.wrench_map.matrix).all()
    protection.protect_wrench(np.zeros(6), lost, 1e-3)
    assert protection.guard_state is GuardState.TRIPPED
    assert protection.reason is Trip.POSE_LOST
    again = estimator.update(sample(pmsm, R, 2e-3))
    assert again.valid


def test_before_anything_was_found_it_is_not_valid_and_infinitely_old(pmsm):
    nothing = replace(sample(pmsm, np.eye(3)), field=np.zeros((48, 3)))
    estimate = LeastSquaresOrientation(pmsm).update(nothing)
    assert not estimate.valid
    assert estimate.age == np.inf
    assert not estimate.wrench_map.matrix.any()


def test_currents_that_are_not_numbers_make_it_blind(pmsm):
    good = sample(pmsm, np.eye(3))
    bad = replace(good, currents=np.full(pmsm.channels, np.nan))
    assert not LeastSquaresOrientation(pmsm).update(bad).valid


def test_constant_turning_is_measured_without_error_and_rising_turning_with_the_stated_lag(pmsm):
    lag, dt = 8e-3, 1e-3
    estimator = LeastSquaresOrientation(pmsm, lag=lag)
    for n in range(400):
        estimate = estimator.update(sample(pmsm, rotation_from_euler(0, 0, 3.0 * dt * n), dt * n))
    np.testing.assert_allclose(estimate.state.w, [0, 0, 3.0], atol=1e-3)
    estimator = LeastSquaresOrientation(pmsm, lag=lag)
    rise = 20.0  # [rad/s²]
    for n in range(400):
        t = dt * n
        estimate = estimator.update(sample(pmsm, rotation_from_euler(0, 0, 0.5 * rise * t * t), t))
    late = (rise * t - estimate.state.w[2]) / rise
    assert late == pytest.approx(lag, abs=dt)


def test_time_that_stands_still_runs_back_or_jumps_does_no_harm(pmsm):
    estimator = LeastSquaresOrientation(pmsm)
    R = random_orientations(4, 12)
    for t, turn in zip((5.0, 5.0, 4.0, 60.0), R, strict=True):
        estimate = estimator.update(sample(pmsm, turn, t))
        assert estimate.valid
        assert but_for_spin(pmsm, estimate.state.R_SR, turn) < 0.005
        assert np.isfinite(estimate.state.w).all()


def test_a_rotor_beyond_the_workspace_is_followed(pmsm):
    estimator = LeastSquaresOrientation(pmsm)
    for n in range(300):
        R = rotation_from_euler(np.radians(0.1 * n), 0.0, 0.0)
        estimate = estimator.update(sample(pmsm, R, 1e-3 * n))
    assert estimate.valid
    assert angle(estimate.state.R_SR, R) < 0.005


def test_other_layouts_are_estimated_too():
    motor = haptorb.load("pmsm-in-phase")
    R = random_orientations(1, 13)[0]
    estimate = LeastSquaresOrientation(motor).update(sample(motor, R))
    assert estimate.valid
    assert but_for_spin(motor, estimate.state.R_SR, R) < 0.005


def test_input_that_cannot_be_used_is_refused(pmsm, shared):
    with pytest.raises(InputError, match="48 field sensors"):
        shared.update(replace(sample(pmsm, np.eye(3)), field=np.zeros((9, 3))))
    with pytest.raises(InputError, match="lag"):
        LeastSquaresOrientation(pmsm, lag=0.0)
    with pytest.raises(InputError, match="start"):
        LeastSquaresOrientation(pmsm, start=2 * np.eye(3))
