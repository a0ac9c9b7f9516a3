"""Coils and core of true size against an independent computation (`oracles.wound_coils`)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from haptorb.devices.base import State
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.electromagnet_capability import shell_capability
from haptorb.devices.loader import load
from haptorb.errors import UnknownName
from oracles import wound_coils

OMNI = load("omni")
#: With the windings of 5e5cc684, of which an audit's numbers are; they cross each other, and so cannot be built
CROSSING = load(Path(__file__).parent / "files" / "crossing.toml", override=True)
DEVICES = {"omni": OMNI, "omni-crossing": CROSSING}


@pytest.mark.parametrize("name", DEVICES)
@pytest.mark.parametrize("distance", [50e-3, 55e-3, 60e-3, 70e-3])
def test_the_wrench_of_windings_core_and_ring(name: str, distance: float) -> None:
    """Force within 1 % of its vector, torque within 1 % of the coil's greatest at that distance: 200 places in all."""
    rng = np.random.default_rng(int(1e3 * distance))
    found, expected = [], []
    for _ in range(50):
        u = rng.normal(size=3) * [1.0, 1.0, 0.3] + [0.0, 0.0, 1.0]
        u /= np.linalg.norm(u)
        lean = np.cross(u, rng.normal(size=3))
        state = State.at(distance * u, u + np.tan(np.radians(rng.uniform(0, 30))) * lean / np.linalg.norm(lean))
        found.append(DEVICES[name].wrench_map(state, "exact").matrix)
        expected.append(wound_coils.wrench_map(DEVICES[name], state))
    got, true = np.array(found), np.array(expected)
    size = np.linalg.norm(true[:, :3], axis=1)
    assert (np.linalg.norm(got[:, :3] - true[:, :3], axis=1) < 0.01 * size).all()
    most = np.linalg.norm(true[:, 3:], axis=1).max(axis=0)
    assert (np.linalg.norm(got[:, 3:] - true[:, 3:], axis=1) < 0.01 * most).all()


def test_the_field_at_the_sensors_and_within_the_dome() -> None:
    places = np.vstack([OMNI.hall.positions, [[0.0, 0.0, 0.03], [0.004, -0.024, 0.017]]])
    true = wound_coils.coil_fields(OMNI, places)
    assert np.abs(OMNI.coil_fields(places) - true).max(axis=(1, 2)) == pytest.approx(0, abs=2e-3 * np.abs(true).max())
    for coil, sensor in ((0, 0), (1, 2), (2, 4)):  # where the printed moments were measured: on the coils' axes, 55 mm
        axial = np.abs(true[sensor, coil, coil])
        moment = OMNI.moment_per_current[coil, coil]
        assert axial == pytest.approx(2e-7 * moment / 0.055**3, rel=1e-3)


def test_in_contact_over_the_summit_a_coil_gives_two_thirds_of_what_points_say() -> None:
    """An audit's numbers for the windings of 5e5cc684 with the printed moments far away: 39.1 mN/A for 58.4."""
    touching = State.at((0, 0, 50e-3))
    far: SphericalElectromagnet = replace(CROSSING, moments_at=np.inf)
    assert 1e3 * far.wrench_map(touching, "exact").force[2, 2] == pytest.approx(-39.1, abs=0.1)
    assert 1e3 * OMNI.wrench_map(touching, "point-coils").force[2, 2] == pytest.approx(-58.4, abs=0.05)
    # with the printed field at 55 mm it is four fifths
    ratio = [one.wrench_map(touching, "exact").force[2, 2] / -58.394e-3 for one in (CROSSING, OMNI)]
    assert ratio == pytest.approx([0.803, 0.794], abs=1e-3)


def test_far_away_coils_are_points_of_their_far_moments_and_the_card_states_the_error_nearby() -> None:
    far = State.at((0.3, 0.4, 0.5), (1, 0, 1))
    points = replace(OMNI, moment_per_current=OMNI.far_moments)
    assert OMNI.wrench_map(far, "exact").force == pytest.approx(
        points.wrench_map(far, "point-coils").force, rel=0.01, abs=1e-9
    )
    audited = replace(CROSSING, moments_at=np.inf)
    for device, near, end in ((audited, 0.32, 0.147), (CROSSING, 0.372, 0.210), (OMNI, 0.304, 0.177)):
        errors = [layer.coil_error for layer in shell_capability(device).layers]
        assert errors[0] == pytest.approx(near, abs=0.01)
        assert errors[-1] == pytest.approx(end, abs=0.005)


def test_what_would_be_inside_the_dome_counts_as_on_it() -> None:
    """A tracker's pose may be anything: the map stays what it is at the dome, and does not diverge."""
    within, at = (OMNI.wrench_map(State.at((0, 0, z)), "exact").matrix for z in (28e-3, 42e-3))
    assert np.abs(within).max() < 3 * np.abs(at).max()


def test_without_sizes_there_is_no_exact_model() -> None:
    unknown: SphericalElectromagnet = replace(OMNI, windings=None)
    assert not unknown.has_sizes
    assert unknown.models == ("point-coils", "published")
    assert shell_capability(unknown, points=5).layers[0].coil_error is None
    with pytest.raises(UnknownName, match="point-coils, published"):
        unknown.wrench_map(State.at((0, 0, 50e-3)), "exact")
