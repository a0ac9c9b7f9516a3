"""Zonal fields of a coil, about a soft sphere and about its own centre: the closed form, and the sphere's charges."""

from __future__ import annotations

import numpy as np
import pytest

from haptorb.errors import GeometryError
from haptorb.magnetics.coil import CentredCoil, Coil, InteriorCoil
from haptorb.magnetics.soft_sphere import SoftSphere

COIL = Coil(120.0, 19e-3, 25e-3, 17e-3)
DRAW = np.random.default_rng(4)
POINTS = DRAW.normal(size=(60, 3))
POINTS *= (np.linspace(36e-3, 0.2, 60) / np.linalg.norm(POINTS, axis=1))[:, None]


def test_without_a_core_it_is_the_coils_closed_field() -> None:
    found = CentredCoil(COIL, SoftSphere(15e-3, 1.0 + 1e-12), 36e-3).field(POINTS)
    exact = COIL.field(POINTS)
    assert np.abs(found - exact).max() < 3e-6 * np.abs(exact).max()
    assert found[-1] == pytest.approx(exact[-1], rel=1e-6)


def test_what_the_core_adds_is_its_dipole_in_the_coils_field() -> None:
    """Far away it is the dipole that the coil's own field at the centre makes of the core."""
    core = SoftSphere(15e-3)
    wide = Coil(10.0, 40e-3, 41e-3, 2e-3)
    unit = POINTS / np.linalg.norm(POINTS, axis=1)[:, None]
    far = CentredCoil(wide, core, 60e-3)
    alone = CentredCoil(wide, SoftSphere(15e-3, 1.0 + 1e-12), 60e-3)
    at = 0.1 * unit
    answer = far.field(at) - alone.field(at)
    moment = core.moment_in(wide.field((0.0, 0.0, 0.0)))[2]
    dipole = 1e-7 * moment * (3 * unit[:, 2:] * unit - np.array([0.0, 0.0, 1.0])) / 0.1**3
    assert answer == pytest.approx(dipole, rel=0.05, abs=0.02 * np.abs(dipole).max())


def test_points_within_coil_or_core_are_refused() -> None:
    with pytest.raises(GeometryError, match="within coil or core"):
        CentredCoil(COIL, SoftSphere(15e-3), 26e-3)


@pytest.mark.parametrize("size", [(19e-3, 25e-3, 17e-3), (19e-3, 19.6e-3, 40e-3), (5e-3, 30e-3, 2e-3)])
def test_around_the_coils_centre_it_is_the_closed_field(size: tuple[float, float, float]) -> None:
    coil = Coil(120.0, *size)
    unit = POINTS / np.linalg.norm(POINTS, axis=1)[:, None]
    for share in (0.0, 0.3, 0.7, 0.9):  # of the inner radius; beyond 3/4 of it there is no series
        at = share * size[0] * unit.reshape(3, 20, 3)
        exact = coil.field(at)
        assert np.abs(InteriorCoil(coil).field(at) - exact).max() < 1e-12 * np.abs(exact).max()
    assert InteriorCoil(coil).moment.tolist() == coil.moment.tolist()
