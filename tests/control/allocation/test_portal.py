"""Reach of a zonotope with many generators, against all pairs of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

from haptorb.control.saturation import find_reach


@pytest.mark.parametrize("channels", [4, 25, 100])
def test_it_is_that_of_the_linear_program(channels: int) -> None:
    rng = np.random.default_rng(channels)
    for case in range(24):
        Q = rng.normal(size=(3, channels))
        if case % 3 == 0:
            Q[2] *= 1e-3  # nearly flat
        if case % 4 == 0:
            Q[:, channels // 2 :] = Q[:, : channels - channels // 2]  # coils in pairs
        box = rng.uniform(0.5, 2, channels)
        d = Q[:, 0].copy() if case % 5 == 0 else rng.normal(size=3)
        if np.linalg.matrix_rank(Q) < 3:
            continue
        equal = np.column_stack([Q, -d])
        limits = [*((-b, b) for b in box), (0, None)]
        best = linprog(np.append(np.zeros(channels), -1), A_eq=equal, b_eq=np.zeros(3), bounds=limits).x[-1]
        assert find_reach(Q, d, box) == pytest.approx(best, rel=1e-6)
