"""Point dipoles against the printed formulas, finite differences, and the numbers of the two papers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.errors import GeometryError, InputError, UnknownName
from haptorb.magnetics import dipole
from oracles.repetitions import repetitions

number = st.floats(-3, 3, allow_nan=False)
moments = arrays(float, 3, elements=number)
places = arrays(float, 3, elements=number).filter(lambda r: np.linalg.norm(r) > 0.3)


def slope(function, at, step=1e-4):
    """(3, 3) central differences of a vector function: [i, k] = ∂f_i/∂x_k, fourth order."""
    columns = []
    for k in range(3):
        e = np.zeros(3)
        e[k] = step
        columns.append(
            (8 * (function(at + e) - function(at - e)) - (function(at + 2 * e) - function(at - 2 * e))) / (12 * step)
        )
    return np.array(columns).T


@settings(max_examples=repetitions(20, 60), deadline=None)
@given(moments, moments, places)
def test_force_is_the_printed_pair_formula(m1, m2, r):
    d = np.linalg.norm(r)
    n = r / d
    printed = (
        3
        * dipole.MU0
        / (4 * np.pi * d**4)
        * ((m1 @ n) * m2 + (m2 @ n) * m1 + (m1 @ m2) * n - 5 * (m1 @ n) * (m2 @ n) * n)
    )
    assert np.allclose(dipole.force(m1, m2, r), printed, rtol=1e-10, atol=1e-16)


@settings(max_examples=repetitions(20, 60), deadline=None)
@given(moments, moments, places)
def test_third_law_and_no_free_spin(m1, m2, r):
    there, back = dipole.force(m1, m2, r), dipole.force(m2, m1, -r)
    assert np.allclose(there, -back, atol=1e-16)
    total = dipole.torque(m1, m2, r) + dipole.torque(m2, m1, -r) + np.cross(r, there)
    assert np.allclose(total, 0, atol=1e-15)


def test_gradient_is_symmetric_and_free_of_trace():
    rng = np.random.default_rng(0)
    gradient = dipole.field_gradient(rng.normal(size=(50, 3)), rng.normal(size=(50, 3)))
    assert np.allclose(gradient, np.swapaxes(gradient, 1, 2))
    assert np.allclose(np.trace(gradient, axis1=1, axis2=2) / np.abs(gradient).max(axis=(1, 2)), 0, atol=1e-12)


def test_batches_keep_their_shape():
    assert dipole.field(np.ones((4, 1, 3)), np.ones((1, 5, 3))).shape == (4, 5, 3)
    assert dipole.force((0, 0, 1), (0, 0, 1), np.ones((2, 3))).shape == (2, 3)
    assert dipole.field((0, 0, 1), (0, 0, 1)).shape == (3,)


@pytest.mark.parametrize("bad", [(0, 0, 0), (np.nan, 0, 1), (1, 2), "here"])
def test_places_that_cannot_be(bad):
    with pytest.raises((GeometryError, InputError)):
        dipole.field((0, 0, 1), bad)


def radial_per_ampere(omni, d):
    """Magnitude of the on-axis force per ampere, averaged over the coils, each along its own axis."""
    total = 0.0
    for coil in range(3):
        axis = omni.moment_per_current[:, coil] / np.linalg.norm(omni.moment_per_current[:, coil])
        total += abs(omni.wrench_map(State.at(d * axis), "published").force[:, coil] @ axis)
    return total / 3


def test_forty_eight_millinewton_per_ampere():
    """Zárate 2020 §III: 48 mN/A at 50 mm; d⁻⁴ from there."""
    omni = load("omni")
    contact = radial_per_ampere(omni, 0.050)
    assert contact == pytest.approx(0.048, rel=0.01)
    assert round(radial_per_ampere(omni, 0.060) / contact, 3) == 0.482
    assert round(radial_per_ampere(omni, 0.070) / contact, 3) == 0.260


def test_the_wrench_map_door():
    import haptorb

    state = haptorb.State.at((0.01, 0.0, 0.05))
    assert haptorb.wrench_map("omni", state).matrix.shape == (6, 3)
    tilted = haptorb.State.at((0.01, 0.0, 0.05), axis=(0, 1, 1))
    assert not np.allclose(haptorb.wrench_map("omni", state).matrix, haptorb.wrench_map("omni", tilted).matrix)
    with pytest.raises(UnknownName, match="did you mean 'published'"):
        haptorb.wrench_map("omni", state, model="publishd")
    with pytest.raises(GeometryError, match="inside"):
        haptorb.wrench_map("omni", haptorb.State.at((0, 0, 0.02)))
