"""Series of the sphere against mirror charges, a numerical solution, and the numbers of erratum E18."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from haptorb.errors import GeometryError, InputError, PrecisionError
from haptorb.magnetics.dipole import MU0
from haptorb.magnetics.magnets import ChargedRing
from haptorb.magnetics.soft_sphere import SoftSphere

A = 15e-3
RING = ChargedRing(6e-3, 2.5e-3, 24e-3, 1.348, radial=3, azimuth=12)
outside = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.2)


def charge_field(q, s, x):
    """Field at x of a charge q at s, from first principles."""
    arm = np.asarray(x) - s
    return MU0 / (4 * np.pi) * q * arm / np.linalg.norm(arm) ** 3


@given(outside, st.floats(1.05, 6.0), outside, st.floats(1.05, 6.0))
def test_infinite_permeability_is_a_mirror_charge_and_its_balance(s_way, s_far, x_way, x_far):
    s, x = (np.array(way) / np.linalg.norm(way) * A * far for way, far in ((s_way, s_far), (x_way, x_far)))
    d = np.linalg.norm(s)
    mirrored = charge_field(-A / d, s * A**2 / d**2, x) + charge_field(A / d, np.zeros(3), x)
    series = SoftSphere(A).compute_induced_field([s], [1.0], x, precision=1e-13)
    assert np.allclose(series, mirrored, rtol=1e-9, atol=1e-12 * np.linalg.norm(charge_field(1.0, s, np.zeros(3))))


def collocation_field(mu, s, x):
    """Field at x of a sphere of radius 1 near a unit charge at s, by fundamental solutions: no harmonics anywhere.

    Sources inside stand for the answer outside, sources outside for the field inside; potential and normal flux are
    matched at points of the surface by least squares.
    """

    def spread(count, radius):
        k = np.arange(count) + 0.5
        z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
        rho = np.sqrt(1 - z * z)
        return radius * np.stack([rho * np.cos(turn), rho * np.sin(turn), z], axis=1)

    def potential(sources, points):
        return 1 / np.linalg.norm(points[:, None] - sources, axis=2)

    def normal(sources, points):
        arm = points[:, None] - sources
        return -(arm * points[:, None]).sum(axis=2) / np.linalg.norm(arm, axis=2) ** 3

    wall, inner, outer = spread(700, 1.0), spread(260, 0.62), spread(260, 1.55)
    charge = np.array([s])
    matrix = np.block(
        [[potential(inner, wall), -potential(outer, wall)], [normal(inner, wall), -mu * normal(outer, wall)]]
    )
    right = -np.concatenate([potential(charge, wall)[:, 0], normal(charge, wall)[:, 0]])
    weight = np.concatenate([np.ones(len(wall)), np.full(len(wall), 1 / max(mu, 1.0))])
    matrix, right = matrix * weight[:, None], right * weight
    no_charge = np.concatenate([np.ones(len(inner)), np.zeros(len(outer))])  # iron has no net magnetic charge
    matrix, right = np.vstack([matrix, len(wall) * no_charge]), np.append(right, 0.0)
    strengths = np.linalg.lstsq(matrix, right, rcond=1e-13)[0][: len(inner)]
    arm = np.asarray(x)[:, None] - inner
    return MU0 / (4 * np.pi) * np.einsum("kn,kni->ki", strengths / np.linalg.norm(arm, axis=2) ** 3, arm)


@pytest.mark.parametrize("mu", [0.0, 1.5, 5.0, 40.0, 1000.0])
def test_finite_permeability_against_a_numerical_solution(mu):
    s, scale = np.array([0.4, -0.3, 1.7]), MU0 / (4 * np.pi)
    x = [[0.2, 0.1, 1.6], [1.5, 0.3, -0.2], [-0.4, 0.3, -2.0]]
    series = SoftSphere(1.0, mu).compute_induced_field([s], [1.0], x, precision=1e-12)
    assert np.allclose(series, collocation_field(mu, s, x), rtol=0, atol=2e-4 * scale)


def test_no_sphere_no_answer():
    where, q = RING.place(np.eye(3), (0, 0, 0.05))
    assert SoftSphere(A, 1.0).energy(where, q) == 0.0
    assert not SoftSphere(A, 1.0).forces(where, q).any()
    assert not SoftSphere(A, 1.0).moment_in((0, 0, 1.0)).any()


@pytest.mark.parametrize(("distance", "pull"), [(0.05, 52.9), (0.06, 12.25), (0.07, 3.74)])
def test_the_core_pulls_the_ring_as_erratum_18_says(distance, pull):
    force = SoftSphere(A).forces(*RING.place(np.eye(3), (0, 0, distance))).sum(axis=0)
    assert -1e3 * force[2] == pytest.approx(pull, abs=0.06)
    assert np.abs(force[:2]).max() < 1e-12


def test_a_point_dipoles_first_harmonic_alone_would_say_30():
    m, d = RING.moment[2], 0.05
    field_at_centre = MU0 / (4 * np.pi) * 2 * m / d**3
    energy = -0.5 * SoftSphere(A).moment_in((0, 0, field_at_centre))[2] * field_at_centre  # ∝ d⁻⁶
    assert 1e3 * -6 * energy / d == pytest.approx(30.0, abs=0.05)
    # two charges close together are that dipole
    gap = 1e-5
    points = [(0, 0, d + gap / 2), (0, 0, d - gap / 2)]
    first = SoftSphere(A).energy_by_degree(points, [m / gap, -m / gap])[0]
    assert first == pytest.approx(energy, rel=1e-6)


@settings(max_examples=30)
@given(outside, st.floats(0.034, 0.1), st.tuples(*[st.floats(-3, 3)] * 3))
def test_force_and_torque_are_slopes_of_the_energy(way, distance, turn):
    sphere, R = SoftSphere(A, 200.0), Rotation.from_rotvec(turn).as_matrix()
    p = np.array(way) / np.linalg.norm(way) * distance
    points, q = RING.place(R, p)
    forces = sphere.forces(points, q)
    size = np.linalg.norm(forces, axis=1).max()

    def energy(shift, spin=(0.0, 0.0, 0.0)):
        placed = (points - p) @ Rotation.from_rotvec(spin).as_matrix().T + p + shift
        return sphere.energy(placed, q, precision=1e-13)

    def slope(function, h):
        return -(8 * (function(h) - function(-h)) - (function(2 * h) - function(-2 * h))) / (12 * h)

    total, torque = forces.sum(axis=0), np.cross(points - p, forces).sum(axis=0)
    for i, e in enumerate(np.eye(3)):
        assert slope(lambda h, e=e: energy(h * e), 3e-5) == pytest.approx(total[i], rel=1e-6, abs=1e-6 * size)
        turned = slope(lambda h, e=e: energy(0 * e, h * e), 3e-3)
        assert turned == pytest.approx(torque[i], rel=1e-6, abs=1e-6 * size * 0.012)
    # a sphere cannot be turned: nothing about its own centre
    assert np.abs(np.cross(points, forces).sum(axis=0)).max() < 1e-9 * size * distance


def test_iron_pulls_and_a_superconductor_pushes():
    where, q = RING.place(np.eye(3), (0, 0, 0.05))
    pulls = [SoftSphere(A, mu).forces(where, q).sum(axis=0)[2] for mu in (0.0, 1.0, 2.0, 10.0, 1000.0, np.inf)]
    assert pulls[0] > 0.0 == pulls[1]
    assert pulls == sorted(pulls, reverse=True)
    assert pulls[-2] == pytest.approx(pulls[-1], rel=4e-3)


def test_induced_moment_is_the_far_field():
    where, q = RING.place(Rotation.from_rotvec((0.4, 0.2, 0)).as_matrix(), (0.02, 0.01, 0.05))
    sphere = SoftSphere(A, 300.0)
    at_centre = sum(charge_field(charge, place, np.zeros(3)) for charge, place in zip(q, where, strict=True))
    moment, far = sphere.moment_in(at_centre), np.array([1.0, -2.0, 2.0])
    d = np.linalg.norm(far)
    dipole_field = MU0 / (4 * np.pi) * (3 * (moment @ far) * far / d**2 - moment) / d**3
    assert np.allclose(
        sphere.compute_induced_field(where, q, far), dipole_field, rtol=0, atol=2e-2 * np.abs(dipole_field).max()
    )


def test_terms_left_out_are_below_the_precision():
    where, q = RING.place(np.eye(3), (0, 0, 0.034))
    truth = SoftSphere(A).energy(where, q, precision=1e-14)
    assert abs(SoftSphere(A).energy(where, q, precision=1e-6) / truth - 1) < 1e-6


def test_bad_input_is_refused():
    with pytest.raises(GeometryError, match="positive"):
        SoftSphere(-1e-3)
    with pytest.raises(InputError, match="permeability"):
        SoftSphere(A, np.nan)
    with pytest.raises(InputError, match="permeability"):
        SoftSphere(A, -2.0)
    with pytest.raises(GeometryError, match="lies in or on the sphere"):
        SoftSphere(A).energy([(0, 0, 0.01)], [1.0])
    with pytest.raises(GeometryError, match="inside"):
        SoftSphere(A).compute_induced_field([(0, 0, 0.1)], [1.0], (0, 0, 0.01))
    with pytest.raises(PrecisionError, match="terms"):
        SoftSphere(A).energy([(0, 0, A * 1.0001)], [1.0])
    with pytest.raises(InputError, match="one charge per point"):
        SoftSphere(A).forces([(0, 0, 0.1)], [1.0, 2.0])
    with pytest.raises(InputError):
        SoftSphere(A).forces([(0, 0, np.inf)], [1.0])
    assert SoftSphere(A).compute_induced_field([(0, 0, 0.1)], [1.0], np.empty((0, 3))).shape == (0, 3)
