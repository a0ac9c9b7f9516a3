"""Quaternions against rotation matrices."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from haptorb.rotations import product, quaternion, rotate

HALF_TURNS = [Rotation.from_rotvec(np.pi * np.array(axis) / np.linalg.norm(axis)) for axis in
              [(0, 0, 1), (0, 1, 0), (1, 0, 0), (1, 1, 0), (0, 1, -1), (1, 1, 1)]]  # fmt: skip


@given(st.integers(0, 10**6))
def test_they_turn_as_matrices_do(seed: int) -> None:
    a, b = Rotation.random(2, random_state=seed)
    v = np.random.default_rng(seed).normal(size=3)
    p, q = quaternion(a.as_matrix()), quaternion(b.as_matrix())
    assert np.allclose(Rotation.from_quat(p).as_matrix(), a.as_matrix(), atol=1e-12)
    assert np.allclose(rotate(p, v), a.apply(v), atol=1e-12)
    assert np.allclose(rotate(product(p, q), v), (a * b).apply(v), atol=1e-12)


def test_half_turns_lose_nothing() -> None:
    for turn in HALF_TURNS:
        for tilt in (0.0, 1e-9, -1e-9):
            R = (turn * Rotation.from_rotvec([tilt, 0.0, 0.0])).as_matrix()
            assert np.allclose(Rotation.from_quat(quaternion(R)).as_matrix(), R, atol=1e-12)
