"""Euler angles of the spherical motor: tilt first, then spin about the body's own axis."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from haptorb.errors import InputError
from haptorb.rotations import rotation_from_euler

angle = st.floats(-np.pi, np.pi)


@given(angle, angle, angle)
def test_equals_intrinsic_xyz_of_scipy(psi, lam, phi):
    expected = Rotation.from_euler("XYZ", [psi, lam, phi]).as_matrix()
    np.testing.assert_allclose(rotation_from_euler(psi, lam, phi), expected, atol=1e-15)


def test_spin_does_not_move_the_handle():
    tilted = rotation_from_euler(0.3, -0.2, 0.0)[:, 2]
    np.testing.assert_allclose(rotation_from_euler(0.3, -0.2, 2.0)[:, 2], tilted, atol=1e-15)


def test_angles_broadcast():
    assert rotation_from_euler(np.zeros((4, 1)), 0.1, np.zeros(5)).shape == (4, 5, 3, 3)


@pytest.mark.parametrize("bad", [(np.nan, 0, 0), (0, np.inf, 0), (np.zeros(2), np.zeros(3), 0), ("tilt", 0, 0)])
def test_bad_angles_are_refused(bad):
    with pytest.raises(InputError, match=r"psi|lam|phi"):
        rotation_from_euler(*bad)
