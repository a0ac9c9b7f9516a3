"""Motor with tolerances: tables against quadrature of its bodies, its draws, and energy over rotation."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haptorb.devices.base import rotation_to_axis
from haptorb.devices.loader import load
from haptorb.devices.motor_layout import Layout
from haptorb.errors import GeometryError
from haptorb.rotations import rotation_from_euler
from haptorb.simulation.motor import SimulatedMotor
from haptorb.simulation.motor_specimen import draw_motor, fill_field, fill_torque

MOTORS = {name: load(name) for name in ("pmsm", "pmsm-three-rings")}
PMSM = MOTORS["pmsm"]
TURNS = [rotation_from_euler(*one) for one in ((0.3, -0.2, 1.0), (-0.05, 0.38, 4.0), (0.0, 0.1, 2.5))]
_SEGMENTS = 72


def per_ampere(built, R, groups=None):
    """(3, m) [N·m/A] torque of the tables per ampere in each channel, or in each group of coils (c, m)."""
    truth = built.compile()
    if groups is not None:
        truth = truth._replace(groups=groups)
    out = np.empty((3, truth.groups.shape[1]))
    fill_torque(truth, built.strength, R, out)
    return out


def sensed(built, R):
    out = np.empty((built.device.sensors, 3))
    fill_field(built.compile(), built.strength, R, out)
    return out


def magnets_field(built, R, points):
    """(n, 3) [T] closed form of every magnet where it is, instead of charges and tables."""
    total = np.zeros_like(points)
    for place, axis, strength in zip(built.magnet_places, built.magnet_axes, built.strength, strict=True):
        own = R @ rotation_to_axis(axis)
        total += strength * built.device.magnet.field((points - R @ place) @ own) @ own.T
    return total


def quadrature(built, R, number):
    """(3,) [N·m/A] on the rotor: the magnets' field along every turn of one coil, and the third law."""
    radii, heights, turns = built.turns[number]
    angle = 2 * np.pi * (np.arange(_SEGMENTS) + 0.5) / _SEGMENTS
    cosine, sine, step = np.cos(angle), np.sin(angle), 2 * np.pi / _SEGMENTS * radii * turns
    rim = np.stack([np.outer(radii, cosine), np.outer(radii, sine), np.repeat(heights[:, None], _SEGMENTS, 1)], -1)
    along = np.stack([-np.outer(step, sine), np.outer(step, cosine), np.zeros_like(rim[..., 0])], -1)
    frame = rotation_to_axis(built.coil_axes[number])
    points = rim.reshape(-1, 3) @ frame.T + built.coil_places[number]
    force = np.cross(along.reshape(-1, 3) @ frame.T, magnets_field(built, R, points))
    return -np.cross(points, force).sum(axis=0)


@pytest.mark.parametrize("name", MOTORS)
def test_without_tolerances_turns_and_charges_give_the_exact_model(name):
    """Which integrates the magnets' closed form (its table errs by 1e-8): 1e-6 of the greatest torque, 2 µT."""
    device = replace(MOTORS[name], tolerance=None)
    built, R = draw_motor(device), np.array(TURNS)
    exact = device.torque_characteristic(R, "table") @ device.groups
    found = np.array([per_ampere(built, one) for one in R])
    assert np.abs(found - exact).max() < 1e-6 * np.abs(exact).max()
    field = np.array([sensed(built, one) for one in R])
    assert np.abs(field - device.sensor_field(R, "table")).max() < 2e-6
    coils = built.compile().coil_field
    assert coils == pytest.approx(device.sensor_field_per_ampere, abs=1e-5 * np.abs(coils).max())
    assert built.tilt_torque == pytest.approx(device.tilt_torque[0], abs=1e-6)
    assert built.least == device.tilt_torque[1]


@pytest.mark.parametrize("specimen", [pytest.param(0, marks=pytest.mark.slow), 5])
def test_a_drawn_motor_is_computed_as_it_is_drawn(specimen):
    """Every turn and every magnet where it is: the tables leave 5e-4 of the greatest torque, of what differs by 5 %."""
    built, R = draw_motor(PMSM, specimen), TURNS[specimen % 2]
    found, nominal = per_ampere(built, R, np.eye(24)), PMSM.torque_characteristic(R[None], "table")[0]
    greatest = np.abs(nominal).max()
    strong = np.argsort(np.linalg.norm(nominal, axis=0))[[-1, -6]]
    for number in strong.tolist():
        assert np.abs(found[:, number] - quadrature(built, R, number)).max() < 5e-4 * greatest
    assert np.abs(found - nominal).max() > 0.02 * greatest
    true = magnets_field(built, R, built.sensor_places)
    assert np.abs(sensed(built, R) - true).max() < 4e-5
    assert np.abs(PMSM.sensor_field(R[None], "table")[0] - true).max() > 2e-3


def test_turning_round_gains_nothing():
    """The torque per ampere is the gradient of one flux: around a closed path of orientations it does no work."""
    built, count = draw_motor(PMSM, 3), 600
    t = 2 * np.pi * np.arange(count + 1) / count
    path = Rotation.from_euler("XYZ", np.stack([0.3 * np.sin(t), 0.25 * np.cos(t) - 0.1, 0.6 * np.sin(2 * t)], axis=1))
    middle = path[:-1] * Rotation.from_rotvec(0.5 * (path[:-1].inv() * path[1:]).as_rotvec())
    step = (path[1:] * path[:-1].inv()).as_rotvec()
    truth, K = built.compile(), np.empty((3, 12))
    work, size = np.zeros(12), np.zeros(12)
    for R, turned in zip(middle.as_matrix(), step, strict=True):
        fill_torque(truth, built.strength, np.ascontiguousarray(R), K)
        work += turned @ K
        size += np.abs(turned @ K)
    assert (np.abs(work) < 2e-4 * size).all()


def test_what_is_drawn_lies_within_the_tolerances_and_none_is_like_another():
    drawn = [draw_motor(PMSM, specimen) for specimen in range(12)]
    allowed, known, most = PMSM.tolerance, PMSM.uncertainty, np.sqrt(3.0) * (1 + 1e-9)
    shift = np.array([one.magnet_places - PMSM.magnets.positions for one in drawn])
    assert 0.9 * most * allowed.magnet_position < np.abs(shift).max() <= most * allowed.magnet_position
    for axes, nominal, tilt in (
        ("magnet_axes", PMSM.magnets.directions, allowed.magnet_tilt),
        ("coil_axes", PMSM.electromagnets.directions, allowed.tilt),
    ):
        lean = np.array([np.cross(nominal, getattr(one, axes)) for one in drawn])
        assert 0.8 * most * tilt < np.abs(lean).max() <= np.sqrt(2) * most * tilt
    common = np.array([np.abs(one.strength).mean() - 1 for one in drawn])
    assert 0.5 * most * known.polarization < np.abs(common).max() <= most * 1.3 * known.polarization
    turns = np.array([[coil[2].sum() for coil in one.turns] for one in drawn])
    assert 1.0 < np.abs(turns - PMSM.electromagnet.turns).max() < 39
    edges = np.array([[coil[0].min() for coil in one.turns] for one in drawn])
    assert 2e-4 < np.ptp(edges) < 2 * most * allowed.winding
    assert len({one.coil_places.tobytes() for one in drawn}) == 12
    again = draw_motor(PMSM, 4)
    assert again.compile().torque_cells.tobytes() == drawn[4].compile().torque_cells.tobytes()


def test_nobody_builds_parts_that_touch():
    """Where the tolerances are as large as the gap, what is drawn takes less than half of it."""
    coarse = replace(PMSM, tolerance=PMSM.tolerance.model_copy(update={"position": 2e-3, "winding": 2e-3}))
    face = PMSM.magnets.distance - 0.5 * PMSM.magnet.length
    gap = face - np.hypot(
        PMSM.electromagnets.distance + 0.5 * PMSM.electromagnet.length, PMSM.electromagnet.outer_radius
    )
    for specimen in range(5):
        built = draw_motor(coarse, specimen)
        for place, (radii, heights, _) in zip(built.coil_places, built.turns, strict=True):
            assert face - np.hypot(radii, np.linalg.norm(place) + heights).max() > 0.55 * gap
    wide = replace(PMSM, electromagnets=Layout(60e-3, PMSM.electromagnets.directions))
    with pytest.raises(GeometryError, match="no gap between coils and magnets"):
        draw_motor(wide)


def test_the_seed_chooses_the_motor():
    def read(seed):
        motor = SimulatedMotor(PMSM, seed)
        for _ in range(20):
            motor.advance(1e-3, np.full(12, 0.2), np.zeros(3), np.array([0.0, 0.1, 0.0, 0.995]))
        return motor.wrench_actual().tobytes(), motor.sample(0.0, 0.0, True).field.tobytes()

    one = read(4)
    assert one == read(4)
    assert one[0] != read(5)[0]
