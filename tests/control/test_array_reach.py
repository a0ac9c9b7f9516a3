"""Forces of a coil array's card: exact along each axis, by an independent linear program."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

from haptorb.control.array_allocation import ArrayAllocator
from haptorb.control.capability import _DIRECTIONS, _list_places, _reach, array_capability
from haptorb.devices.loader import load


def solve(forces, passive, limit, direction):
    """Greatest t with forces @ i + passive = t · direction and |i| ≤ limit; 0 if there is none."""
    equalities = np.column_stack([forces, -direction])
    bounds = [*((-one, one) for one in limit), (0.0, None)]
    found = linprog(np.r_[np.zeros(len(limit)), -1.0], A_eq=equalities, b_eq=-passive, bounds=bounds)
    return -found.fun if found.status == 0 else 0.0


@pytest.mark.parametrize(("name", "height"), [("tetrahedron", 0.0), ("tetrahedron", 0.015), ("planar", 0.0)])
def test_the_greatest_force_along_an_axis_is_that_of_a_linear_program(name: str, height: float) -> None:
    device = load(name)
    allocator = ArrayAllocator(device.driven_current, device.greatest_resistance)  # no supply: a linear program
    for state in _list_places(device, height)[::7]:
        wrench_map = device.wrench_map(state, "exact")
        limit = allocator.current_limit
        true = [solve(wrench_map.matrix[:3], wrench_map.passive[:3], limit, one) for one in _DIRECTIONS]
        assert _reach(device, state, allocator) == pytest.approx(np.array(true), rel=4e-3, abs=1e-3 * max(true))


def test_the_weakest_force_falls_with_height() -> None:
    weakest = [layer.weakest for layer in array_capability(load("tetrahedron"), 5)]
    assert weakest == sorted(weakest, reverse=True)
    assert weakest[0] > weakest[-1] > 0.0
