"""Both solvers against an independent one (DAQP), bounds of truncated iterations, and identical bits elsewhere."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import daqp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.oracles.repetitions import repetitions

from haptorb.box_qp import GIVEN, SCALED, dual_newton, solve_box

# --------------------------------------------------------------------------------------------------
# Few variables.


def problem(seed, n, decades):
    """Hessian, linear part and bounds; eigenvalues over so many decades, some bounds that meet."""
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(n, n)))[0]
    hessian = turn @ np.diag(10.0 ** rng.uniform(-decades, 0.0, n)) @ turn.T
    low = -rng.uniform(0.0, 1.0, n)
    high = np.where(rng.uniform(size=n) < 0.1, low, low + rng.uniform(0.1, 2.0, n))
    return np.ascontiguousarray(0.5 * (hessian + hessian.T)), rng.normal(size=n), low, high


def cost(hessian, linear, x):
    return 0.5 * x @ hessian @ x + linear @ x


def reference(hessian, linear, low, high):
    """DAQP's minimum within the bounds."""
    n = len(low)
    found = daqp.solve(
        hessian, linear, np.zeros((0, n)), high, low, np.zeros(n, dtype=np.int32), primal_tol=1e-12, dual_tol=1e-12
    )
    assert found[2] == 1
    return np.clip(found[0], low, high)


@settings(max_examples=repetitions(60, 2000))
@given(st.integers(0, 2**32 - 1), st.integers(1, 24), st.floats(0.0, 6.0))
def test_it_finds_what_an_independent_solver_finds(seed, n, decades):
    hessian, linear, low, high = problem(seed, n, decades)
    x = np.zeros(n)
    steps = solve_box(hessian, linear, low, high, x, np.zeros((n + 4, n)), 60, 1e-9)
    assert steps >= 0
    assert (x >= low).all()
    assert (x <= high).all()
    assert cost(hessian, linear, x) <= cost(hessian, linear, reference(hessian, linear, low, high)) + 1e-7


def test_bounds_that_stop_every_step_do_not_end_the_search():
    """Six coils for six components, nearly singular: among these problems a few are stuck if nothing is fixed then."""
    rng = np.random.default_rng(6)
    for _ in range(1500):
        matrix = rng.normal(size=(6, 6))
        hessian = matrix.T @ matrix + 1e-12 * np.eye(6)
        linear, high = -matrix.T @ rng.normal(size=6) * 10 ** rng.uniform(-3, 1), rng.uniform(0.5, 2.0, 6)
        x = np.zeros(6)
        size = np.minimum(np.abs(linear) / np.diag(hessian), high).max()
        solve_box(hessian, linear, -high, high, x, np.zeros((10, 6)), 30, 1e-11 * size)
        best = cost(hessian, linear, reference(hessian, linear, -high, high))
        assert cost(hessian, linear, x) <= best + 1e-6 * abs(best)


def test_from_its_own_solution_it_takes_no_step():
    hessian, linear, low, high = problem(3, 24, 2.0)
    x, work = np.zeros(24), np.zeros((28, 24))
    solve_box(hessian, linear, low, high, x, work, 60, 1e-9)
    assert solve_box(hessian, linear, low, high, x, work, 60, 1e-8) == 0


@pytest.mark.parametrize("start", [0.0, 1e9, np.nan])
def test_cut_short_it_stays_within_the_bounds_and_says_so(start):
    hessian, linear, low, high = problem(5, 24, 3.0)
    x = np.full(24, start)
    assert solve_box(hessian, linear, low, high, x, np.zeros((28, 24)), 1, 1e-12) == -1
    assert (x >= low).all()
    assert (x <= high).all()


@pytest.mark.parametrize("where", ["hessian", "linear"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_refused_within_the_bounds(where, bad):
    hessian, linear, low, high = problem(5, 6, 1.0)
    {"hessian": hessian, "linear": linear}[where].flat[0] = bad
    x = np.full(6, 0.05)
    assert solve_box(hessian, linear, low, high, x, np.zeros((10, 6)), 60, 1e-9) == -2
    assert (x >= low).all()
    assert (x <= high).all()


def test_what_is_not_convex_is_refused():
    x = np.zeros(2)
    hessian = np.array([[1.0, 2.0], [2.0, 1.0]])
    assert solve_box(hessian, np.ones(2), -np.ones(2), np.ones(2), x, np.zeros((6, 2)), 60, 1e-9) == -2


# --------------------------------------------------------------------------------------------------
# Few equations. Without slack: tests/control/allocation/test_minimum_power.py.


def equations(rng, kind, n, m):
    """Q (n, m), t (n,), limit (m,)."""
    Q, limit = rng.normal(size=(n, m)), rng.uniform(0.2, 2.0, m)
    if kind == "of lower rank":
        Q[-1] = Q[0]
        Q[:, m // 2 :] = 0.0
    elif kind == "with ties":  # repeated and vanishing columns, limits that meet
        Q, limit = rng.integers(-2, 3, (n, m)).astype(float), rng.integers(0, 3, m).astype(float)
    elif kind == "ill-conditioned":
        Q *= 10.0 ** rng.uniform(-4, 0, n)[:, None]
    return Q, Q @ rng.normal(size=m) + 0.1 * rng.normal(size=n), limit


@pytest.mark.parametrize("kind", ["plain", "of lower rank", "with ties", "ill-conditioned"])
@pytest.mark.parametrize("slack", [1e-2, 1.0])
def test_soft_equations_are_solved_as_an_independent_solver_does(kind, slack):
    rng = np.random.default_rng([int(slack), len(kind)])
    held = 0
    for number in range(300):
        n, m = 1 + number % 6, int(rng.integers(2, 20))
        Q, t, limit = equations(rng, kind, n, m)
        y = np.empty(m)
        assert dual_newton(Q, t, slack, limit, 1e-9 * np.abs(t).max(), np.zeros(n), y) == GIVEN
        hessian, linear = np.eye(m) + Q.T @ Q / slack**2, -Q.T @ t / slack**2
        expected = reference(hessian, linear, -limit, limit)
        assert (np.abs(y) <= limit).all()
        assert cost(hessian, linear, y) <= cost(hessian, linear, expected) + 1e-6 * (1.0 + abs(linear @ y))
        held += (np.abs(y) == limit).any()
    assert held > 15


@pytest.mark.parametrize("n", [1, 2, 4, 6])
def test_hard_equations_of_any_number_are_met_or_refused_with_a_reason(n):
    rng = np.random.default_rng(n)
    outcomes = []
    for _ in range(200):
        m = int(rng.integers(n + 1, 20))
        Q = np.ascontiguousarray(np.linalg.qr(rng.normal(size=(m, n)))[0].T)
        limit = rng.uniform(0.2, 2.0, m)
        t, y = rng.uniform(0.1, 2.5) * Q @ (np.sign(Q.T @ rng.normal(size=n)) * limit), np.empty(m)
        outcomes.append(dual_newton(Q, t, 0.0, limit, 1e-11 * np.linalg.norm(t), t.copy(), y))
        sense = np.r_[np.zeros(m), np.full(n, 5)].astype(np.int32)
        x, _, flag, _ = daqp.solve(np.eye(m), np.zeros(m), Q, np.r_[limit, t], np.r_[-limit, t], sense)
        assert (outcomes[-1] == GIVEN) == (flag > 0)
        if flag > 0:
            np.testing.assert_allclose(y, x, atol=1e-6)
    assert min(outcomes.count(GIVEN), outcomes.count(SCALED)) > 30


# --------------------------------------------------------------------------------------------------
# The same bits on another processor.


def digest():
    """Of the results of both solvers and of the allocation that uses them."""
    from haptorb.control.minimum_power import solve_bounded_power, solve_least_heat
    from haptorb.control.saturation import solve_compromise

    rng, out = np.random.default_rng(0), hashlib.sha256()
    for number in range(200):
        K, T, limit, ohms = rng.normal(size=(6, 12)), rng.normal(size=6), rng.uniform(0, 1, 12), rng.uniform(1, 2, 12)
        currents, few = np.empty(12), np.empty(3)
        solve_bounded_power(K[:3], 10 * T[:3], limit, ohms, bool(number % 2), currents)
        out.update(currents.tobytes())
        solve_least_heat(K, T, np.ones(6), limit, ohms, currents)
        out.update(currents.tobytes())
        solve_compromise(K[:, :3].T @ K[:, :3], K[:, :3].T @ T, limit[:3], ohms[:3], 0.3, few)
        out.update(few.tobytes())
        hessian, linear, low, high = problem(number, 12, 3.0)
        solve_box(hessian, linear, low, high, currents, np.zeros((16, 12)), 60, 1e-9)
        out.update(currents.tobytes())
    return out.hexdigest()


@pytest.mark.slow  # all kernels are compiled again
def test_a_processor_without_fused_multiplication_gives_the_same_bits(tmp_path):
    plain = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(tmp_path)}
    program = "from tests.test_box_qp import digest; print(digest())"
    root = Path(__file__).parents[1]
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, **plain},
        cwd=root,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == digest()
