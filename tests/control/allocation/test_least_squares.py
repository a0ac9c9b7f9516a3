"""Least-squares allocation: force, torque, blends, limits, and reports of unfeasible wrenches."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from haptorb.control.allocation import LeastSquaresAllocator, least_squares_currents
from haptorb.devices.base import WrenchMap
from haptorb.errors import InputError
from haptorb.magnetics import dipole
from oracles.repetitions import repetitions

FORCE = np.array([1.0, 1, 1, 0, 0, 0])
TORQUE = np.array([0.0, 0, 0, 1, 1, 1])
BOTH = np.array([1.0, 1, 1, 20, 20, 20])


def tool_map(axis, at=(0.0, 0.0, 0.05), moment=2.4):
    """A point magnet over three unit moments: the plain Omni."""
    m = moment * np.asarray(axis) / np.linalg.norm(axis)
    units = np.eye(3) * 0.2
    force = np.stack([dipole.force(u, m, at) for u in units], axis=1)
    torque = np.stack([dipole.torque(u, m, at) for u in units], axis=1)
    return WrenchMap(np.vstack([force, torque]), np.zeros(6))


@pytest.mark.parametrize("channels", [1, 2, 3, 5, 6, 7, 12, 24])
@pytest.mark.parametrize("weights", [FORCE, TORQUE, BOTH])
def test_equals_the_pseudo_inverse_when_no_limit_is_met(channels, weights):
    rng = np.random.default_rng(channels)
    allocator = LeastSquaresAllocator(np.full(channels, 1e12), weights)
    for _ in range(50):
        matrix, wrench = rng.normal(size=(6, channels)), rng.normal(size=6)
        reference = np.linalg.pinv(weights[:, None] * matrix, rcond=1e-6) @ (weights * wrench)
        allocation = allocator.allocate(WrenchMap(matrix, np.zeros(6)), wrench)
        np.testing.assert_allclose(allocation.currents, reference, rtol=1e-9, atol=1e-9 * np.abs(reference).max())
        np.testing.assert_allclose(allocation.residual, wrench - matrix @ reference, atol=1e-8)
        assert allocation.scale == 1.0
        assert not allocation.saturated


@pytest.mark.parametrize("channels", [3, 12])
@pytest.mark.parametrize("spread", [1e-2, 1e-4])
def test_keeps_its_accuracy_when_ill_conditioned(channels, spread):
    rng = np.random.default_rng(4)
    allocator = LeastSquaresAllocator(np.full(channels, 1e12))
    for _ in range(100):
        left, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        force = left @ np.diag([1.0, np.sqrt(spread), spread]) @ np.linalg.qr(rng.normal(size=(channels, 3)))[0].T
        wrench_map = WrenchMap(np.vstack([force, np.zeros((3, channels))]), np.zeros(6))
        currents = rng.normal(size=channels)
        wrench = np.r_[force @ currents, 0, 0, 0]
        assert np.abs(allocator.allocate(wrench_map, wrench).residual).max() < 1e-11


def test_a_radial_tool_gets_the_force_that_was_asked():
    allocation = LeastSquaresAllocator.force([20.0] * 3).allocate(tool_map((0, 0, 1)), (0.05, -0.02, 0.1, 0, 0, 0))
    np.testing.assert_allclose(allocation.residual[:3], 0, atol=1e-15)


@given(arrays(float, 3, elements=st.floats(-1, 1)).filter(lambda v: np.linalg.norm(v) > 0.1))
@settings(max_examples=repetitions(20, 60), deadline=None)
def test_torque_over_one_magnet_has_rank_two_and_lacks_that_about_the_magnets_axis(axis):
    wrench_map = tool_map(axis, at=(0.01, -0.02, 0.05))
    allocator = LeastSquaresAllocator.torque([1e6] * 3)
    along = np.asarray(axis) / np.linalg.norm(axis)
    assert np.linalg.matrix_rank(wrench_map.matrix[3:]) == 2
    torque = np.array([0.01, 0.02, -0.03])
    residual = allocator.allocate(wrench_map, np.r_[0, 0, 0, torque]).residual[3:]
    np.testing.assert_allclose(residual, (torque @ along) * along, atol=1e-10)


def test_a_map_without_effect_gets_no_current():
    dead = WrenchMap(np.zeros((6, 3)), np.zeros(6))
    allocator = LeastSquaresAllocator.force([1.0] * 3)
    allocation = allocator.allocate(dead, (1.0, 0, 0, 0, 0, 0))
    assert not allocation.currents.any()
    assert allocation.residual[0] == 1.0


@given(
    arrays(float, (6, 3), elements=st.floats(-10, 10)),
    arrays(float, 6, elements=st.floats(-100, 100)),
    arrays(float, 3, elements=st.floats(0, 10)),
)
@settings(max_examples=repetitions(66, 200), deadline=None)
def test_limits_hold_and_one_factor_scales_all(matrix, wrench, limit):
    wrench_map = WrenchMap(matrix, np.zeros(6))
    free = LeastSquaresAllocator([1e300] * 3).allocate(wrench_map, wrench)
    held = LeastSquaresAllocator(limit).allocate(wrench_map, wrench)
    assert (np.abs(held.currents) <= limit).all()
    assert 0.0 <= held.scale <= 1.0
    np.testing.assert_allclose(held.currents, held.scale * free.currents, rtol=1e-12, atol=1e-300)
    assert held.saturated == (held.scale < 1.0)
    np.testing.assert_allclose(held.residual, wrench - matrix @ held.currents, atol=1e-9 * (1 + np.abs(wrench).max()))


def test_damping_shortens_the_currents_and_never_lengthens_them():
    rng = np.random.default_rng(0)
    wrench_map = WrenchMap(rng.normal(size=(6, 3)), np.zeros(6))
    lengths = [
        np.linalg.norm(LeastSquaresAllocator([1e9] * 3, damping=d).allocate(wrench_map, np.ones(6)).currents)
        for d in (0.0, 0.01, 0.1, 1.0)
    ]
    assert lengths == sorted(lengths, reverse=True)
    assert lengths[0] > lengths[-1]


def test_the_passive_wrench_counts_as_given_and_is_subtracted_only_when_told():
    wrench_map = WrenchMap(np.vstack([np.eye(3), np.zeros((3, 3))]), np.array([0, 0, -0.05, 0, 0, 0]))
    asked = (0.0, 0, 0.1, 0, 0, 0)
    plain = LeastSquaresAllocator.force([1.0] * 3).allocate(wrench_map, asked)
    compensating = LeastSquaresAllocator.force([1.0] * 3, compensate_passive=True).allocate(wrench_map, asked)
    np.testing.assert_allclose(plain.currents, [0, 0, 0.1])
    np.testing.assert_allclose(plain.residual[2], 0.05)
    np.testing.assert_allclose(compensating.currents, [0, 0, 0.15])
    np.testing.assert_allclose(compensating.residual, 0, atol=1e-16)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", ["matrix", "passive", "wrench"])
@pytest.mark.parametrize("position", [0, -1])
def test_what_is_not_finite_never_becomes_a_current(bad, where, position):
    parts = {"matrix": np.eye(6, 3), "passive": np.zeros(6), "wrench": np.zeros(6)}
    parts[where].flat[position] = bad
    with pytest.raises(InputError, match="finite"):
        LeastSquaresAllocator.force([1.0] * 3).allocate(WrenchMap(parts["matrix"], parts["passive"]), parts["wrench"])


def test_the_kernel_answers_nan_with_nan():
    currents = np.zeros(3)
    wrench = np.array([np.nan, 0, 0, 0, 0, 0])
    scale = least_squares_currents(np.eye(6, 3), wrench, FORCE, np.ones(3), 1e-6, 0.0, currents)
    assert np.isnan(scale)
    assert np.isnan(currents).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"current_limit": [-1.0, 1, 1]}, "current_limit must not be negative"),
        ({"current_limit": [np.nan, 1, 1]}, "current_limit must be finite"),
        ({"current_limit": 3.0}, "one entry per channel"),
        ({"current_limit": []}, "one entry per channel"),
        ({"current_limit": [1.0], "weights": [0] * 6}, "weights"),
        ({"current_limit": [1.0], "weights": [1, 1, 1]}, "weights"),
        ({"current_limit": [1.0], "weights": [-1, 1, 1, 0, 0, 0]}, "weights"),
        ({"current_limit": [1.0], "damping": np.nan}, "damping"),
        ({"current_limit": [1.0], "truncation": 0.0}, "truncation"),
    ],
)
def test_bad_settings_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        LeastSquaresAllocator(**arguments)


@pytest.mark.parametrize("arm", [0.0, -1.0, np.nan, np.inf])
def test_an_arm_must_be_a_length(arm):
    with pytest.raises(InputError, match="arm"):
        LeastSquaresAllocator.both([1.0] * 3, arm)


@pytest.mark.parametrize("wrench", [(1, 2, 3), np.zeros((6, 1)), "force", None])
def test_wrenches_of_the_wrong_shape_are_refused(wrench):
    with pytest.raises(InputError, match="wrench must be"):
        LeastSquaresAllocator.force([1.0] * 3).allocate(tool_map((0, 0, 1)), wrench)


def test_a_map_of_another_device_is_refused():
    with pytest.raises(InputError, match=r"\(6, 12\)"):
        LeastSquaresAllocator.force([1.0] * 12).allocate(tool_map((0, 0, 1)), np.zeros(6))
