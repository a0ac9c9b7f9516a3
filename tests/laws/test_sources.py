"""Laws of magnetostatics for every source. A new source is tested by being added to SOURCES."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haptorb.magnetics import dipole
from haptorb.magnetics.coil import Coil, InteriorCoil
from haptorb.magnetics.dipole import Dipole
from haptorb.magnetics.interaction import wrench
from haptorb.magnetics.magnets import ChargedRing, CylinderMagnet, RingMagnet
from haptorb.magnetics.multipole import MultipoleSource, load_published
from haptorb.magnetics.source import PlacedSource, RoundBody, Source
from oracles.magnetics.formulations import flux_linkage
from oracles.magnetics.multipole_wrench import multipole_wrench
from oracles.magnetics.source_sum import SourceSum

TURN = Rotation.from_euler("XYZ", [25, -40, 70], degrees=True).as_matrix()


@dataclass(frozen=True)
class Case:
    """A source and the radius of a sphere about the origin that holds it."""

    source: Source
    radius: float
    round: bool = True  #: a body of revolution about z


SOURCES = {
    "dipole": Case(Dipole((0, 0, 2.4)), 5e-3),
    "flat magnet": Case(CylinderMagnet(15.875e-3, 5.08e-3, 1.31), 16.1e-3),
    "long magnet": Case(CylinderMagnet(4e-3, 30e-3, -1.2), 15.6e-3),
    "ring magnet": Case(RingMagnet(6e-3, 2.5e-3, 24e-3, 1.348), 12.4e-3),
    "coil": Case(Coil(1000, 4.764e-3, 15.88e-3, 7.62e-3), 16.4e-3),
    "charged ring": Case(ChargedRing(6e-3, 2.5e-3, 24e-3, 1.348), 12.4e-3, round=False),
    "published magnet": Case(load_published("bai2012-pm").model, 15.9e-3, round=False),
    "published coil": Case(load_published("bai2012-em").model, 15.9e-3, round=False),
    "one pole pair": Case(MultipoleSource(5e-3, 4e-3, [3.0], 1), 2.1e-3),
    "placed magnet": Case(PlacedSource(CylinderMagnet(5e-3, 4e-3, 1.0), (2e-3, 1e-3, -3e-3), TURN), 12e-3, round=False),
    "two together": Case(
        SourceSum([PlacedSource(Dipole((1, 0, 0)), (4e-3, 0, 0), TURN), CylinderMagnet(3e-3, 3e-3, 1.1)]),
        8e-3,
        round=False,
    ),
}
BODIES = {name: case.source for name, case in SOURCES.items() if isinstance(case.source, RoundBody)}


def points_around(case: Case, count: int = 60) -> np.ndarray:
    """Points outside, 1.1 to about 10 radii from the origin."""
    rng = np.random.default_rng(7)
    out = rng.normal(size=(count, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    return out * case.radius * (1.1 + rng.exponential(1.5, (count, 1)))


def gradient(source: Source, points: np.ndarray) -> np.ndarray:
    """[n, i, j] = ∂B_i/∂x_j by differences of eighth order, so that every source is asked in the same way."""
    h = 0.01 * np.linalg.norm(points, axis=1, keepdims=True)
    weights = ((1, 4 / 5), (2, -1 / 5), (3, 4 / 105), (4, -1 / 280))
    out = np.zeros((*points.shape, 3))
    for j, e in enumerate(np.eye(3)):
        for k, w in weights:
            out[:, :, j] += w * (source.field(points + k * h * e) - source.field(points - k * h * e)) / h
    return out


every = pytest.mark.parametrize("case", SOURCES.values(), ids=SOURCES)


@every
def test_divergence_is_zero(case):
    slopes = gradient(case.source, points_around(case))
    off = np.abs(np.trace(slopes, axis1=1, axis2=2)) / np.linalg.norm(slopes, axis=(1, 2))
    assert np.percentile(off, 90) < 1e-8
    assert off.max() < 1e-4


@every
def test_curl_is_zero_outside(case):
    slopes = gradient(case.source, points_around(case))
    off = np.abs(slopes - np.swapaxes(slopes, 1, 2)).max(axis=(1, 2)) / np.linalg.norm(slopes, axis=(1, 2))
    assert np.percentile(off, 90) < 1e-8
    assert off.max() < 1e-4


@every
def test_gradient_is_that_of_the_field(case):
    points = points_around(case)
    slopes = gradient(case.source, points)
    off = np.abs(case.source.field_gradient(points) - slopes).max(axis=(1, 2)) / np.abs(slopes).max(axis=(1, 2))
    assert np.percentile(off, 90) < 1e-8
    assert off.max() < 1e-4


@pytest.mark.parametrize("kind", [Coil, InteriorCoil])
def test_in_the_bore_of_a_coil_divergence_and_curl_are_zero(kind):
    """No current flows there; along the whole axis the field adds up to µ0 times the turns."""
    coil = Coil(100, 20e-3, 25e-3, 30e-3)
    source = coil if kind is Coil else kind(coil)
    rng = np.random.default_rng(9)
    points = rng.normal(size=(40, 3))
    points *= (rng.uniform(1e-3, 14e-3, 40) / np.linalg.norm(points, axis=1))[:, None]
    slopes, size = gradient(source, points), np.linalg.norm(source.field(np.zeros(3))) / coil.inner_radius
    assert np.abs(np.trace(slopes, axis1=1, axis2=2)).max() < 1e-8 * size
    assert np.abs(slopes - np.swapaxes(slopes, 1, 2)).max() < 1e-8 * size
    # ∮B·ds = µ0 N along the axis, the series inside and the closed form outside (Jackson, § 5.3)
    z, weights = np.polynomial.legendre.leggauss(200)
    near, far = 15e-3 * z, 15e-3 / (0.5 * (1 + z))  # outside by 1/z
    axis = np.array([0.0, 0.0, 1.0])
    inside = 15e-3 * weights @ source.field(near[:, None] * axis)[:, 2]
    outside = 2 * 0.5 * weights @ (source.field(far[:, None] * axis)[:, 2] * far**2 / 15e-3)
    assert inside + outside == pytest.approx(dipole.MU0 * 100, rel=1e-8)


@every
def test_far_field_is_that_of_a_dipole_with_the_same_moment(case):
    rng = np.random.default_rng(8)
    out = rng.normal(size=(30, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    for radii, worst in ((1e3, 1e-2), (1e5, 1e-4)):
        points = radii * case.radius * out
        far = dipole.field(case.source.moment, points)
        off = np.linalg.norm(case.source.field(points) - far, axis=1) / np.linalg.norm(far, axis=1)
        assert off.max() < worst


@every
def test_turning_and_moving_the_source_turns_and_moves_the_field(case):
    points, shift = points_around(case), np.array([0.3, -0.1, 0.2])
    moved = PlacedSource(case.source, shift, TURN)
    assert moved.field(points @ TURN.T + shift) == pytest.approx(
        case.source.field(points) @ TURN.T, rel=1e-7, abs=1e-9 * np.abs(case.source.field(points)).max()
    )
    assert moved.moment == pytest.approx(TURN @ case.source.moment)


@pytest.mark.parametrize(
    "case", [c for c in SOURCES.values() if c.round], ids=[n for n, c in SOURCES.items() if c.round]
)
def test_round_sources_do_not_notice_a_spin_and_know_up_from_down(case):
    points = points_around(case)
    spin = Rotation.from_euler("Z", 1.234).as_matrix()
    field = case.source.field(points)
    scale = np.abs(field).max()
    assert case.source.field(points @ spin.T) == pytest.approx(field @ spin.T, rel=1e-9, abs=1e-12 * scale)
    # a mirror at z = 0 turns an axial moment into itself: B is an axial vector
    assert case.source.field(points * (1, 1, -1)) == pytest.approx(field * (-1, -1, 1), rel=1e-9, abs=1e-12 * scale)


@every
def test_flux_through_a_closed_sphere_is_zero(case):
    x, w = np.polynomial.legendre.leggauss(48)
    lon = 2 * np.pi * np.arange(96) / 96
    across = np.sqrt(1 - x**2)[:, None]
    out = np.stack([across * np.cos(lon), across * np.sin(lon), np.broadcast_to(x[:, None], (48, 96))], axis=-1)
    normal = np.einsum("abi,abi->ab", case.source.field(2 * case.radius * out), out)
    assert abs(w @ normal.sum(axis=1)) < 1e-9 * (w @ np.abs(normal).sum(axis=1))


APART, LEAN = np.array([12e-3, -7e-3, 45e-3]), Rotation.from_euler("XYZ", [20, 35, 50], degrees=True).as_matrix()
pairs = pytest.mark.parametrize(
    ("one", "other"), [(a, b) for a in BODIES for b in BODIES], ids=[f"{a} and {b}" for a in BODIES for b in BODIES]
)


@pairs
def test_third_law(one, other):
    """Force on one is minus that on the other, and so are the torques about one common point."""
    a, b = BODIES[one], BODIES[other]
    on_b = wrench(a, b, APART, LEAN, about=(0, 0, 0), precision=1e-7).value
    on_a = wrench(b, a, -LEAN.T @ APART, LEAN.T, precision=1e-7).value  # b's frame; about a's centre
    for part in (slice(0, 3), slice(3, 6)):
        back = LEAN @ on_a[part]
        assert np.linalg.norm(back + on_b[part]) < 1e-6 * np.linalg.norm(on_b[part])


@pytest.mark.parametrize("source", SOURCES.values(), ids=SOURCES)
def test_virtual_work(source):
    """Force and torque of any source on a coil are the derivatives of the flux that it links with it."""
    coil = BODIES["coil"]
    h, source = 2e-5, source.source
    on_coil = wrench(source, coil, APART, LEAN, precision=1e-9).value

    def linkage(shift, spin):
        return flux_linkage(
            source, coil, APART + shift, Rotation.from_rotvec(spin).as_matrix() @ LEAN, precision=1e-11
        ).value[0]

    force = [(linkage(h * e, 0 * e) - linkage(-h * e, 0 * e)) / (2 * h) for e in np.eye(3)]
    torque = [(linkage(0 * e, h * e) - linkage(0 * e, -h * e)) / (2 * h) for e in np.eye(3)]
    assert on_coil[:3] == pytest.approx(force, abs=2e-5 * np.linalg.norm(force))
    assert on_coil[3:] == pytest.approx(torque, abs=2e-5 * np.linalg.norm(torque))


@pytest.mark.parametrize("source", SOURCES.values(), ids=SOURCES)
def test_no_torque_about_a_coils_own_axis(source):
    found = wrench(source.source, BODIES["coil"], APART, LEAN, precision=1e-6).value
    assert abs(found[3:] @ LEAN[:, 2]) < 1e-12 * np.linalg.norm(found[3:])


def test_pole_models_obey_the_third_law_exactly():
    a, b = SOURCES["published magnet"].source, SOURCES["published coil"].source
    on_b = multipole_wrench(a, b, APART, LEAN, about=(0, 0, 0))
    on_a = multipole_wrench(b, a, -LEAN.T @ APART, LEAN.T)
    assert LEAN @ on_a[:3] == pytest.approx(-on_b[:3], rel=1e-12)
    assert LEAN @ on_a[3:] == pytest.approx(-on_b[3:], rel=1e-11)
