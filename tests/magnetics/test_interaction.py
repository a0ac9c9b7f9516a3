"""Forces and torques: published values, a second formulation, virtual work, and error bounds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haptorb.devices.base import rotation_to_axis
from haptorb.devices.tables import torque_table
from haptorb.errors import GeometryError, InputError, PrecisionError
from haptorb.magnetics import dipole
from haptorb.magnetics.coil import Coil
from haptorb.magnetics.dipole import Dipole
from haptorb.magnetics.interaction import wrench
from haptorb.magnetics.magnets import CylinderMagnet, RingMagnet
from haptorb.magnetics.source import PlacedSource
from oracles.magnetics.exact_level import exact_sensor_field, exact_torque_characteristic
from oracles.magnetics.formulations import flux_linkage, wrench_on_charges
from oracles.magnetics.source_sum import SourceSum

MAGNET = CylinderMagnet(15.875e-3, 5.08e-3, 1.31)
COIL = Coil(1000, 0.3 * 15.88e-3, 15.88e-3, 7.62e-3)
OPPOSED = np.diag([1.0, -1.0, -1.0])
TILT = Rotation.from_euler("XYZ", [15, -20, 40], degrees=True).as_matrix()
ASIDE = np.array([8e-3, -5e-3, 18e-3])


@pytest.mark.parametrize(
    ("first", "second", "newton"),
    [
        ((20, 40), (20, 40), 265.537148),
        ((20, 40), (15, 30), 111.489646),
        ((20, 20), (20, 10), 18.952637),
    ],
    ids=str,
)
@pytest.mark.parametrize("formulation", [wrench, wrench_on_charges])
def test_published_force_between_coaxial_magnets(formulation, first, second, newton):
    """Radius/height in mm, 1.3 T, opposed, centres 50 mm apart: to all printed digits."""
    one = CylinderMagnet(first[0] * 1e-3, first[1] * 1e-3, 1.3)
    other = CylinderMagnet(second[0] * 1e-3, second[1] * 1e-3, 1.3)
    push = formulation(one, other, (0, 0, 50e-3), OPPOSED, precision=1e-9)
    assert push.value[2] == pytest.approx(newton, abs=5.1e-7)
    assert push.bound[2] < 5e-7
    assert np.abs(push.value[[0, 1, 3, 4, 5]]).max() < 1e-9


def inverse_pose(position, turn):
    return -turn.T @ position, turn.T


def test_coil_torque_converges_and_the_second_formulation_confirms_it():
    """Field of the magnet over the coil's filaments against field of the coil over the magnet's charged discs."""
    close = wrench(MAGNET, COIL, ASIDE, TILT, precision=1e-8)
    closer = wrench(MAGNET, COIL, ASIDE, TILT, precision=1e-11)
    assert np.linalg.norm(close.value[3:] - closer.value[3:]) < 1e-8 * np.linalg.norm(closer.value[3:])
    place, turn = inverse_pose(ASIDE, TILT)
    charges = wrench_on_charges(COIL, MAGNET, place, turn, about=place, precision=1e-6)
    # third law, in the magnet's frame: force opposite, and torque about the magnet's centre opposite
    on_coil = wrench(MAGNET, COIL, ASIDE, TILT, about=(0, 0, 0), precision=1e-9).value
    assert TILT @ charges.value[:3] == pytest.approx(-on_coil[:3], rel=3e-6, abs=3e-6 * np.linalg.norm(on_coil[:3]))
    assert TILT @ charges.value[3:] == pytest.approx(-on_coil[3:], rel=3e-6, abs=3e-6 * np.linalg.norm(on_coil[3:]))


@pytest.mark.parametrize("precision", [1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize(
    ("target", "position"), [(COIL, ASIDE), (MAGNET, ASIDE), (RingMagnet(12e-3, 5e-3, 8e-3, 1.2), (3e-3, 0, 12e-3))]
)
def test_the_bound_holds(target, position, precision):
    found = wrench(MAGNET, target, position, TILT if target is not MAGNET else OPPOSED, precision=precision)
    true = wrench(MAGNET, target, position, TILT if target is not MAGNET else OPPOSED, precision=1e-10)
    for part in (slice(0, 3), slice(3, 6)):
        assert np.linalg.norm(found.value[part] - true.value[part]) <= found.bound[part].max() + true.bound[part].max()


def test_virtual_work_force_and_torque_are_derivatives_of_the_flux_linkage():
    """On the magnet, at one ampere: F = ∂λ/∂x, T = ∂λ/∂θ; on the coil the opposite."""
    h = 1e-5
    on_coil = wrench(MAGNET, COIL, ASIDE, TILT, about=(0, 0, 0), precision=1e-10).value

    def linkage(shift=(0.0, 0.0, 0.0), spin=(0.0, 0.0, 0.0)):
        turn = Rotation.from_rotvec(spin).as_matrix()
        return flux_linkage(PlacedSource(MAGNET, shift, turn), COIL, ASIDE, TILT, precision=1e-11).value[0]

    force = [(linkage(h * e) - linkage(-h * e)) / (2 * h) for e in np.eye(3)]
    torque = [(linkage(spin=h * e) - linkage(spin=-h * e)) / (2 * h) for e in np.eye(3)]
    assert -on_coil[:3] == pytest.approx(force, rel=1e-5, abs=1e-6 * np.abs(force).max())
    assert -on_coil[3:] == pytest.approx(torque, rel=1e-5, abs=1e-6 * np.abs(torque).max())


def test_far_apart_everything_is_a_dipole():
    place = np.array([0.5, -0.9, 0.7])
    found = wrench(MAGNET, COIL, place, TILT, precision=1e-8).value
    moment = TILT @ COIL.moment
    assert found[:3] == pytest.approx(dipole.force(MAGNET.moment, moment, place), rel=3e-3)
    assert found[3:] == pytest.approx(dipole.torque(MAGNET.moment, moment, place), rel=3e-3)


def test_no_torque_about_the_targets_own_axis():
    for target in (COIL, MAGNET):
        found = wrench(PlacedSource(MAGNET, (0, 0, 0), TILT), target, (5e-3, 9e-3, 25e-3), TILT.T, precision=1e-7)
        assert abs(found.value[3:] @ TILT.T[:, 2]) < 1e-14 * np.linalg.norm(found.value[3:]) + 1e-16


def test_torque_about_another_point_differs_by_arm_times_force():
    here = wrench(MAGNET, COIL, ASIDE, TILT).value
    there = wrench(MAGNET, COIL, ASIDE, TILT, about=(0, 0, 0)).value
    assert there[3:] == pytest.approx(here[3:] + np.cross(ASIDE, here[:3]), rel=1e-6)


def test_overlapping_bodies_have_no_force():
    with pytest.raises(GeometryError, match="overlap"):
        wrench(MAGNET, COIL, (0, 0, 4e-3), np.eye(3))
    with pytest.raises(GeometryError, match="overlap"):
        flux_linkage(MAGNET, COIL, (0, 0, 4e-3), np.eye(3))


def test_precision_out_of_reach_tells_the_best_that_was_reached():
    touching = (MAGNET.length + COIL.length) / 2 + 1e-7
    with pytest.raises(PrecisionError, match=r"converged to [0-9.e-]+ relative, not to 1\.0e-12"):
        wrench(MAGNET, COIL, (4e-3, 0, touching), np.eye(3), precision=1e-12)


@pytest.mark.parametrize("precision", [0, -1, 1, np.nan])
def test_precision_that_is_none_is_refused(precision):
    with pytest.raises(InputError, match="precision"):
        wrench(MAGNET, COIL, ASIDE, TILT, precision=precision)


def test_poses_that_are_none_are_refused():
    with pytest.raises(InputError, match="not a rotation"):
        wrench(MAGNET, COIL, ASIDE, 1.1 * TILT)
    with pytest.raises(InputError, match="reflection"):
        wrench(MAGNET, COIL, ASIDE, -np.eye(3))
    with pytest.raises(InputError, match="one pose"):
        wrench(MAGNET, COIL, [ASIDE, ASIDE], TILT)
    with pytest.raises(InputError, match="one place"):
        PlacedSource(MAGNET, [ASIDE, ASIDE], TILT)


def test_exact_level_needs_no_symmetry_and_agrees_with_the_table_where_there_is_some():
    u, c = np.array([0.6, 0.0, 0.8]), np.array([0.28, 0.1, 0.95])
    c /= np.linalg.norm(c)
    rotor = SourceSum([PlacedSource(MAGNET, 67.9e-3 * u, rotation_to_axis(u))])
    coil = PlacedSource(COIL, 56.8e-3 * c, rotation_to_axis(c))
    spun = Rotation.from_euler("XYZ", [3, 2, 1], degrees=True).as_matrix()
    K = exact_torque_characteristic(rotor, [coil, coil], np.array([np.eye(3), spun]))
    assert K.value.shape == K.bound.shape == (2, 3, 2)
    table = torque_table(MAGNET, 67.9e-3, COIL, 56.8e-3, precision=1e-6)
    for R, found in zip((np.eye(3), spun), K.value, strict=True):
        k = table.values(np.array(R @ u @ c))[0][0]
        assert found[:, 0] == pytest.approx(k * np.cross(R @ u, c), abs=2e-6)
    lean = Rotation.from_rotvec([0.05, 0, 0]).as_matrix()
    leaning = PlacedSource(COIL, 56.8e-3 * c + [1e-3, 0, 0], rotation_to_axis(c) @ lean)
    assert np.abs(exact_torque_characteristic(rotor, [leaning], np.eye(3)).value - K.value[0, :, :1]).max() > 1e-3
    with pytest.raises(InputError, match="coil 1 must be a winding"):
        exact_torque_characteristic(rotor, [PlacedSource(Dipole((0, 0, 1)), c, np.eye(3))], np.eye(3))


def test_exact_sensor_field_is_that_of_the_turned_magnets():
    axes = np.array([[0, 0, 1.0], [1, 0, 0]])
    rotor = SourceSum([PlacedSource(MAGNET, 67.9e-3 * u, rotation_to_axis(u)) for u in axes])
    sensors = np.array([[0, 0, 62.4e-3], [40e-3, 0, 48e-3]])
    turned = PlacedSource(rotor, (0, 0, 0), TILT)
    found = exact_sensor_field(rotor, sensors, np.array([np.eye(3), TILT]))
    assert found[0] == pytest.approx(rotor.field(sensors))
    assert found[1] == pytest.approx(turned.field(sensors))
    with pytest.raises(GeometryError, match=r"sensor 1 .* inside a magnet"):
        exact_sensor_field(rotor, [[0, 0, 67.9e-3]], np.eye(3))
