"""Cylinder and ring magnets against an integral that shares only the Biot–Savart law with the closed form."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haptorb.errors import GeometryError, InputError
from haptorb.magnetics import dipole
from haptorb.magnetics.magnets import CylinderMagnet, RingMagnet
from haptorb.magnetics.source import RoundBody
from oracles.repetitions import repetitions

MAGNET = CylinderMagnet(15.875e-3, 5.08e-3, 1.31)
RING = RingMagnet(outer_radius=6e-3, inner_radius=2.5e-3, length=24e-3, polarization=1.348)


def wall_integral(
    radius: float, length: float, polarization: float, points: np.ndarray, steps: int = 4096
) -> np.ndarray:
    """B of the bound current on a side wall, integrated exactly along the axis and by equal steps around.

    The integrand is periodic, so the sum converges exponentially: a millimetre from these walls 4096 steps are exact
    to rounding.
    """
    steps = 4096
    angle = 2 * np.pi * np.arange(steps) / steps
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = points[:, 0:1] - radius * cosine, points[:, 1:2] - radius * sine
    up, down = points[:, 2:3] + length / 2, points[:, 2:3] - length / 2
    flat2 = x**2 + y**2
    a, b = np.sqrt(flat2 + up**2), np.sqrt(flat2 + down**2)
    lever = (up**2 - down**2) / (a * b * (a + b))  # ∫ ζ dζ/R³
    plain = (up / a - down / b) / flat2  # ∫ dζ/R³
    field = [(cosine * lever).sum(1), (sine * lever).sum(1), ((-sine * y - cosine * x) * plain).sum(1)]
    return polarization * radius / (2 * steps) * np.stack(field, axis=1)


def reference(body: RoundBody, points: np.ndarray) -> np.ndarray:
    field = wall_integral(body.outer_radius, body.length, body.polarization, points)
    if body.inner_radius:
        field -= wall_integral(body.inner_radius, body.length, body.polarization, points)
    return field


def before_a_face(body: RoundBody) -> np.ndarray:
    """216 points 1 to 50 mm before the upper face, on the axis, over the edge, and beyond it."""
    heights = np.geomspace(1e-3, 50e-3, 12) + body.length / 2
    radii = body.outer_radius * np.array([0.0, 0.1, 0.35, 0.7, 0.95, 1.0, 1.05, 1.5, 2.5])
    z, rho, lon = np.meshgrid(heights, radii, [0.3, 2.1], indexing="ij")
    return np.stack([rho * np.cos(lon), rho * np.sin(lon), z], axis=-1).reshape(-1, 3)


@pytest.mark.parametrize("body", [MAGNET, RING], ids=repr)
def test_field_agrees_with_quadrature_from_one_to_fifty_millimetres(body):
    points = before_a_face(body)
    assert len(points) >= 188
    true = reference(body, points)
    off = np.linalg.norm(body.field(points) - true, axis=1) / np.linalg.norm(true, axis=1)
    assert off.max() < 1e-12


@pytest.mark.parametrize("body", [MAGNET, RING], ids=repr)
def test_inside_the_matter_and_beside_the_wall_too(body):
    rng = np.random.default_rng(3)
    rho = body.outer_radius * np.array([0.2, 0.3, 0.6, 0.8, 1.2])[rng.integers(0, 5, 60)]
    points = np.stack([rho, np.zeros(60), rng.uniform(-0.7, 0.7, 60) * body.length], axis=1)
    true = reference(body, points)
    off = np.linalg.norm(body.field(points) - true, axis=1) / np.linalg.norm(true, axis=1)
    assert off.max() < 1e-11


def test_on_the_axis_the_textbook_formula_holds():
    z = np.linspace(-0.2, 0.2, 41)
    up, down = z + MAGNET.length / 2, z - MAGNET.length / 2
    true = 0.5 * MAGNET.polarization * (up / np.hypot(up, MAGNET.radius) - down / np.hypot(down, MAGNET.radius))
    field = MAGNET.field(np.stack([0 * z, 0 * z, z], axis=1))
    assert field[:, 2] == pytest.approx(true, rel=1e-9)
    assert (field[:, :2] == 0).all()


def test_the_axis_is_approached_without_loss():
    near = MAGNET.field_gradient([[rho, 0, 8e-3] for rho in (0.0, 1e-12, 1e-9, 1e-7)])
    assert near[1:] == pytest.approx(np.broadcast_to(near[0], (3, 3, 3)), abs=1e-4 * np.abs(near[0]).max())
    assert near[:, 0, 0] == pytest.approx(near[:, 1, 1], rel=1e-9)
    assert near[0, 2, 2] == pytest.approx(-2 * near[0, 0, 0], rel=1e-13)


def test_on_the_plane_of_a_face_the_normal_field_does_not_jump():
    face = MAGNET.length / 2
    for rho in (0.0, 3e-3, 12e-3, 20e-3, 40e-3):
        below, on, above = MAGNET.field([[rho, 0, face - 1e-9], [rho, 0, face], [rho, 0, face + 1e-9]])
        assert on == pytest.approx(0.5 * (below + above), rel=1e-6, abs=1e-9)
        assert np.isfinite(on).all()


def test_across_the_side_wall_the_axial_field_jumps_by_the_polarization():
    a = MAGNET.radius
    inside, on, outside = MAGNET.field([[a * (1 - 1e-9), 0, 1e-3], [a, 0, 1e-3], [a * (1 + 1e-9), 0, 1e-3]])
    assert inside[2] - outside[2] == pytest.approx(MAGNET.polarization, rel=1e-6)
    assert on[2] == pytest.approx(0.5 * (inside[2] + outside[2]), rel=1e-6)


def test_towards_the_edge_the_field_grows_as_a_logarithm_and_stays_finite():
    distance = np.geomspace(1e-4, 1e-13, 10)
    face = MAGNET.length / 2
    field = MAGNET.field(np.stack([MAGNET.radius + 0 * distance, 0 * distance, face + distance], axis=1))
    radial = field[:, 0]
    slope = np.diff(radial) / np.diff(-np.log(distance))
    assert slope[2:] == pytest.approx(MAGNET.polarization / (2 * np.pi), rel=1e-2)


def test_on_the_edge_itself_it_says_so():
    with pytest.raises(GeometryError, match="edge"):
        MAGNET.field([[0, 0, 0.01], [MAGNET.radius, 0, MAGNET.length / 2]])
    with pytest.raises(GeometryError, match="edge"):
        RING.field_gradient((RING.inner_radius, 0, -RING.length / 2))


@pytest.mark.parametrize("body", [MAGNET, RING], ids=repr)
def test_gradient_is_the_derivative_of_the_field(body):
    rng = np.random.default_rng(4)
    points = rng.normal(size=(400, 3))
    points *= (1.3 * body.bounding_radius + rng.exponential(3 * body.bounding_radius, 400))[:, None] / np.linalg.norm(
        points, axis=1, keepdims=True
    )
    h = 1e-4 * np.linalg.norm(points, axis=1, keepdims=True)
    found = np.empty((400, 3, 3))
    for j in range(3):
        e = np.eye(3)[j]
        near = body.field(points + h * e) - body.field(points - h * e)
        far = body.field(points + 2 * h * e) - body.field(points - 2 * h * e)
        found[:, :, j] = (8 * near - far) / (12 * h)
    gradient = body.field_gradient(points)
    off = np.abs(gradient - found).max(axis=(1, 2)) / np.abs(gradient).max(axis=(1, 2))
    assert np.percentile(off, 99) < 1e-7


@pytest.mark.parametrize("body", [MAGNET, RING], ids=repr)
def test_series_takes_over_from_closed_form_without_a_step(body):
    rng = np.random.default_rng(5)
    out = rng.normal(size=(300, 3))
    out *= 4 * body.bounding_radius / np.linalg.norm(out, axis=1, keepdims=True)
    for quantity in (body.field, body.field_gradient):
        below, above = quantity(out * (1 - 1e-13)), quantity(out * (1 + 1e-13))
        assert np.abs(below - above).max() < 1e-11 * np.abs(above).max()


@settings(max_examples=repetitions(16, 50), deadline=None)
@given(st.floats(1e-4, 1.0), st.floats(1e-4, 1.0), st.floats(-2, 2).filter(lambda j: abs(j) > 1e-3))
def test_size_only_scales(radius, length, polarization):
    """The field depends on ratios of lengths only, and is proportional to the polarization."""
    rng = np.random.default_rng(6)
    points = rng.normal(size=(20, 3)) * 3
    body = CylinderMagnet(radius, length, polarization)
    unit = CylinderMagnet(1.0, length / radius, 1.0)
    assert body.field(points * radius) == pytest.approx(polarization * unit.field(points), rel=1e-9, abs=1e-13)


def test_a_ring_is_the_difference_of_two_cylinders():
    points = before_a_face(RING)
    whole = CylinderMagnet(RING.outer_radius, RING.length, 1.348)
    hole = CylinderMagnet(RING.inner_radius, RING.length, 1.348)
    assert RING.field(points) == pytest.approx(whole.field(points) - hole.field(points), rel=1e-9, abs=1e-13)
    assert RING.moment == pytest.approx(whole.moment - hole.moment)


def test_a_published_ring_has_its_published_moment():
    """Zárate 2020: 12 mm/5 mm × 24 mm, and 48 mN/A at 50 mm asks for 2.407 A·m²."""
    assert RING.moment[2] == pytest.approx(2.407, abs=1e-3)


def test_inside_is_matter_not_the_hole():
    assert RING.contains([[4e-3, 0, 0], [1e-3, 0, 0], [7e-3, 0, 0], [4e-3, 0, 13e-3]]).tolist() == [True] + [False] * 3
    assert MAGNET.contains((0, 0, 0))


@pytest.mark.parametrize(
    ("slenderness", "error"), [(0.2, 0.36), (0.866, 0.039), (1.0, 0.076)], ids=["0.2", "0.866", "1.0"]
)
def test_dipole_error_at_two_bounding_radii(slenderness, error):
    """Published: worst direction, length over diameter 0.2, 0.866 (no octupole) and 1.0."""
    body = CylinderMagnet(1.0, 2 * slenderness, 1.0)
    angle = np.linspace(0, np.pi / 2, 181)
    points = 2 * body.bounding_radius * np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)
    exact, far = body.field(points), dipole.field(body.moment, points)
    worst = (np.linalg.norm(far - exact, axis=1) / np.linalg.norm(exact, axis=1)).max()
    assert worst == pytest.approx(error, rel=0.03)


@pytest.mark.parametrize("wrong", [0.0, -1e-3, np.nan, np.inf, "1 mm", [1e-3, 2e-3]])
def test_sizes_that_are_no_sizes_are_refused(wrong):
    with pytest.raises(InputError, match="radius"):
        CylinderMagnet(wrong, 5e-3, 1.0)
    with pytest.raises(InputError, match="length"):
        RingMagnet(5e-3, 2e-3, wrong, 1.0)


def test_other_wrong_input_is_refused():
    with pytest.raises(InputError, match="inner_radius must be below"):
        RingMagnet(5e-3, 5e-3, 1e-3, 1.0)
    with pytest.raises(InputError, match="polarization"):
        CylinderMagnet(1e-3, 1e-3, np.nan)
    with pytest.raises(InputError, match="points"):
        MAGNET.field([[0, 0, np.nan]])
    with pytest.raises(InputError, match="3-vectors"):
        MAGNET.field([1.0, 2.0])


def test_shape_follows_the_points():
    assert MAGNET.field(np.ones((2, 5, 3))).shape == (2, 5, 3)
    assert MAGNET.field_gradient((0, 0, 1.0)).shape == (3, 3)
    assert MAGNET.field(np.empty((0, 3))).shape == (0, 3)
