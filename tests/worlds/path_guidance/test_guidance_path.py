"""Paths: length, points on them, and rejected ones."""

import numpy as np
import pytest

from haptorb.devices.loader import load
from haptorb.errors import InputError, UnknownName
from haptorb.worlds.path import SHAPES, load_path, make_path, make_shape


def on_dome(tilt_deg, turn_deg, radius=0.05):
    tilt, turn = np.radians(tilt_deg), np.radians(turn_deg)
    return radius * np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])


@pytest.mark.parametrize("name", SHAPES)
def test_every_shape_lies_on_the_sphere_in_even_steps(name):
    path = make_shape(name, 30.0)
    steps = np.linalg.norm(np.diff(path.places, axis=0), axis=1)
    assert np.allclose(np.linalg.norm(path.places, axis=1), 0.05, atol=2e-6)
    assert np.ptp(steps) < 0.3 * path.spacing
    assert abs(steps.sum() / path.length - 1) < 2e-3
    path.check(load("omni"))


def test_lengths_are_those_of_geometry():
    assert make_shape("line", 25.0).length == pytest.approx(0.05 * np.radians(50.0), rel=1e-4)
    assert make_shape("circle", 25.0).length == pytest.approx(2 * np.pi * 0.05 * np.sin(np.radians(25.0)), rel=1e-4)


def test_a_smooth_path_goes_through_its_points_on_the_dome():
    points = [on_dome(20, turn) for turn in (0, 60, 130, 200)]
    path = make_path(points)
    assert max(np.linalg.norm(path.places - point, axis=1).min() for point in points) < 0.15e-3
    assert np.allclose(np.linalg.norm(path.places, axis=1), 0.05, atol=1e-6)
    assert not path.closed
    assert make_path(points, closed=True).closed


def test_an_arc_length_finds_its_place():
    path = make_shape("line", 20.0)
    assert np.allclose(path.find_place(path.length / 2), (0, 0, 0.05), atol=1e-6)
    assert np.allclose(path.find_place(-1.0), path.places[0])
    assert np.allclose(path.find_place(9.0), path.places[-1])


def test_a_path_that_crosses_itself_is_refused_with_the_place():
    points = [on_dome(20, 0), on_dome(20, 180), on_dome(28, 240), on_dome(20, 90), on_dome(20, 270)]
    with pytest.raises(InputError, match=r"crosses itself.*mm along it.*Move its points apart"):
        make_path(points, smooth=False)


def test_a_path_beyond_the_workspace_is_refused_with_the_place():
    with pytest.raises(InputError, match=r"outside the workspace; keep every point within 60 deg"):
        make_shape("line", 70.0).check(load("omni"))
    with pytest.raises(InputError, match=r"inside the dome"):
        make_shape("circle", 25.0, 0.04).check(load("omni"))
    with pytest.raises(InputError, match=r"above the shell"):
        make_shape("circle", 25.0, 0.09).check(load("omni"))
    with pytest.raises(InputError, match=r"'pmsm' has none: choose omni"):
        make_shape("circle").check(load("pmsm"))


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([(0, 0, 0.05)], "at least two points"),
        ([(0, 0, 0.05), (0, 0, 0.05), (0.02, 0, 0.05)], "points 1 and 2 of the path are equal"),
        ([(0, 0, 0.05), (0, 0, np.nan)], "must be finite"),
        ([(0, 0, 50.0), (0, 20.0, 50.0)], "in metres"),
        ([(0, 0, 0), (0, 0.02, 0.05)], "centre"),
        ([(0, 0, 0.05), (0, 1e-4, 0.05)], "5 mm to 2 m"),
        ("circle", "must be numbers"),
        ([(0, 1), (1, 2)], "3-vectors"),
    ],
)
def test_points_that_make_no_path_are_refused(points, message):
    with pytest.raises(InputError, match=message):
        make_path(points)


def test_an_unknown_shape_is_refused():
    with pytest.raises(UnknownName):
        make_shape("triangle")


def test_a_file_gives_the_path_of_its_points(tmp_path):
    file = tmp_path / "path.csv"
    file.write_text("x_mm, y_mm, z_mm\n-10,0,49\n0,0,50\n\n10,0,49\n")
    assert load_path(file).length == pytest.approx(0.0203, rel=0.02)
    file.write_text("\ufeffx_mm,y_mm,z_mm\r\n-10,0,49\r\n0,0,50\r\n10,0,49\r\n", encoding="utf-8")  # as Excel writes it
    assert load_path(file).length == pytest.approx(0.0203, rel=0.02)
    for text, message in (
        ("x,y,z\n", "line 1: the header must be"),
        ("x_mm,y_mm,z_mm\n1,2\n", "line 2: expected three numbers"),
        ("x_mm,y_mm,z_mm\n1,2,50\n1,nan,50\n", "line 3: expected three numbers"),
        ("x_mm,y_mm,z_mm\n1,2,50\n", "at least two points"),
        ("", "an empty file"),
    ):
        file.write_text(text)
        with pytest.raises(InputError, match=message):
            load_path(file)
    with pytest.raises(InputError, match=r"none\.csv"):
        load_path(tmp_path / "none.csv")
