"""Ring as charges: against the closed-form ring, convergence, and the finite size of erratum E16."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from haptorb.errors import GeometryError, InputError
from haptorb.magnetics import dipole
from haptorb.magnetics.magnets import ChargedRing, RingMagnet

RING = (6e-3, 2.5e-3, 24e-3, 1.348)
turns = st.tuples(*[st.floats(-3, 3)] * 3).map(lambda v: Rotation.from_rotvec(v).as_matrix())
directions = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.2)


def at(direction, distance):
    return np.array(direction) / np.linalg.norm(direction) * distance


@given(turns, directions, st.floats(0.05, 0.12), directions)
@example(np.eye(3), (0.0, 1.0, 0.0), 0.0625, (1.0, 0.0, 0.0))
def test_wrench_is_the_reaction_to_the_exact_rings_field(R, direction, distance, moment):
    p, m = at(direction, distance), np.array(moment)
    ring = RingMagnet(*RING)
    there = R.T @ -p  # the dipole, seen from the ring
    b = R @ ring.field(there)
    slope = R @ ring.field_gradient(there) @ R.T
    force = -slope.T @ m  # the dipole is pulled by ∇(m·B), the ring by the opposite
    torque = -np.cross(m, b) - np.cross(p, force)  # both together turn nothing about the origin
    wrench = ChargedRing(*RING).wrench_map(R, p) @ m
    size = np.linalg.norm(slope) * np.linalg.norm(m)  # of a force that need not vanish, as it does for some ways of m
    assert np.linalg.norm(wrench[:3] - force) <= 2e-6 * size
    assert np.linalg.norm(wrench[3:] - torque) <= 2e-6 * (np.linalg.norm(torque) + 0.05 * size)


@pytest.mark.parametrize(("distance", "excess"), [(0.05, 0.156), (0.06, 0.107), (0.07, 0.078)])
def test_finite_size_is_what_erratum_16_says(distance, excess):
    ring = ChargedRing(*RING)
    exact = ring.wrench_map(np.eye(3), (0, 0, distance))[2, 2]
    point = dipole.force((0, 0, 1.0), ring.moment, (0, 0, distance))[2]
    assert exact / point - 1 == pytest.approx(excess, abs=5e-4)


@pytest.mark.parametrize(("radial", "azimuth", "error"), [(1, 6, 1e-2), (2, 8, 1e-6), (3, 12, 1e-9)])
def test_more_points_converge(radial, azimuth, error):
    rng = np.random.default_rng(4)
    coarse = ChargedRing(*RING, radial=radial, azimuth=azimuth)
    fine = ChargedRing(*RING, radial=6, azimuth=32)
    worst = 0.0
    for _ in range(50):
        R, p = Rotation.random(random_state=rng).as_matrix(), at(rng.normal(size=3), 0.05)
        truth = fine.wrench_map(R, p)
        worst = max(worst, np.linalg.norm(coarse.wrench_map(R, p) - truth) / np.linalg.norm(truth))
    assert error / 1e3 < worst < error


@given(turns, directions, st.floats(1.0, 3.0))
def test_far_away_it_is_a_point_dipole(R, direction, distance):
    p = at(direction, distance)
    ring = ChargedRing(*RING)
    moment = R @ ring.moment
    forces = np.stack([dipole.force(e, moment, p) for e in np.eye(3)], axis=1)
    torques = np.stack([dipole.torque(e, moment, p) for e in np.eye(3)], axis=1)
    wrench = ring.wrench_map(R, p)
    assert np.abs(wrench[:3] - forces).max() <= 2e-3 * np.abs(forces).max()
    assert np.abs(wrench[3:] - torques).max() <= 2e-3 * np.abs(torques).max()


def test_field_and_gradient_are_the_exact_rings_outside():
    rng = np.random.default_rng(5)
    points = rng.normal(size=(40, 3))
    points *= (rng.uniform(0.03, 0.1, 40) / np.linalg.norm(points, axis=1))[:, None]
    exact, ring = RingMagnet(*RING), ChargedRing(*RING, radial=3, azimuth=16)
    assert np.allclose(ring.field(points), exact.field(points), rtol=0, atol=1e-7)
    assert np.allclose(ring.field_gradient(points), exact.field_gradient(points), rtol=0, atol=1e-5)
    assert not ring.contains(points).any()
    assert ring.contains((4e-3, 0, 0))
    assert not ring.contains((0, 0, 0))  # the hole


def test_charges_add_up_to_nothing_and_the_moment_is_exact_for_any_number_of_points():
    for radial, azimuth in ((1, 3), (2, 8), (5, 30)):
        ring = ChargedRing(*RING, radial=radial, azimuth=azimuth)
        assert abs(ring.charges.sum()) < 1e-12 * np.abs(ring.charges).sum()
        assert np.allclose(ring.moment, RingMagnet(*RING).moment, rtol=1e-13, atol=0)
        assert np.allclose(ring.points.T @ ring.charges, ring.moment, atol=1e-15)


def test_the_other_polarity_turns_every_force_round():
    there = (0.01, 0.02, 0.05)
    one, other = ChargedRing(*RING), ChargedRing(*RING[:3], -RING[3])
    assert np.array_equal(one.wrench_map(np.eye(3), there), -other.wrench_map(np.eye(3), there))


@pytest.mark.parametrize(
    "bad", [(2e-3, 3e-3, 1e-2, 1.0), (3e-3, -1e-3, 1e-2, 1.0), (3e-3, 1e-3, 0.0, 1.0), (np.nan, 0.0, 1e-2, 1.0)]
)
def test_impossible_rings_are_refused(bad):
    with pytest.raises(InputError):
        ChargedRing(*bad)


def test_too_few_points_and_bad_poses_are_refused():
    with pytest.raises(InputError, match="3 azimuth steps"):
        ChargedRing(*RING, azimuth=2)
    with pytest.raises(InputError, match="rotation"):
        ChargedRing(*RING).wrench_map(2 * np.eye(3), (0, 0, 0.05))
    with pytest.raises(GeometryError):
        ChargedRing(1e-3, 2e-3, 1e-2, 1.0)
