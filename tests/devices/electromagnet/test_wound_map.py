"""Coils and core of true size against a computation that shares nothing with them: loops by elliptic integrals, the
core by charges within it that make its surface a surface of one potential, the magnet by charges on its faces."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy.special import ellipe, ellipk

from haptorb.arrays import Array
from haptorb.devices.base import State
from haptorb.devices.electromagnet import SphericalElectromagnet, shell_capability
from haptorb.devices.loader import load
from haptorb.errors import GeometryError, InputError

OMNI = load("omni")
#: With the windings of 5e5cc684, of which an audit's numbers are; they cross each other, and so cannot be built
CROSSING = load(Path(__file__).parent / "files" / "crossing.toml", override=True)
DEVICES = {"omni": OMNI, "omni-crossing": CROSSING}
MU0 = 4e-7 * np.pi


def loop_field(a: Array, height: Array, points: Array) -> Array:
    """(n, 3) of circular loops about z, one ampere each, summed (Smythe, §7.10)."""
    rho = np.hypot(points[:, 0], points[:, 1])[:, None]
    z = points[:, 2][:, None] - height
    square, near = (a + rho) ** 2 + z**2, (a - rho) ** 2 + z**2
    m = 4 * a * rho / square
    first, second = ellipk(m), ellipe(m)
    scale = MU0 / (2 * np.pi * np.sqrt(square))
    axial = scale * (first + (a * a - rho**2 - z**2) / near * second)
    across = scale * z / rho * (-first + (a * a + rho**2 + z**2) / near * second)
    radial, b_z = across.sum(axis=1), axial.sum(axis=1)
    unit = points[:, :2] / rho
    return np.column_stack([radial[:, None] * unit, b_z])


def spread_points(count: int) -> Array:
    """(count, 3) unit vectors, evenly (Fibonacci)."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    return np.column_stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])


def charge_field(places: Array, charges: Array, points: Array) -> Array:
    apart = points[:, None] - places
    return np.einsum("n,pni->pi", charges, apart / np.linalg.norm(apart, axis=2)[..., None] ** 3)


class MadeCoil(NamedTuple):
    radii: Array  #: of its filaments [m]
    heights: Array
    charges: Array  #: in the core, µ0/4π times them
    places: Array
    turns: float  #: of a filament
    factor: float  #: to the moment of the file


@cache
def make_coil(name: str, number: int) -> MadeCoil:
    w = DEVICES[name].windings
    assert w is not None
    middle, half = (w.inner_radius + w.outer_radius)[number] / 2, (w.outer_radius - w.inner_radius)[number] / 2
    fine = 25  # equal loops: the section is filled evenly, seen from the core, which may be a millimetre away
    even = (2 * np.arange(fine) + 1) / fine - 1
    radii, heights = np.meshgrid(middle + half * even, w.length[number] / 2 * even)
    turns = w.turns[number] / fine**2
    surface, places = OMNI.core_radius * spread_points(1600), 0.8 * OMNI.core_radius * spread_points(700)
    normal = surface / OMNI.core_radius

    def across(field: Array) -> Array:
        return (field - np.einsum("pi,pi->p", field, normal)[:, None] * normal).ravel()

    own = turns * loop_field(radii.ravel(), heights.ravel(), surface)
    apart = surface[:, None] - places
    unit = apart / np.linalg.norm(apart, axis=2)[..., None] ** 3
    matrix = np.stack([across(unit[:, n]) for n in range(len(places))], axis=1)
    matrix = np.vstack([matrix, np.full(len(places), 1e3 * np.abs(matrix).max())])  # no net charge
    wanted = np.append(-across(own), 0.0)
    charges = np.linalg.lstsq(matrix, wanted, rcond=1e-12)[0]
    assert np.linalg.norm(matrix @ charges - wanted) < 1e-3 * np.linalg.norm(wanted)
    moment = turns * np.pi * (radii**2).sum() + (charges @ places)[2] * 4 * np.pi / MU0
    size = float(np.linalg.norm(OMNI.moment_per_current[:, number]))
    return MadeCoil(radii.ravel(), heights.ravel(), charges, places, float(turns), size / moment)


def independent_map(name: str, state: State) -> Array:
    """(6, 3) [N/A, N·m/A]."""
    tool = OMNI.tool
    node, weight = np.polynomial.legendre.leggauss(6)
    inner, outer = tool.inner_radius**2, tool.outer_radius**2
    rho = np.sqrt(inner + (outer - inner) * (node + 1) / 2)
    turn = 2 * np.pi * np.arange(18) / 18
    face = np.pi * (outer - inner) * tool.remanence / MU0
    x, y = np.outer(rho, np.cos(turn)).ravel(), np.outer(rho, np.sin(turn)).ravel()
    q = np.repeat(weight / 2, len(turn)) * face / len(turn)
    up = np.column_stack([x, y, np.full(len(x), tool.length / 2)])
    arms = np.vstack([up, up * [1, 1, -1]]) @ state.R_SR.T
    q = np.concatenate([q, -q])
    out = np.empty((6, 3))
    for number in range(3):
        coil = make_coil(name, number)
        axis = OMNI.moment_per_current[:, number] / np.linalg.norm(OMNI.moment_per_current[:, number])
        first = np.cross(axis, [1.0, 2.0, 3.0])
        first /= np.linalg.norm(first)
        frame = np.column_stack([first, np.cross(axis, first), axis])
        at = (state.p + arms) @ frame
        field = coil.turns * loop_field(coil.radii, coil.heights, at) + charge_field(coil.places, coil.charges, at)
        forces = coil.factor * q[:, None] * (field @ frame.T)
        out[:3, number], out[3:, number] = forces.sum(axis=0), np.cross(arms, forces).sum(axis=0)
    return out


@pytest.mark.parametrize(
    ("name", "distance"),
    [("omni", 50e-3), ("omni", 55e-3), ("omni", 60e-3), ("omni", 70e-3), ("omni-crossing", 50e-3)],
)
def test_the_wrench_of_windings_core_and_ring(name: str, distance: float) -> None:
    """Force within 1 % of its vector, torque within 1 % of the coil's greatest at that distance."""
    rng = np.random.default_rng(int(1e3 * distance))
    found, expected = [], []
    for _ in range(6):
        u = rng.normal(size=3) * [1.0, 1.0, 0.3] + [0.0, 0.0, 1.0]
        u /= np.linalg.norm(u)
        lean = np.cross(u, rng.normal(size=3))
        state = State.at(distance * u, u + np.tan(np.radians(rng.uniform(0, 30))) * lean / np.linalg.norm(lean))
        found.append(DEVICES[name].wound_map(state).matrix)
        expected.append(independent_map(name, state))
    got, true = np.array(found), np.array(expected)
    size = np.linalg.norm(true[:, :3], axis=1)
    assert (np.linalg.norm(got[:, :3] - true[:, :3], axis=1) < 0.01 * size).all()
    most = np.linalg.norm(true[:, 3:], axis=1).max(axis=0)
    assert (np.linalg.norm(got[:, 3:] - true[:, 3:], axis=1) < 0.01 * most).all()


def test_in_contact_over_the_summit_a_coil_gives_two_thirds_of_what_points_say() -> None:
    """An audit's numbers for the windings of 5e5cc684: 39.1 mN/A, where point coils have 58.4."""
    touching = State.at((0, 0, 50e-3))
    assert 1e3 * CROSSING.wound_map(touching).force[2, 2] == pytest.approx(-39.1, abs=0.1)
    assert 1e3 * OMNI.wound_map(touching).force[2, 2] == pytest.approx(-38.8, abs=0.1)
    assert 1e3 * OMNI.wrench_map(touching, "exact").force[2, 2] == pytest.approx(-58.4, abs=0.05)


def test_far_away_coils_are_points_and_the_card_states_the_error_nearby() -> None:
    far = State.at((0.3, 0.4, 0.5), (1, 0, 1))
    assert OMNI.wound_map(far).force == pytest.approx(OMNI.wrench_map(far, "exact").force, rel=0.01, abs=1e-9)
    for device, near, end in ((CROSSING, 0.32, 0.147), (OMNI, 0.27, 0.13)):
        errors = [layer.coil_error for layer in shell_capability(device).layers]
        assert errors == sorted(errors, reverse=True)  # type: ignore[type-var]
        assert errors[0] == pytest.approx(near, abs=0.01)
        assert errors[-1] == pytest.approx(end, abs=0.005)


def test_what_it_does_not_know_it_refuses() -> None:
    with pytest.raises(GeometryError, match="inside the dome"):
        OMNI.wound_map(State.at((0, 0, 40e-3)))
    unknown: SphericalElectromagnet = replace(OMNI, windings=None)
    assert not unknown.has_sizes
    assert shell_capability(unknown, points=5).layers[0].coil_error is None
    with pytest.raises(InputError, match=r"no \[windings\]"):
        unknown.wound_map(State.at((0, 0, 50e-3)))
