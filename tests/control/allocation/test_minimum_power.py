"""Minimum-power torque against an independent solver (DAQP): thousands of regular and degenerate problems."""

import daqp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from haptorb.control.allocation import MinimumPowerAllocator
from haptorb.control.minimum_power import NOT_FINITE, minimum_power_currents, solve_bounded_power
from haptorb.devices.base import WrenchMap
from haptorb.errors import InputError, UnknownName
from oracles.repetitions import repetitions

KINDS = ("plain", "ill-conditioned", "degenerate", "parallel", "limits-decades-apart", "resistances-apart")
EQUALITY = 5


def problem(rng, kind, m):
    """K (3, m), limit (m,), resistance (m,)."""
    K, limit, resistance = rng.normal(size=(3, m)), rng.uniform(0.5, 1.5, m), np.ones(m)
    if kind == "ill-conditioned":
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        K = turn @ np.diag(10.0 ** rng.uniform(-4, 0, 3)) @ K
    elif kind == "degenerate":  # repeated and vanishing columns, channels that are off, ties everywhere
        K, limit = rng.integers(-2, 3, (3, m)).astype(float), rng.integers(0, 3, m).astype(float)
    elif kind == "parallel":
        K = np.repeat(rng.normal(size=(3, m // 3)), 3, axis=1)
    elif kind == "limits-decades-apart":
        limit = 10.0 ** rng.uniform(-4, 1, m)
    elif kind == "resistances-apart":
        resistance = 10.0 ** rng.uniform(-2, 1, m)
    return K, limit, resistance


def torque(rng, K, limit, number):
    """Well inside, near the edge, around the surface, far beyond: in turn."""
    match number % 4:
        case 0:
            return K @ (rng.uniform(-1, 1, len(limit)) * limit)
        case 1:
            return 0.9 * K @ (np.sign(rng.normal(size=len(limit))) * limit)
        case 2:
            return rng.uniform(0.8, 1.1) * K @ (np.sign(K.T @ rng.normal(size=3)) * limit)
        case _:
            return rng.normal(size=3) * np.abs(K).sum()


def oracle(K, T, limit, resistance):
    """DAQP's least ½ Σ R i² with K i = T within the limits, or None if it says there is none."""
    m = K.shape[1]
    scale = np.abs(K).max() or 1.0
    sense = np.r_[np.zeros(m), np.full(3, EQUALITY)].astype(np.int32)
    upper, lower = np.r_[limit, T / scale], np.r_[-limit, T / scale]
    x, _, flag, _ = daqp.solve(
        np.diag(resistance), np.zeros(m), K / scale, upper, lower, sense, primal_tol=1e-10, dual_tol=1e-12
    )
    return x if flag > 0 else None


def reach(K, T, limit):
    """How far the torques within the limits go along T: a linear programme, solved independently."""
    from scipy.optimize import linprog

    m = len(limit)
    answer = linprog(
        np.r_[np.zeros(m), -1.0],
        A_eq=np.c_[K, -T],
        b_eq=np.zeros(3),
        bounds=[*zip(-limit, limit, strict=True), (0, None)],
    )
    return answer.x[-1]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("m", [3, 12, 24])
def test_agrees_with_an_independent_solver_on_what_is_feasible_and_on_the_least_power(kind, m):
    rng = np.random.default_rng([m, KINDS.index(kind)])
    feasible = infeasible = doubtful = 0
    for number in range(600):
        K, limit, resistance = problem(rng, kind, m)
        T = torque(rng, K, limit, number)
        currents = np.empty(m)
        status, scale = solve_bounded_power(K, T, limit, resistance, False, currents)
        assert (np.abs(currents) <= limit).all()
        reference = oracle(K, T, limit, resistance)
        size = np.abs(T).max()
        if status == 0:
            assert scale == 1.0
            np.testing.assert_allclose(K @ currents, T, atol=1e-9 * size)
            if reference is None:
                doubtful += 1  # on the surface itself the two may differ by a rounding
                continue
            feasible += 1
            ours, theirs = resistance @ currents**2, resistance @ reference**2
            assert ours <= theirs * (1 + 1e-7) + 1e-15
        else:
            assert status == 1
            assert 0.0 <= scale < 1.0
            np.testing.assert_allclose(K @ currents, scale * T, atol=1e-8 * size)
            infeasible += reference is None
            doubtful += reference is not None
    assert feasible > 150
    assert infeasible > 150
    assert doubtful <= 6


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("m", [3, 12])
def test_beyond_the_limits_the_scaled_torque_is_as_great_as_it_can_be(kind, m):
    rng = np.random.default_rng([7, m, KINDS.index(kind)])
    for _ in range(60):
        K, limit, resistance = problem(rng, kind, m)
        T = rng.normal(size=3) * np.abs(K).sum()
        currents = np.empty(m)
        _, scale = solve_bounded_power(K, T, limit, resistance, False, currents)
        assert scale == pytest.approx(min(reach(K, T, limit), 1.0), rel=2e-4, abs=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("m", [3, 12, 24])
def test_beyond_the_limits_the_nearest_torque_is_the_nearest(kind, m):
    rng = np.random.default_rng([8, m, KINDS.index(kind)])
    for number in range(300):
        K, limit, resistance = problem(rng, kind, m)
        T = torque(rng, K, limit, 2 + number % 2)
        currents = np.empty(m)
        status, _ = solve_bounded_power(K, T, limit, resistance, True, currents)
        if status == 0:
            continue
        assert status == 2
        assert (np.abs(currents) <= limit).all()
        H = K.T @ K + 1e-9 * np.linalg.norm(K) ** 2 * np.eye(m)
        x, _, flag, _ = daqp.solve(H, -K.T @ T, np.zeros((0, m)), limit, -limit, np.zeros(m, dtype=np.int32))
        if flag > 0:
            ours, theirs = np.linalg.norm(K @ currents - T), np.linalg.norm(K @ x - T)
            assert ours <= theirs + 1e-6 * np.linalg.norm(T)


def test_without_a_limit_met_it_is_equation_4():
    rng = np.random.default_rng(2)
    for m in (3, 12, 24):
        K, T = rng.normal(size=(3, m)), rng.normal(size=3)
        expected = K.T @ np.linalg.inv(K @ K.T) @ T  # Bai 2012 eq. (4), as printed
        currents = np.empty(m)
        solve_bounded_power(K, T, np.full(m, 1e6), np.ones(m), False, currents)
        np.testing.assert_allclose(currents, expected, rtol=1e-9)
        np.testing.assert_allclose(minimum_power_currents(K, T), expected, rtol=1e-9)


def test_equation_4_is_batched():
    rng = np.random.default_rng(3)
    K, T = rng.normal(size=(5, 3, 12)), rng.normal(size=(5, 3))
    currents = minimum_power_currents(K, T)
    assert currents.shape == (5, 12)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", K, currents), T, atol=1e-12)


def test_equation_4_refuses_what_it_cannot_invert():
    with pytest.raises(InputError, match="rank 3"):
        minimum_power_currents(np.ones((3, 12)), (1.0, 0, 0))
    with pytest.raises(InputError, match="rank 3"):
        minimum_power_currents(np.ones((3, 2)), (1.0, 0, 0))
    with pytest.raises(InputError, match="shape"):
        minimum_power_currents(np.ones((2, 3)), (1.0, 0, 0))
    with pytest.raises(InputError, match="finite"):
        minimum_power_currents(np.full((3, 12), np.nan), (1.0, 0, 0))


@given(
    arrays(float, (3, 12), elements=st.floats(-1e3, 1e3)),
    arrays(float, 3, elements=st.floats(-1e6, 1e6)),
    arrays(float, 12, elements=st.just(0.0) | st.floats(1e-6, 1e3)),
    st.booleans(),
)
# One limit a million times narrower than the others, and the strongest coil behind it: the search ended in nothing.
@example(
    1e-5 * (1.0 - np.eye(3, 12)) + np.outer((0.0, 0.0, 1.0), 2.0 * np.eye(12)[6]),
    np.array([0.0, 0.0, 1.0]),
    np.where(np.arange(12) == 6, 1e-6, 1.0),
    False,
)
@settings(max_examples=repetitions(133, 400), deadline=None)
def test_whatever_comes_in_limits_hold_and_the_torque_never_misses_by_more_than_itself(K, T, limit, nearest):
    currents = np.empty(12)
    status, scale = solve_bounded_power(K, T, limit, np.ones(12), nearest, currents)
    assert np.isfinite(currents).all()
    assert (np.abs(currents) <= limit).all()
    assert 0.0 <= scale <= 1.0
    assert status in (0, 1, 2)
    assert np.linalg.norm(T - K @ currents) <= np.linalg.norm(T) * (1 + 1e-9)


@pytest.mark.parametrize("nearest", [False, True])
def test_no_torque_asked_or_no_current_allowed_means_no_current(nearest):
    rng = np.random.default_rng(0)
    K, currents = rng.normal(size=(3, 12)), np.full(12, 9.0)
    assert solve_bounded_power(K, np.zeros(3), np.ones(12), np.ones(12), nearest, currents) == (0, 1.0)
    assert not currents.any()
    currents[:] = 9.0
    status, scale = solve_bounded_power(K, np.ones(3), np.zeros(12), np.ones(12), nearest, currents)
    assert status == (2 if nearest else 1)
    assert scale == (1.0 if nearest else 0.0)
    assert not currents.any()


@pytest.mark.parametrize("nearest", [False, True])
def test_a_channel_that_is_off_stays_off(nearest):
    rng = np.random.default_rng(0)
    for _ in range(200):
        limit = np.where(rng.random(12) < 0.4, 0.0, 1.0)
        currents = np.empty(12)
        solve_bounded_power(rng.normal(size=(3, 12)), rng.normal(size=3) * 5, limit, np.ones(12), nearest, currents)
        assert not currents[limit == 0].any()


def test_an_axis_that_no_channel_turns_is_refused_when_scaling_and_left_out_when_nearest():
    K = np.vstack([np.random.default_rng(0).normal(size=(2, 12)), np.zeros(12)])
    T = np.array([0.1, 0.2, 0.3])
    currents = np.empty(12)
    assert solve_bounded_power(K, T, np.ones(12), np.ones(12), False, currents) == (1, 0.0)
    assert not currents.any()
    status, _ = solve_bounded_power(K, T, np.ones(12), np.ones(12), True, currents)
    assert status == 2
    np.testing.assert_allclose(K @ currents, [0.1, 0.2, 0], atol=1e-8)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", ["K", "T", "limit", "resistance"])
def test_the_kernel_answers_what_is_not_finite_with_nan_and_a_flag(bad, where):
    parts = {"K": np.ones((3, 12)), "T": np.ones(3), "limit": np.ones(12), "resistance": np.ones(12)}
    parts[where].flat[-1] = bad
    currents = np.zeros(12)
    status, scale = solve_bounded_power(parts["K"], parts["T"], parts["limit"], parts["resistance"], False, currents)
    assert status == NOT_FINITE
    assert np.isnan(scale)
    assert np.isnan(currents).all()


def motor(K, passive=(0.0,) * 6):
    return WrenchMap(np.vstack([np.zeros_like(K), K]), np.asarray(passive))


def test_the_allocator_reports_residual_and_saturation():
    K = np.random.default_rng(1).normal(size=(3, 12))
    allocator = MinimumPowerAllocator(np.ones(12))
    inside = allocator.allocate(motor(K), (0, 0, 0, 0.1, 0.2, 0.3))
    np.testing.assert_allclose(inside.residual, 0, atol=1e-12)
    assert (inside.saturated, inside.scale) == (False, 1.0)
    beyond = allocator.allocate(motor(K), (0, 0, 0, 100.0, 200.0, 300.0))
    assert beyond.saturated
    np.testing.assert_allclose(beyond.residual[3:], (1 - beyond.scale) * np.array([100.0, 200, 300]), rtol=1e-6)
    # the bearing carries force: it is not the coils' business, and the residual says so
    assert allocator.allocate(motor(K), (1.0, 0, 0, 0, 0, 0)).residual[0] == 1.0


def test_at_a_limit_but_in_full_is_saturated_with_scale_one():
    K = np.c_[np.eye(3), np.eye(3) * 0.1]
    allocation = MinimumPowerAllocator([1.0] * 6).allocate(motor(K), (0, 0, 0, 1.05, 0, 0))
    assert allocation.saturated
    assert allocation.scale == 1.0
    np.testing.assert_allclose(allocation.currents[[0, 3]], [1.0, 0.5], rtol=1e-9)


def test_least_squares_gives_more_torque_than_scaling_when_one_axis_is_weak():
    K = np.diag([1.0, 1.0, 0.01])
    asked = np.array([0, 0, 0, 0.5, 0.5, 0.5])
    scaled = MinimumPowerAllocator([1.0] * 3).allocate(motor(K), asked)
    nearest = MinimumPowerAllocator([1.0] * 3, infeasible="least-squares").allocate(motor(K), asked)
    assert scaled.scale == pytest.approx(0.02, rel=1e-6)
    np.testing.assert_allclose(nearest.residual[3:], [0, 0, 0.49], atol=1e-6)


def test_unequal_resistances_move_the_current_to_the_cooler_channel():
    K = np.c_[np.eye(3), np.eye(3)]
    currents = MinimumPowerAllocator([9.0] * 6, resistance=[1, 1, 1, 3, 3, 3]).allocate(motor(K), [0, 0, 0, 1, 1, 1])
    np.testing.assert_allclose(currents.currents, [0.75] * 3 + [0.25] * 3, rtol=1e-9)


def test_the_regulators_torque_is_compensated_when_told():
    passive = (0, 0, 0, 0.2, 0, 0)
    held = MinimumPowerAllocator([9.0] * 3, compensate_passive=True).allocate(motor(np.eye(3), passive), np.zeros(6))
    np.testing.assert_allclose(held.currents, [-0.2, 0, 0])
    np.testing.assert_allclose(held.residual, 0, atol=1e-15)


@pytest.mark.parametrize("where", ["wrench", "matrix", "passive"])
def test_the_allocator_refuses_what_is_not_finite(where):
    K, passive, wrench = np.eye(3), np.zeros(6), np.zeros(6)
    {"wrench": wrench, "matrix": K, "passive": passive}[where].flat[0] = np.nan
    with pytest.raises(InputError, match="finite"):
        MinimumPowerAllocator([1.0] * 3).allocate(motor(K, passive), wrench)


def test_bad_settings_are_refused():
    with pytest.raises(UnknownName, match="did you mean 'scale'"):
        MinimumPowerAllocator([1.0] * 3, infeasible="scaled")
    with pytest.raises(InputError, match="resistance"):
        MinimumPowerAllocator([1.0] * 3, resistance=[1.0, 1.0])
    with pytest.raises(InputError, match="resistance"):
        MinimumPowerAllocator([1.0] * 3, resistance=[1.0, 0.0, 1.0])
