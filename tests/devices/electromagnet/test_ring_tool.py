"""The tool's wrench maps against the batched dipole, the charged ring and the printed equations."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from haptorb.devices.base import rotation_to_axis
from haptorb.devices.electromagnet_wrench_map import ring_per_ampere
from haptorb.magnetics import dipole
from haptorb.magnetics.dipole import dipole_per_ampere
from haptorb.magnetics.magnets import ChargedRing

RING = (6e-3, 2.5e-3, 24e-3, 1.348)
ROWS = ChargedRing(*RING).rows
ways = (
    st.tuples(*[st.floats(-1, 1)] * 3)
    .filter(lambda v: np.linalg.norm(v) > 0.2)
    .map(lambda v: np.array(v) / np.linalg.norm(v))
)
far = st.floats(0.05, 0.2)


def turn_to(axis):
    """Any R that turns z to `axis`: the magnets are round, nothing else of it is read."""
    R = np.full((3, 3), np.nan)
    R[:, 2] = axis
    return R


def dipole_map(p, axis, moment):
    """(6, 3) per A·m² of the electromagnet, on a point dipole."""
    K = np.empty((6, 3))
    dipole_per_ampere(moment, np.eye(3), p, turn_to(axis), K)
    return K


def ring_map(p, axis):
    """(6, 3) per A·m² of the electromagnet, on a ring magnet over a core that pulls at nothing by itself."""
    K, passive = np.empty((6, 3)), np.ones(6)
    ring_per_ampere(ROWS, np.zeros((24, 12)), 0.032, np.eye(3), p, turn_to(axis), K, passive)
    assert not passive.any()
    return K


@given(ways, far, ways)
def test_dipole_map_is_the_dipole_pair(way, distance, axis):
    p, moment = way * distance, 2.4 * axis
    K = dipole_map(p, axis, 2.4)
    force = np.stack([dipole.force(e, moment, p) for e in np.eye(3)], axis=1)
    torque = np.stack([dipole.torque(e, moment, p) for e in np.eye(3)], axis=1)
    assert np.allclose(K[:3], force, rtol=1e-12, atol=1e-14)
    assert np.allclose(K[3:], torque, rtol=1e-12, atol=1e-16)


@given(st.floats(0, np.pi), far)
def test_dipole_map_is_the_papers_equations_for_a_radial_tool(alpha, distance):
    # m_e along z, the tool above at angle α from it; e_t points away from the dipole's axis (erratum E12)
    radial = np.array([np.sin(alpha), 0, np.cos(alpha)])
    tangent = np.array([np.cos(alpha), 0, -np.sin(alpha)])
    force = dipole_map(distance * radial, radial, 2.4)[:3, 2]
    assert np.isclose(force @ radial, -3 * dipole.MU0 * 2.4 / (2 * np.pi * distance**4) * np.cos(alpha), atol=1e-12)
    assert np.isclose(force @ tangent, -3 * dipole.MU0 * 2.4 / (4 * np.pi * distance**4) * np.sin(alpha), atol=1e-12)


@given(ways, far, ways)
def test_ring_map_is_the_charged_rings(way, distance, axis):
    K = ring_map(way * distance, axis)
    truth = ChargedRing(*RING, radial=4, azimuth=24).wrench_map(rotation_to_axis(axis), way * distance)
    assert np.linalg.norm(K[:3] - truth[:3]) <= 1e-6 * np.linalg.norm(truth[:3])
    assert np.linalg.norm(K[3:] - truth[3:]) <= 1e-6 * np.linalg.norm(truth)


def test_a_tool_upside_down_has_the_opposite_map():
    p = np.array([0.01, -0.02, 0.05])
    for down in ((0, 0, -1.0), (0, 1e-9, -1.0)):
        axis = np.array(down) / np.linalg.norm(down)
        assert np.allclose(ring_map(p, axis), -ring_map(p, -axis), rtol=1e-6, atol=1e-9)


def test_a_ring_of_true_size_is_pulled_harder_than_its_dipole():
    """By 15.6 % at 50 mm over the summit (erratum E16)."""
    p, up = np.array([0, 0, 0.05]), np.array([0, 0, 1.0])
    assert round(ring_map(p, up)[2, 2] / dipole_map(p, up, 2.40624)[2, 2], 3) == 1.156
