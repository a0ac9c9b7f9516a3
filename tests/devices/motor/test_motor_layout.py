"""Rings of parts, their frames, and alternating polarity."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from haptorb.devices.motor_layout import Layout, PartRing, alternate_signs, spherical_frames
from haptorb.errors import InputError


def test_angles_are_latitudes():
    north = PartRing(np.radians(26), 1, np.radians(90), 0.0).directions()[0]
    np.testing.assert_allclose(north, [0, np.cos(np.radians(26)), np.sin(np.radians(26))], atol=1e-15)


@given(arrays(float, 3, elements=st.floats(-1, 1)).filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_frames_are_rotations_that_take_z_outward(direction):
    frame = spherical_frames(direction[None])[0]
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) > 0
    np.testing.assert_allclose(frame[:, 2], direction / np.linalg.norm(direction), atol=1e-12)


@pytest.mark.parametrize("pole", [1.0, -1.0])
def test_frames_exist_at_the_poles(pole):
    frame = spherical_frames(np.array([[0, 0, pole]]))[0]
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-15)
    assert frame[2, 2] == pole


def test_a_checkerboard_alternates_along_and_across_and_is_odd_through_the_centre_by_radial_sense():
    rings = [PartRing(np.radians(a), 12, 0.0, np.radians(30)) for a in (-15, 15)]
    layout, signs = Layout.of_rings(1.0, rings), alternate_signs([12, 12], "checkerboard")
    between = layout.directions @ layout.directions.T
    neighbours = (between > np.cos(np.radians(31))) & (between < 0.999)
    for i, j in zip(*np.nonzero(neighbours), strict=True):
        assert signs[i] == -signs[j]
    opposite = np.argmin(between, axis=1)
    np.testing.assert_array_equal(signs[opposite], -signs)  # magnetization itself: the same seen through the centre


def test_in_phase_rings_are_alike():
    np.testing.assert_array_equal(*np.split(alternate_signs([12, 12], "in-phase"), 2))


def test_another_pattern_is_refused():
    with pytest.raises(InputError, match="checkerboard"):
        alternate_signs([4], "stripes")
