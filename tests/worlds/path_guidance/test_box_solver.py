"""The solver against an independent one (DAQP), and its bounds when it is cut short."""

import daqp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.oracles.repetitions import repetitions

from haptorb.worlds.path_guidance import solve_box


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


@settings(max_examples=repetitions(60, 2000))
@given(st.integers(0, 2**32 - 1), st.integers(1, 24), st.floats(0.0, 3.0))
def test_it_finds_what_an_independent_solver_finds(seed, n, decades):
    hessian, linear, low, high = problem(seed, n, decades)
    x = np.zeros(n)
    steps = solve_box(hessian, linear, low, high, x, np.zeros((n + 4, n)), 60, 1e-9)
    expected = daqp.solve(hessian, linear, np.zeros((0, n)), high, low, np.zeros(n, dtype=np.int32))[0]
    assert steps >= 0
    assert (x >= low).all()
    assert (x <= high).all()
    assert cost(hessian, linear, x) <= cost(hessian, linear, np.clip(expected, low, high)) + 1e-7


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
