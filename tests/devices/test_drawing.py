"""Plane sections of round parts: areas by formulas of solid geometry, points by the part's definition."""

from __future__ import annotations

import numpy as np
import pytest

from haptorb.devices.drawing import SectionPlane, cut_part, draw_section, split_poles
from haptorb.devices.geometry import RoundPart
from haptorb.devices.loader import parse


def part(position=(0, 0, 0), axis=(0, 0, 1), inner=1.0, outer=2.0, length=3.0):
    axis = np.array(axis, dtype=float)
    return RoundPart("a", "coil", np.array(position, float), axis / np.linalg.norm(axis), inner, outer, length)


def area(outlines):
    """Of all outlines, their holes subtracted."""
    total = 0.0
    for outline in outlines:
        sizes = [abs(np.sum(loop[:, 0] * np.roll(loop[:, 1], -1) - loop[:, 1] * np.roll(loop[:, 0], -1))) / 2
                 for loop in outline]  # fmt: skip
        total += sizes[0] - sum(sizes[1:])
    return total


def test_along_its_axis_a_ring_is_two_rectangles():
    outlines = cut_part(part(), SectionPlane())
    assert len(outlines) == 2
    assert area(outlines) == pytest.approx(2 * 1.0 * 3.0)
    assert np.concatenate([outline[0] for outline in outlines]).max(axis=0) == pytest.approx([2.0, 1.5])


def test_across_its_axis_a_ring_is_a_ring():
    outlines = cut_part(part(axis=(0, 1, 0)), SectionPlane())
    assert len(outlines) == 1
    assert area(outlines) == pytest.approx(np.pi * (2.0**2 - 1.0**2), rel=2e-3)


def test_a_plane_beside_it_cuts_nothing():
    assert cut_part(part(position=(0, 2.1, 0)), SectionPlane()) == []
    assert cut_part(part(position=(0, 1.6, 0), axis=(0, 1, 0)), SectionPlane()) == []


def test_a_plane_beside_the_hole_cuts_one_rectangle():
    outlines = cut_part(part(position=(0, 1.2, 0)), SectionPlane())
    assert area(outlines) == pytest.approx(3.0 * 2 * np.sqrt(2.0**2 - 1.2**2))


@pytest.mark.parametrize("azimuth", [0.0, 2.0])
@pytest.mark.parametrize("trial", range(5))
def test_an_oblique_section_has_the_area_that_points_say(azimuth, trial):
    """Against counting points of a fine grid on the plane by the part's own definition."""
    rng = np.random.default_rng(trial)
    body = part(rng.uniform(-1.2, 1.2, 3), rng.normal(size=3))
    plane = SectionPlane(azimuth)
    side = np.linspace(-5, 5, 401)
    u, v = np.meshgrid(side, side)
    points = u[..., None] * plane.axes[0] + v[..., None] * plane.axes[1] - body.position
    height = points @ body.axis
    distance = np.linalg.norm(points - height[..., None] * body.axis, axis=-1)
    counted = ((np.abs(height) <= 1.5) & (distance <= 2) & (distance >= 1)).sum() * (side[1] - side[0]) ** 2
    assert area(cut_part(body, plane)) == pytest.approx(counted, rel=0.015, abs=0.05)


def test_the_north_half_is_at_the_end_that_the_polarity_says():
    magnet = RoundPart("m", "magnet", np.zeros(3), np.array([1.0, 0, 0]), 0.0, 1.0, 4.0, polarity=-1.0)
    north, south = split_poles(magnet)
    assert north.position == pytest.approx([-1, 0, 0])
    assert south.position == pytest.approx([1, 0, 0])
    assert north.length == 2.0


@pytest.mark.parametrize(("text", "wall"), [("", 1.5), ('[dome]\nwall = "1.2 mm"', 1.2), ('drop = ["dome.wall"]', 0.0)])
def test_the_wall_of_the_dome_is_drawn_as_thick_as_it_is(text, wall):
    from matplotlib.figure import Figure
    from matplotlib.patches import Annulus

    device = parse(f'based_on = "omni"\nname = "own"\n{text}', "own")
    axes = Figure().add_subplot()
    draw_section(axes, device.geometry(), SectionPlane())
    rings = [patch for patch in axes.patches if isinstance(patch, Annulus)]
    assert [(ring.radii[0], ring.width) for ring in rings] == ([pytest.approx((30.0, wall))] if wall else [])
