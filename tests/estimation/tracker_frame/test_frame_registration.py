"""Registration of a tracker's frame: recovered for any frame, body and noise; common mistakes are named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from haptorb.devices.loader import load
from haptorb.errors import CalibrationError, InputError
from haptorb.estimation.frame_registration import (
    FrameFit,
    Touches,
    TouchSession,
    find_roll,
    find_unobservable,
    fit_points,
    frame_registration,
    pivot,
    sphere,
)
from haptorb.simulation.synthetic_tracker import SimulatedPerson, SyntheticTracker

OMNI = load("omni")
UP = OMNI.tool.tip_distance


def session(seed: int, noise: float = 1e-4, **person: float) -> tuple[SyntheticTracker, TouchSession]:
    tracker = SyntheticTracker.draw(seed, noise, noise * np.deg2rad(0.5) / 1e-3)
    return tracker, SimulatedPerson(OMNI, tracker, seed, **person).session()


def change_touches(touched: TouchSession, change: Callable[[Touches], Touches]) -> TouchSession:
    return TouchSession(
        change(touched.dome), {name: change(one) for name, one in touched.marks.items()}, change(touched.roll)
    )


def error_of(found, tracker: SyntheticTracker, seed: int) -> tuple[float, float]:
    """Of the magnet over the dome, rms [m], and of its axis, greatest [rad]; by poses without noise."""
    still = replace(tracker, noise=0.0, turning=0.0)
    seen = SimulatedPerson(OMNI, still, seed + 1).dome(150)
    true = seen.point(tracker.tip + UP * tracker.axis) @ tracker.R.T + tracker.t
    told = seen.point(found.tip + UP * found.axis) @ found.R.T + found.t
    axes, meant = tracker.R @ seen.R @ tracker.axis, found.R @ seen.R @ found.axis
    angle = np.arctan2(np.linalg.norm(np.cross(axes, meant), axis=1), (axes * meant).sum(axis=1))
    return float(np.sqrt(((true - told) ** 2).sum(axis=1).mean())), float(angle.max())


@given(st.integers(0, 10**6), st.floats(0.0, 2e-4))
@settings(max_examples=30, deadline=None)
def test_any_frame_and_body_is_found_to_a_quarter_millimetre_and_half_a_degree(seed: int, noise: float) -> None:
    tracker, touched = session(seed, noise)
    found = frame_registration(touched, OMNI)
    place, angle = error_of(found, tracker, seed)
    assert place < 0.25e-3
    assert angle < np.deg2rad(0.5)
    assert place < 3.0 * found.position + 1e-5  # what it says of itself
    assert angle < 3.0 * found.direction
    assert found.residual < 2.5 * noise + 2e-5
    assert found.excluded > 0  # the tip was lifted now and then
    assert abs(found.radius - OMNI.dome_radius) < 1e-3


@given(st.integers(0, 10**6))
@settings(max_examples=8, deadline=None)
def test_two_formulations_agree(seed: int) -> None:
    """Steps on the frame in the stator, against another's least squares with the centre in the tracker's frame."""
    _, touched = session(seed)
    found = frame_registration(touched, OMNI)
    stands = [touched.marks[name] for name in OMNI.marks.names]
    start = pivot(stands)
    R0, t0, _ = fit_points(start.places, OMNI.marks.positions)
    centre = sphere(touched.dome.point(start.tip))[0]
    dome = touched.dome.select(np.abs(np.linalg.norm(touched.dome.point(found.tip) + found.R.T @ found.t, axis=1)
                                    - OMNI.dome_radius) < 0.6e-3)  # fmt: skip
    q0 = Rotation.from_matrix(R0.T)

    def residuals(u: np.ndarray) -> np.ndarray:
        c, a, turn = u[:3] + centre, u[3:6] + start.tip, q0 * Rotation.from_mrp(u[6:])
        far = np.linalg.norm(dome.point(a) - c, axis=1) - OMNI.dome_radius
        wanted = turn.apply(OMNI.marks.positions) + c
        near = [one.point(a) - place for one, place in zip(stands, wanted, strict=True)]
        return np.concatenate([far, np.concatenate(near).ravel()])

    other = least_squares(residuals, np.zeros(9), x_scale=[1e-3] * 6 + [1e-2] * 3, xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    R = (q0 * Rotation.from_mrp(other[6:])).inv().as_matrix()
    assert np.abs(other[3:6] + start.tip - found.tip).max() < 3e-5
    assert np.abs(-R @ (other[:3] + centre) - found.t).max() < 3e-4  # a metre from the origin
    assert Rotation.from_matrix(R @ found.R.T).magnitude() < 2e-4
    # and both closed forms by themselves tell of the same centre and the same turn
    assert np.linalg.norm(centre + R0.T @ t0) < 1e-3
    assert Rotation.from_matrix(R0 @ found.R.T).magnitude() < np.deg2rad(1.0)


def test_axis_of_the_roll_agrees_with_the_turns_between_poses() -> None:
    tracker, touched = session(5)
    roll = touched.roll
    turns = Rotation.from_matrix(np.swapaxes(roll.R[:1], -1, -2) @ roll.R).as_rotvec()
    far = turns[np.linalg.norm(turns, axis=1) > 1.0]
    other = np.linalg.svd(far)[2][0]
    axis = find_roll(roll).axis
    assert np.abs(np.abs(axis @ other)) > np.cos(np.deg2rad(0.5))
    assert np.abs(axis @ tracker.axis) > np.cos(np.deg2rad(0.5))


def test_the_dome_alone_leaves_the_rotation_free_and_it_is_named() -> None:
    _, touched = session(3)
    found = frame_registration(touched, OMNI)
    fit = FrameFit(touched, OMNI.marks.names, OMNI.marks.positions, OMNI.dome_radius, found.R, found.t, found.tip)
    _, J = fit.equations()
    assert find_unobservable(J)[1] == ()
    condition, unseen = find_unobservable(J[: len(touched.dome)])
    assert unseen == ("turn about x", "turn about y", "turn about z")
    assert condition > 1e9
    one_mark = J[: len(touched.dome) + 3 * len(touched.marks["front"])]
    assert "turn about x" in find_unobservable(one_mark)[1]  # the frame still turns about that mark's radius


def test_the_jacobian_is_that_of_the_residuals() -> None:
    _, touched = session(11)
    found = frame_registration(touched, OMNI)

    def at(u: np.ndarray) -> np.ndarray:
        turn = Rotation.from_rotvec(u[:3] / OMNI.dome_radius).as_matrix()
        fit = FrameFit(touched, OMNI.marks.names, OMNI.marks.positions, OMNI.dome_radius,
                   turn @ found.R, turn @ found.t + u[3:6], found.tip + u[6:])  # fmt: skip
        return fit.equations()[0]

    fit = FrameFit(touched, OMNI.marks.names, OMNI.marks.positions, OMNI.dome_radius, found.R, found.t, found.tip)
    J = fit.equations()[1]
    h = 1e-6
    numeric = np.column_stack([(at(h * e) - at(-h * e)) / (2 * h) for e in np.eye(9)])
    assert np.abs(J - numeric).max() < 1e-5


# what people mix up


def mirror(one: Touches) -> Touches:
    return Touches(one.p * [-1, 1, 1], one.q * [1, -1, -1, 1])


MIXED_UP: dict[str, tuple[Callable[[Touches], Touches], str]] = {
    "millimetres": (lambda one: Touches(1e3 * one.p, one.q), r"reports millimetres: the marks appear \d+\.?\d* times"),
    "centimetres": (lambda one: Touches(1e2 * one.p, one.q), "centimetres"),
    "inches": (lambda one: Touches(one.p / 0.0254, one.q), "inches"),
    "scaled": (lambda one: Touches(1.07 * one.p, one.q), r"out of scale: the marks appear 1\.0[67]\d* times"),
    "left-handed": (mirror, "left-handed.*send −x with the quaternion x −y −z w"),
    "w first": (lambda one: Touches(one.p, one.q[:, [3, 0, 1, 2]]), "w came first"),
    "inverse": (lambda one: Touches(one.p, one.q * [-1, -1, -1, 1]), "turned the other way"),
    "loose": (lambda one: Touches(one.p + 0.02 * np.sin(np.arange(len(one)))[:, None], one.q), "no tip fits"),
}


@pytest.mark.parametrize("name", MIXED_UP)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_people_mix_up_is_named(name: str, seed: int) -> None:
    change, told = MIXED_UP[name]
    _, touched = session(seed)
    with pytest.raises(CalibrationError, match=told):
        frame_registration(change_touches(touched, change), OMNI)


def test_marks_in_another_order_are_named() -> None:
    _, touched = session(4)
    front, left, rear = (touched.marks[name] for name in OMNI.marks.names)
    with pytest.raises(CalibrationError, match="another order: 'left' instead of 'front', 'front' instead of 'left'"):
        frame_registration(replace(touched, marks={"front": left, "left": front, "rear": rear}), OMNI)
    with pytest.raises(
        CalibrationError, match=r"'left' instead of 'front'.*'rear' instead of 'left'.*'front' instead of 'rear'"
    ):
        frame_registration(replace(touched, marks={"front": left, "left": rear, "rear": front}), OMNI)


def test_too_little_is_refused_with_what_to_do() -> None:
    _, touched = session(6)
    few = replace(touched, dome=touched.dome.select(np.arange(len(touched.dome)) % 10 == 0))
    with pytest.raises(CalibrationError, match="only 24 distinct poses on the dome; at least 30"):
        frame_registration(few, OMNI)
    with pytest.raises(CalibrationError, match="mark 'left' was not touched; all of front, left, rear"):
        frame_registration(replace(touched, marks={"front": touched.marks["front"]}), OMNI)
    _, near = session(6, reach=0.3)
    with pytest.raises(CalibrationError, match=r"all within \d+° of one point: the dome's centre is not"):
        frame_registration(near, OMNI)
    _, upright = session(6, tilt=np.deg2rad(2.0))
    with pytest.raises(CalibrationError, match=r"tilted by no more than .*Tilt by 20°"):
        frame_registration(upright, OMNI)
    _, still = session(6, turn=0.1)
    with pytest.raises(CalibrationError, match=r"rolled by only 3\d°"):
        frame_registration(still, OMNI)


def test_a_moved_device_another_dome_and_a_tip_in_the_air_are_refused() -> None:
    _, touched = session(7)
    n = len(touched.dome)
    moved = replace(touched, dome=Touches(touched.dome.p + np.array([0.02, 0.0, 0.0]), touched.dome.q))
    with pytest.raises(CalibrationError, match=r"centre is 20\.\d mm from its place"):
        frame_registration(moved, OMNI)
    with pytest.raises(CalibrationError, match=r"sphere of 30\.0 mm; the device's dome has 33 mm"):
        frame_registration(touched, replace(OMNI, dome_radius=0.033))
    shaken = touched.dome.p + np.where(np.arange(n) % 3, 0.0, 0.02)[:, None] * np.random.default_rng(1).normal(
        size=(n, 3)
    )
    with pytest.raises(CalibrationError, match="of the touches on the dome are not on it"):
        frame_registration(replace(touched, dome=Touches(shaken, touched.dome.q)), OMNI)


def test_numbers_that_are_none_and_turns_that_are_none_are_refused() -> None:
    with pytest.raises(InputError, match="must be finite"):
        Touches.of([[0.0, np.nan, 0.0]], [[0.0, 0.0, 0.0, 1.0]], "step 'dome'")
    with pytest.raises(CalibrationError, match=r"step 'dome'.*length 1; one has 57"):
        Touches.of([[0.0, 0.0, 0.0]], [[0.0, 0.0, 57.0, 1.0]], "step 'dome'")


def test_a_device_without_marks_says_that_its_rotation_would_be_free() -> None:
    _, touched = session(8)
    with pytest.raises(InputError, match=r"no \[marks\]; the dome alone leaves the frame's rotation free"):
        frame_registration(touched, replace(OMNI, marks=None))
