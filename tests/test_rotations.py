"""Rotations: Euler angles of the spherical motor (tilt first, then spin about the body's own axis), and quaternions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from haptorb.errors import InputError
from haptorb.rotations import product, quaternion, rotate, rotation_from_euler, rotation_of

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


# --------------------------------------------------------------------------------------------------
# Unit quaternions against rotation matrices.


HALF_TURNS = [Rotation.from_rotvec(np.pi * np.array(axis) / np.linalg.norm(axis)) for axis in
              [(0, 0, 1), (0, 1, 0), (1, 0, 0), (1, 1, 0), (0, 1, -1), (1, 1, 1)]]  # fmt: skip


@given(st.integers(0, 10**6))
def test_they_turn_as_matrices_do(seed: int) -> None:
    a, b = Rotation.random(2, random_state=seed)
    v = np.random.default_rng(seed).normal(size=3)
    p, q = quaternion(a.as_matrix()), quaternion(b.as_matrix())
    assert np.allclose(Rotation.from_quat(p).as_matrix(), a.as_matrix(), atol=1e-12)
    assert np.allclose(rotation_of(p), a.as_matrix(), atol=1e-12)
    assert np.allclose(rotate(p, v), a.apply(v), atol=1e-12)
    assert np.allclose(rotate(product(p, q), v), (a * b).apply(v), atol=1e-12)


def test_half_turns_lose_nothing() -> None:
    for turn in HALF_TURNS:
        for tilt in (0.0, 1e-9, -1e-9):
            R = (turn * Rotation.from_rotvec([tilt, 0.0, 0.0])).as_matrix()
            assert np.allclose(Rotation.from_quat(quaternion(R)).as_matrix(), R, atol=1e-12)
