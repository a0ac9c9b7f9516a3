"""Physical laws of every coil array's wrench map. A new array is tested by being added to ARRAYS."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haptorb.devices.base import State
from haptorb.devices.coil_array import CoilArray, MoverMagnet
from haptorb.devices.loader import load
from haptorb.devices.placed_coils import place_coils
from haptorb.magnetics.interaction import wrench
from haptorb.magnetics.magnets import CylinderMagnet, RingMagnet
from haptorb.magnetics.source import PlacedSource

TURN = Rotation.from_euler("XYZ", [25, -40, 70], degrees=True).as_matrix()
LEAN = Rotation.from_euler("XYZ", [12, -20, 30], degrees=True).as_matrix()
PLANAR, TETRAHEDRON = load("planar"), load("tetrahedron")


def two_magnets(device: CoilArray) -> CoilArray:
    """A second, smaller magnet that lies across, beside the first."""
    second = MoverMagnet(np.array([0.03, 0.0, 4e-3]), np.array([0.0, 0.6, 0.8]), 5e-3, 1e-3, 8e-3, 1.1)
    return replace(device, tool=replace(device.tool, magnets=(*device.tool.magnets, second)))


#: Each with a place of its tool near the coils.
ARRAYS = {
    "planar": (PLANAR, np.array([9e-3, -14e-3, 26e-3])),
    "tetrahedron": (TETRAHEDRON, np.array([12e-3, -7e-3, 52e-3])),
    "two magnets": (two_magnets(PLANAR), np.array([-11e-3, 4e-3, 33e-3])),
    "two magnets over a core": (two_magnets(TETRAHEDRON), np.array([-8e-3, 4e-3, 58e-3])),
}
every = pytest.mark.parametrize(("device", "at"), ARRAYS.values(), ids=ARRAYS)


def columns(device: CoilArray, p: np.ndarray, R: np.ndarray) -> np.ndarray:
    """(6, m + 1) per ampere of every coil, and passive."""
    found = device.wrench_map(State.at(p, R_SR=R), "exact")
    return np.column_stack([found.matrix, found.passive])


@pytest.mark.parametrize(
    ("z", "tolerance"), [(18.3e-3, 2e-3), (26e-3, 2e-4), (48e-3, 1e-4)], ids=["contact", "near", "far"]
)
def test_it_is_the_force_that_the_magnet_puts_on_the_coil(z: float, tolerance: float) -> None:
    """Third law, by another formulation: the closed field of the magnet on the coil's filaments."""
    p, magnet = np.array([9e-3, -14e-3, z]), PLANAR.tool.magnets[0]
    R = np.eye(3) if z < 20e-3 else LEAN
    found = columns(PLANAR, p, R)[:, :-1]
    source = PlacedSource(CylinderMagnet(magnet.outer_radius, magnet.length, magnet.remanence), p, R)
    nearest = (
        np.argsort(np.linalg.norm(PLANAR.windings.position - p, axis=1))[[0, 3]]
        if z < 20e-3
        else np.argsort(np.linalg.norm(PLANAR.windings.position - p, axis=1))[[0, 1, 3, 15]]
    )
    exact = np.array(
        [
            -wrench(
                source, placed.source, placed.position, placed.turn, about=p, precision=1e-3 if z < 20e-3 else 1e-6
            ).value
            for placed in (place_coils(PLANAR.windings)[k] for k in nearest)
        ]
    ).T
    off = found[:, nearest] - exact
    for part in (slice(0, 3), slice(3, 6)):
        assert np.abs(off[part]).max() < tolerance * np.linalg.norm(exact[part], axis=0).max()


def test_a_ring_over_a_core_feels_the_coil_itself_and_the_answer_of_the_core() -> None:
    """With hardly any permeability the core is not there; with a high one the rest is what the harmonics say of it."""
    p, magnet = ARRAYS["tetrahedron"][1], TETRAHEDRON.tool.magnets[0]
    bare = replace(TETRAHEDRON, core=None)
    source = PlacedSource(
        RingMagnet(magnet.outer_radius, magnet.inner_radius, magnet.length, magnet.remanence), p, LEAN
    )
    exact = np.array(
        [
            -wrench(source, placed.source, placed.position, placed.turn, about=p, precision=1e-6).value
            for placed in place_coils(bare.windings)
        ]
    ).T
    assert columns(bare, p, LEAN)[:, :-1] == pytest.approx(exact, abs=2e-4 * np.abs(exact[:3]).max())
    thin = replace(TETRAHEDRON, core=replace(TETRAHEDRON.core, permeability=1.0 + 1e-9))
    assert columns(thin, p, LEAN) == pytest.approx(columns(bare, p, LEAN), abs=1e-9)
    assert np.abs(columns(TETRAHEDRON, p, LEAN)[2, :-1]).max() > 1.2 * np.abs(exact[2]).max()


@every
def test_turning_coils_and_tool_turns_the_wrench(device: CoilArray, at: np.ndarray) -> None:
    coils = device.windings
    turned = replace(device, windings=replace(coils, position=coils.position @ TURN.T, axis=coils.axis @ TURN.T))
    before, after = columns(device, at, LEAN), columns(turned, TURN @ at, TURN @ LEAN)
    for part in (slice(0, 3), slice(3, 6)):
        assert after[part] == pytest.approx(TURN @ before[part], abs=1e-7 * np.abs(before[part]).max())


@every
def test_virtual_work(device: CoilArray, at: np.ndarray) -> None:
    """Force and torque are derivatives of one energy: all second derivatives are equal in both orders."""
    h, e = 2e-5, np.eye(3)
    slopes = np.empty((6, 6, device.channels + 1))
    for k in range(3):
        slopes[:, k] = (columns(device, at + h * e[k], LEAN) - columns(device, at - h * e[k], LEAN)) / (2 * h)
        there, back = (Rotation.from_rotvec(sign * 1e-3 * e[k]).as_matrix() @ LEAN for sign in (1, -1))
        slopes[:, 3 + k] = (columns(device, at, there) - columns(device, at, back)) / 2e-3
    size = np.abs(slopes).max(axis=2)
    for i in range(3):
        for k in range(6):
            scale = max(size[:3, :3].max() if k < 3 else size[:3, 3:].max(), 1e-12)
            assert slopes[i, k] == pytest.approx(slopes[k, i], abs=2e-3 * scale), (i, k)


@every
def test_no_torque_about_a_magnets_own_axis(device: CoilArray, at: np.ndarray) -> None:
    found = columns(device, at, LEAN)
    if len(device.tool.magnets) == 1:
        assert np.abs(LEAN[:, 2] @ found[3:]).max() < 1e-4 * np.abs(found[3:]).max()
    else:
        assert np.abs(LEAN[:, 2] @ found[3:]).max() > 1e-3 * np.abs(found[3:]).max()


def test_on_a_coils_axis_everything_across_is_zero() -> None:
    over = PLANAR.windings.position[5] * (1, 1, 0) + np.array([0, 0, 30e-3])
    found = columns(PLANAR, over, np.eye(3))[:, 5]
    assert np.abs(found[[0, 1, 3, 4, 5]]).max() < 1e-9 * abs(found[2])
    summit = columns(TETRAHEDRON, np.array([0.0, 0.0, 0.05]), np.eye(3))[:, 0]
    assert np.abs(summit[[0, 1, 3, 4, 5]]).max() < 1e-4 * abs(summit[2])
