"""Response of a soft sphere in harmonics against its pairwise sums over charges."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haptorb.errors import GeometryError
from haptorb.magnetics.coil import Coil
from haptorb.magnetics.magnets import ChargedRing
from haptorb.magnetics.soft_sphere import (
    SoftSphere,
    add_response_wrench,
    harmonic_sums,
    response_to_charges,
    response_to_source,
    weigh_charges,
)
from haptorb.magnetics.source import PlacedSource

ORDER, P = 14, np.array([0.02, -0.01, 0.042])
POINTS, CHARGES = ChargedRing(6e-3, 0.0, 20e-3, 1.3).place(
    Rotation.from_euler("XYZ", [20, 35, 50], degrees=True).as_matrix(), P
)
TURN = Rotation.from_euler("XYZ", [120, 15, 50], degrees=True).as_matrix()
PLACE = TURN[:, 2] * 0.033 + np.array([4e-3, 0, 0])


def sums(sphere: SoftSphere) -> np.ndarray:
    out = np.empty(((ORDER + 2) * (ORDER + 3) // 2, 2))
    harmonic_sums(np.ascontiguousarray(np.vstack([POINTS.T, CHARGES])), sphere.radius, ORDER, out)
    return out


def total(forces: np.ndarray) -> np.ndarray:
    return np.concatenate([forces.sum(axis=0), np.cross(POINTS - P, forces).sum(axis=0)])


@pytest.mark.parametrize("permeability", [np.inf, 50.0, 1.5])
def test_the_pull_on_charges_is_that_of_all_pairs(permeability: float) -> None:
    sphere = SoftSphere(15e-3, permeability)
    found, shares = sums(sphere), weigh_charges(sphere, ORDER)
    own, out = np.empty((1, len(shares), 2)), np.zeros((6, 1))
    response_to_charges(found, shares, own)
    add_response_wrench(found, own, sphere.radius, ORDER, P, out)
    expected = total(sphere.forces(POINTS, CHARGES))
    assert out[:, 0] == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("permeability", [np.inf, 50.0])
def test_the_answer_to_a_coil_is_that_to_its_charges(permeability: float) -> None:
    """Outside its ends a winding is a stack of magnetised cylinders."""
    sphere, turns, length = SoftSphere(15e-3, permeability), 200, 16e-3
    coil = PlacedSource(Coil(turns, 4e-3, 12e-3, length), PLACE, TURN)
    out = np.zeros((6, 1))
    add_response_wrench(sums(sphere), response_to_source(sphere, coil, ORDER)[None], sphere.radius, ORDER, P, out)
    nodes, weights = np.polynomial.legendre.leggauss(6)
    layers = [
        ChargedRing(8e-3 + 4e-3 * x, 0.0, length, 4e-7 * np.pi * turns / length * w / 2, radial=8, azimuth=32)
        for x, w in zip(nodes, weights, strict=True)
    ]
    at, strength = (np.concatenate(part) for part in zip(*(one.place(TURN, PLACE) for one in layers), strict=True))
    expected = total(sphere.compute_induced_field(at, strength, POINTS) * CHARGES[:, None])
    assert out[:, 0] == pytest.approx(expected, abs=1e-8 * np.abs(expected).max())


def test_a_coil_in_the_sphere_is_refused() -> None:
    with pytest.raises(GeometryError):
        response_to_source(SoftSphere(30e-3), PlacedSource(Coil(10, 4e-3, 12e-3, 16e-3), PLACE, TURN), 4)
