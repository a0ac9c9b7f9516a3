"""Tabulated attraction of the core: as exact as its series, conservative, no torque about the core."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haptorb.devices.base import rotation_to_axis
from haptorb.devices.loader import load
from haptorb.errors import GeometryError, InputError, PrecisionError
from haptorb.magnetics.core_attraction import PassivePull
from haptorb.magnetics.magnets import ChargedRing
from haptorb.magnetics.soft_sphere import SoftSphere
from oracles.repetitions import repetitions

OMNI = {
    "core_radius": 15e-3,
    "core_permeability": np.inf,
    "outer_radius": 6e-3,
    "inner_radius": 2.5e-3,
    "length": 24e-3,
    "remanence": 1.348,
    "nearest": 32e-3,
}
FINE = ChargedRing(6e-3, 2.5e-3, 24e-3, 1.348, radial=4, azimuth=20)
CORE = SoftSphere(15e-3)
PEAK = 52.85e-3  #: the pull at contact [N]
ways = (
    st.tuples(*[st.floats(-1, 1)] * 3)
    .filter(lambda v: np.linalg.norm(v) > 0.2)
    .map(lambda v: np.array(v) / np.linalg.norm(v))
)


@cache
def tabulate(remanence=1.348):
    """The Omni's pull: a table that is made, and code that is compiled, when the first test wants it."""
    return PassivePull(**OMNI | {"remanence": remanence})


def series(p, axis, sphere=CORE):
    points, q = FINE.place(rotation_to_axis(axis), p)
    forces = sphere.forces(points, q)
    return np.concatenate([forces.sum(axis=0), np.cross(points - p, forces).sum(axis=0)])


@settings(max_examples=repetitions(13, 40))
@given(ways, st.floats(0.033, 0.2), ways)
def test_the_table_is_the_series(way, distance, axis):
    error = tabulate().wrench(way * distance, axis) - series(way * distance, axis)
    assert np.linalg.norm(error[:3]) <= 1e-4 * PEAK
    assert np.linalg.norm(error[3:]) <= 1e-4 * PEAK * 0.05


@pytest.mark.parametrize(("distance", "pull"), [(0.05, 52.85), (0.06, 12.25), (0.07, 3.74)])
def test_the_pull_of_erratum_18(distance, pull):
    assert -1e3 * tabulate().wrench(np.array([0, 0, distance]), np.array([0, 0, 1.0]))[2] == pytest.approx(
        pull, abs=0.01
    )


@given(ways, st.floats(0.02, 0.3), ways)
def test_a_sphere_cannot_be_turned(way, distance, axis):
    p = way * distance
    wrench = tabulate().wrench(p, axis)
    size = np.linalg.norm(wrench[:3]) * distance + np.linalg.norm(wrench[3:])
    assert np.abs(np.cross(p, wrench[:3]) + wrench[3:]).max() <= 1e-12 * (size + 1e-6)


@given(ways, st.floats(0.034, 0.2), ways, ways)
def test_force_and_torque_are_the_slopes_of_one_energy(way, distance, axis, about):
    p, wrench = way * distance, tabulate().wrench(way * distance, axis)
    h = 1e-4 * distance

    def slope(function, step):
        return (8 * (function(step) - function(-step)) - (function(2 * step) - function(-2 * step))) / (12 * step)

    size = np.linalg.norm(wrench[:3]) + 1e-12
    for i, e in enumerate(np.eye(3)):
        assert slope(lambda s, e=e: -tabulate().energy(p + s * e, axis), h) == pytest.approx(wrench[i], abs=1e-6 * size)

    def turn_axis(angle):  # Rodrigues
        across = np.cross(about, axis)
        return axis * np.cos(angle) + across * np.sin(angle) + about * (about @ axis) * (1 - np.cos(angle))

    turning = slope(lambda s: -tabulate().energy(p, turn_axis(s)), 1e-3)
    assert turning == pytest.approx(wrench[3:] @ about, abs=1e-6 * size * distance)


@given(ways, st.floats(0.034, 0.2), ways)
def test_polarity_does_not_matter(way, distance, axis):
    p = way * distance
    assert np.array_equal(tabulate().wrench(p, axis), tabulate().wrench(p, -axis))
    assert np.allclose(tabulate().wrench(p, axis), tabulate(-1.348).wrench(p, axis), rtol=1e-12, atol=1e-18)


def test_a_closed_path_takes_no_energy():
    """Once around a loop that goes near, tilts, goes away and tilts back: the work of the wrench is zero."""
    turn = np.linspace(0, 2 * np.pi, 4001)
    work, scale = 0.0, 0.0

    def pose(t):
        d = 0.05 + 0.01 * np.cos(t)
        axis = np.array([np.sin(0.8 * np.sin(t)), 0.2 * np.cos(2 * t), np.cos(0.8 * np.sin(t))])
        return np.array([d * np.sin(0.3 * np.sin(2 * t)), 0, d]), axis / np.linalg.norm(axis)

    for a, b in pairwise(turn):
        (p, n), (p1, n1), (p2, n2) = pose((a + b) / 2), pose(a), pose(b)
        wrench = tabulate().wrench(p, n)
        step = wrench[:3] @ (p2 - p1) + wrench[3:] @ np.cross(n, n2 - n1)
        work, scale = work + step, scale + abs(step)
    assert abs(work) < 1e-6 * scale


def test_nearer_than_the_table_the_radial_pull_ends_and_nothing_explodes():
    axis = np.array([0.0, 0.6, 0.8])
    for d in (31.9e-3, 20e-3, 1e-4):
        wrench = tabulate().wrench(np.array([0, 0, d]), axis)
        assert np.isfinite(wrench).all()
        assert wrench[2] == 0.0
    assert tabulate().energy(np.array([0, 0, 0.02]), axis) == pytest.approx(
        tabulate().energy(np.array([0, 0, 0.032]), axis)
    )


@pytest.mark.parametrize("permeability", [1.0, 3.0, 200.0, 5000.0])
def test_finite_permeability(permeability):
    pull = PassivePull(**{**OMNI, "core_permeability": permeability})
    p, axis = np.array([0.01, 0.02, 0.045]), rotation_to_axis((0.4, 0.1, 1.0))[:, 2]
    truth = series(p, axis, SoftSphere(15e-3, permeability))
    assert np.allclose(pull.wrench(p, axis), truth, rtol=0, atol=1e-5 * PEAK)


def test_the_device_has_it():
    omni = load("omni")
    assert -1e3 * omni.passive_pull.wrench(np.array([0, 0, 0.05]), np.array([0, 0, 1.0]))[2] == pytest.approx(
        52.85, abs=0.3
    )


def test_bad_input_is_refused():
    with pytest.raises(GeometryError, match="air between"):
        PassivePull(**{**OMNI, "nearest": 27e-3})
    with pytest.raises(PrecisionError, match="further"):
        PassivePull(**{**OMNI, "nearest": 27.3e-3})
    with pytest.raises(InputError):
        PassivePull(**{**OMNI, "nearest": np.nan})
    with pytest.raises(InputError):
        PassivePull(**{**OMNI, "remanence": np.inf})
    with pytest.raises(GeometryError):
        PassivePull(**{**OMNI, "core_radius": -15e-3})
