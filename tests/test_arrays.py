"""Cubic spline: coefficients of scipy's; exact for cubics; short lists are rejected."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from haptorb.arrays import cubic_spline
from haptorb.errors import InputError


@pytest.mark.parametrize(("count", "step"), [(4, 0.3), (5, 2.0), (257, 1e-5)])
def test_it_is_the_librarys(count, step):
    values = np.random.default_rng(count).normal(size=count)
    expected = CubicSpline(step * np.arange(count), values).c.T
    scale = np.abs(expected).max(axis=0)
    assert cubic_spline(values, step) / scale == pytest.approx(expected / scale, abs=1e-11)


def test_a_cubic_is_its_own_spline():
    t = 0.5 * np.arange(9)
    found = cubic_spline(2 * t**3 - t**2 + 3 * t - 7, 0.5)
    assert found[:, 0] == pytest.approx(2.0)
    assert found[:, 3] == pytest.approx(2 * t[:-1] ** 3 - t[:-1] ** 2 + 3 * t[:-1] - 7)


@pytest.mark.parametrize("values", [np.zeros(3), np.zeros((4, 4))])
def test_too_few_values_are_refused(values):
    with pytest.raises(InputError, match="at least 4"):
        cubic_spline(values, 1.0)
