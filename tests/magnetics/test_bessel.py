"""Integral of t J₁(t), against scipy's Bessel and Struve functions."""

from __future__ import annotations

import numpy as np
from scipy.special import jv, struve

from haptorb.magnetics.coil import integrate_bessel


def test_it_is_what_struve_functions_say() -> None:
    x = np.concatenate([np.geomspace(1e-3, 1.0, 50), np.linspace(1.0, 60.0, 2000), np.linspace(60.0, 1500.0, 5000)])
    expected = 0.5 * np.pi * x * (jv(1, x) * struve(0, x) - jv(0, x) * struve(1, x))
    np.testing.assert_allclose(integrate_bessel(x), expected, rtol=1e-9, atol=1e-11)


def test_both_ways_agree_where_they_meet_and_shapes_are_kept() -> None:
    x = np.array([[30.0 * (1 - 1e-12), 30.0], [0.0, 1e-9]])
    found = integrate_bessel(x)
    assert found.shape == (2, 2)
    assert abs(found[0, 0] - found[0, 1]) < 1e-9
    assert abs(found[1]).max() < 1e-15
