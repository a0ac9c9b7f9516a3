"""Table of a winding's field against the closed form, in the workspace of the magnets."""

from __future__ import annotations

import numpy as np
import pytest

from haptorb.magnetics.coil import Coil, tabulate_winding

SIZES = {"long": (5e-3, 16e-3, 30e-3), "flat": (4e-3, 14e-3, 9e-3), "thin": (20e-3, 21e-3, 10e-3)}


@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_it_is_the_field_of_the_winding(size: tuple[float, float, float]) -> None:
    coil, table = Coil(1, *size), tabulate_winding(*size)
    rng = np.random.default_rng(1)
    radius = coil.bounding_radius
    for lowest, highest, worst in ((0.25, 0.5, 3e-5), (0.5, 2.0, 3e-6), (2.0, 6.0, 1e-6), (6.0, 60.0, 3e-6)):
        points = rng.uniform(-1, 1, (300, 3)) * max(radius, highest * radius)
        points[:, 2] = size[2] / 2 + radius * rng.uniform(lowest, highest, 300)
        points[::2, 2] *= -1
        exact = coil.field(points)
        off = np.linalg.norm(table.field(points) - exact, axis=1) / np.linalg.norm(exact, axis=1)
        assert off.max() < worst
