"""Demagnetising factors against their integral, and their laws."""

from __future__ import annotations

import numpy as np
from scipy.special import elliprd

from haptorb.magnetics.demagnetising import demagnetising_factors


def test_the_factors_are_the_integrals_and_add_up_to_one() -> None:
    rng = np.random.default_rng(5)
    for spread in (0.01, 0.3, 2.0):
        for _ in range(50):
            axes = 0.02 * np.exp(rng.normal(0.0, spread, 3))
            factors = demagnetising_factors(axes)
            expected = [np.prod(axes) / 3 * elliprd(*np.delete(axes, i) ** 2, axes[i] ** 2) for i in range(3)]
            np.testing.assert_allclose(factors, expected, rtol=3e-15)
            np.testing.assert_allclose(factors.sum(), 1.0, rtol=3e-15)
            np.testing.assert_allclose(demagnetising_factors(1e3 * axes), factors, rtol=3e-15)
