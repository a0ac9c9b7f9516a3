"""Errata E1 to E6: what Bai et al. 2012 print of the spherical motor, against what must be true of any such motor."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haptorb.devices.state import rotation_to_axis
from haptorb.physics.arrays import Array
from haptorb.physics.coil import Coil
from haptorb.physics.cylinder import CylinderMagnet
from haptorb.physics.dipole import MU0
from haptorb.physics.interaction import wrench
from haptorb.physics.placed import Placed, Together

INCH = 25.4e-3
R_PM, R_EM = 67.9e-3, 56.8e-3  # Table A.1
MAGNET_RADIUS, COIL_RADIUS = 15.875e-3, 15.88e-3  # Table 1
POLARIZATION = 1.31
PM_LENGTH, EM_LENGTH = 0.2 * INCH, 0.3 * INCH  # E1
PM_STRENGTHS = (33.5, 24.5, 57.6, 52.0, 276.1)  # Table 1, read in A·m per metre of the dipoles' length
EM_STRENGTHS = (1.476, 0.547, 1.618, 1.644, 1.654, 1.325, 0.592)
PAIRS = [(1, 13), (2, 14), (3, 15), (4, 16), (5, 9), (6, 10), (7, 11), (8, 12), (17, 21), (18, 22), (19, 23), (20, 24)]

STEP = 45.0 * np.arange(8)
LATITUDES = np.repeat([-26.0, 26.0, 0.0], 8)
PRINTED = np.concatenate([STEP, STEP + 22.5, STEP + 22.5])
USED = np.concatenate([STEP + 22.5, STEP + 22.5, STEP])


def directions(latitude: Array, longitude: Array) -> Array:
    """(n, 3) unit vectors, degrees in."""
    lat, lon = np.radians(latitude), np.radians(longitude)
    return np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1)


def angles(u: Array) -> Array:
    """(n, n) angles between directions [deg], the diagonal out of the way."""
    return np.degrees(np.arccos(np.clip(u @ u.T, -1, 1))) + 360 * np.eye(len(u))


MAGNETS = np.concatenate([directions(np.full(12, lat), 30.0 * np.arange(12)) for lat in (-15.0, 15.0)])
CHECKERBOARD = np.concatenate([(-1.0) ** np.arange(12), -((-1.0) ** np.arange(12))])
IN_PHASE = np.concatenate([(-1.0) ** np.arange(12), (-1.0) ** np.arange(12)])
X_AXIS, Z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])


def turned(psi: float, lam: float, phi: float) -> Array:
    return Rotation.from_euler("XYZ", (psi, lam, phi), degrees=True).as_matrix()


def rotor(R: Array, length: float = PM_LENGTH, signs: Array = CHECKERBOARD) -> Together:
    """All 24 magnets of the rotor turned by R, exact."""
    parts = []
    for u, sign in zip(MAGNETS @ R.T, signs, strict=True):
        magnet = CylinderMagnet(radius=MAGNET_RADIUS, length=length, polarization=sign * POLARIZATION)
        parts.append(Placed(magnet, R_PM * u, rotation_to_axis(u)))
    return Together(parts)


def coil(length: float = EM_LENGTH) -> Coil:
    return Coil(turns=1000, inner_radius=0.3 * COIL_RADIUS, outer_radius=COIL_RADIUS, length=length)


def exact(c: Array, R: Array, pm: float = PM_LENGTH, em: float = EM_LENGTH, signs: Array = CHECKERBOARD) -> Array:
    """(3,) torque on the rotor per ampere in a coil on axis c [N·m/A]: minus that on the coil, about the centre."""
    on_coil = wrench(rotor(R, pm, signs), coil(em), R_EM * c, rotation_to_axis(c), about=np.zeros(3), precision=1e-5)
    return -on_coil.value[3:]


def poles(radius: float, strengths: tuple[float, ...], dipoles: int, length: float) -> tuple[Array, Array]:
    """Eq. (7): pole places (2n, 3), sources first, and strengths [A·m]; the loop j = 0 is one pair, counted once."""
    rings = [(0.0, 0.0, strengths[0])]
    for j, strength in enumerate(strengths[1:], 1):
        r = radius * j / len(strengths)
        rings += [(r * np.cos(t), r * np.sin(t), strength) for t in 2 * np.pi * np.arange(dipoles) / dipoles]
    x, y, m = np.array(rings).T
    half = np.full_like(x, length / 2)
    return np.concatenate([np.stack([x, y, half], -1), np.stack([x, y, -half], -1)]), m


def rotor_poles(R: Array, length: float = 0.2 * PM_LENGTH) -> tuple[Array, Array]:
    """Sources (n, 3) and sinks (n, 3) as (2n, 3) of all magnets, and signed strengths (n,)."""
    at, m = poles(MAGNET_RADIUS, PM_STRENGTHS, 10, length)
    n = len(m)
    placed = [(at + R_PM * Z) @ rotation_to_axis(u).T @ R.T for u in MAGNETS]
    sources, sinks = (np.concatenate([p[part] for p in placed]) for part in (slice(None, n), slice(n, None)))
    return np.concatenate([sources, sinks]), np.concatenate([sign * m for sign in CHECKERBOARD])


def coil_poles(c: Array, length: float = 0.442 * EM_LENGTH) -> tuple[Array, Array]:
    at, m = poles(COIL_RADIUS, EM_STRENGTHS, 16, length)
    return (at + R_EM * Z) @ rotation_to_axis(c).T, m


def kernel(rotor_at: Array, coil_at: Array) -> Array:
    """(r, s, 3) R_rs of eq. (9): the vector from pole s to pole r over its length cubed."""
    apart = rotor_at[:, None] - coil_at
    return apart / np.linalg.norm(apart, axis=-1, keepdims=True) ** 3


def eq_9(c: Array, R: Array, pm: float, em: float, *, as_printed: bool = False) -> Array:
    """(3,) [N·m/A] by eq. (9), with E5 corrected or as printed."""
    (r, m), (s, v) = rotor_poles(R, pm), coil_poles(c, em)
    field = kernel(r, s)
    plus, minus = (np.einsum("s,rsi->ri", v, field[:, half]) for half in (slice(None, len(v)), slice(len(v), None)))
    n = len(m)
    arms = r[:n], r[n:]
    if as_printed:
        first = np.cross(plus[:n] - minus[:n], arms[0])
        second = np.cross(plus[n:] + minus[n:], arms[1])
    else:
        first = np.cross(arms[0], plus[:n] - minus[:n])
        second = np.cross(arms[1], plus[n:] - minus[n:])
    return MU0 / (4 * np.pi) * (m[:, None] * (first - second)).sum(axis=0)


def spread(count: int) -> list[Array]:
    """Orientations over the published workspace, the same in every run."""
    rng = np.random.default_rng(2012)
    tilt, spin = rng.uniform(-22.5, 22.5, (count, 2)), rng.uniform(0, 360, count)
    return [turned(a, b, c) for (a, b), c in zip(tilt, spin, strict=True)]


def test_e1_the_magnets_strengths_give_its_moment_only_for_a_fifth_and_with_the_axis_counted_once() -> None:
    per_metre = POLARIZATION / MU0 * np.pi * MAGNET_RADIUS**2
    assert per_metre == pytest.approx(825.35, abs=0.01)
    once = PM_STRENGTHS[0] + 10 * sum(PM_STRENGTHS[1:])
    every_time = 10 * sum(PM_STRENGTHS)
    assert once == pytest.approx(4135.5)
    assert once * 0.2 / per_metre - 1 == pytest.approx(0.002, abs=5e-4)
    assert once * 0.3 / per_metre - 1 == pytest.approx(0.50, abs=0.01)
    assert every_time * 0.2 / per_metre - 1 == pytest.approx(0.075, abs=0.001)
    assert every_time * 0.3 / per_metre - 1 == pytest.approx(0.61, abs=0.01)


@pytest.mark.parametrize(
    ("pm", "em", "scale", "shape"),
    [
        pytest.param(0.2 * INCH, 0.3 * INCH, 1.042, 0.017, id="inches"),
        pytest.param(0.4 * MAGNET_RADIUS, 0.6 * COIL_RADIUS, 1.27, 0.019, id="of-the-diameter"),
    ],
)
def test_e1_only_inches_make_the_published_strengths_give_the_exact_torque(
    pm: float, em: float, scale: float, shape: float
) -> None:
    orientations = spread(16)
    truth = np.array([exact(X_AXIS, R, pm, em) for R in orientations])
    published = np.array([eq_9(X_AXIS, R, 0.2 * pm, 0.442 * em) for R in orientations])
    fitted = float((published * truth).sum() / (truth * truth).sum())
    assert fitted == pytest.approx(scale, abs=0.006)
    assert np.linalg.norm(published - fitted * truth) / np.linalg.norm(fitted * truth) < shape


def test_e1_exact_torque_of_the_inch_reading() -> None:
    assert exact(X_AXIS, turned(10, 5, 5)) == pytest.approx([0, -0.188419, 0.026007], abs=2e-6)


def test_e2_theta_is_a_latitude() -> None:
    assert directions(np.zeros(1), np.zeros(1))[0] == pytest.approx(X_AXIS)  # EM 17 "on the X axis"
    # Read as colatitudes, ±15° puts all 24 magnets on one cone about Z, 15° wide: neighbours 7.7° apart, and each
    # spans 26.3° as seen from the centre.
    azimuth = np.concatenate([30.0 * np.arange(12), 30.0 * np.arange(12) + 180.0])
    on_a_cone = directions(np.full(24, 75.0), azimuth)
    span = np.degrees(2 * np.arctan(MAGNET_RADIUS / R_PM))
    assert span == pytest.approx(26.3, abs=0.1)
    assert np.sort(angles(on_a_cone[:12]).min(axis=1))[0] == pytest.approx(7.7, abs=0.1)
    assert angles(MAGNETS).min() == pytest.approx(28.9, abs=0.1)
    assert angles(MAGNETS).min() > span


def test_e3_the_printed_coils_overlap_and_their_pairs_are_not_opposite() -> None:
    span = np.degrees(2 * np.arctan(COIL_RADIUS / R_EM))
    assert span == pytest.approx(31.2, abs=0.1)
    printed = directions(LATITUDES, PRINTED)
    assert angles(printed).min() == pytest.approx(26.0, abs=1e-6)  # EM 9–16 under EM 17–24
    on_the_x_axis = directions(LATITUDES, np.concatenate([STEP, STEP + 22.5, STEP]))
    assert angles(on_the_x_axis).min() == pytest.approx(26.0, abs=1e-6)  # then EM 1–8 under EM 17–24
    off = [180 - np.degrees(np.arccos(np.clip(printed[i - 1] @ printed[j - 1], -1, 1))) for i, j in PAIRS]
    assert off == pytest.approx([20.2] * 8 + [0.0] * 4, abs=0.01)


def test_e3_half_a_step_in_the_other_column_mends_everything() -> None:
    used = directions(LATITUDES, USED)
    assert angles(used).min() == pytest.approx(33.9, abs=0.05)
    for i, j in PAIRS:
        assert used[i - 1] == pytest.approx(-used[j - 1])
    assert used[16] == pytest.approx(X_AXIS)


def test_e4_the_polarity_decides_how_pairs_must_be_wired() -> None:
    used = directions(LATITUDES, USED)
    smallest = {}
    for name, signs in (("checkerboard", CHECKERBOARD), ("in phase", IN_PHASE)):
        each = []
        for R in spread(4):
            K = np.stack([exact(c, R, signs=signs) for c in used], axis=-1)
            for wiring, sense in (("aiding", 1), ("opposed", -1)):
                grouped = np.stack([K[:, i - 1] + sense * K[:, j - 1] for i, j in PAIRS], axis=-1)
                each.append((wiring, np.linalg.svd(grouped, compute_uv=False)[-1]))
        for wiring in ("aiding", "opposed"):
            smallest[name, wiring] = min(value for which, value in each if which == wiring)
    assert smallest["checkerboard", "aiding"] < 1e-9
    assert smallest["in phase", "opposed"] < 1e-9
    ratio = smallest["checkerboard", "opposed"] / smallest["in phase", "aiding"]
    assert ratio == pytest.approx(1.5, abs=0.2)


def test_e5_only_the_corrected_equation_is_the_derivative_of_the_energy() -> None:
    R = turned(10, 5, 5)
    s, v = coil_poles(X_AXIS)
    charge = np.concatenate([v, -v])

    def energy(turn: Array) -> float:
        r, m = rotor_poles(turn @ R)
        apart = np.linalg.norm(r[:, None] - s, axis=-1)
        return float(MU0 / (4 * np.pi) * np.concatenate([m, -m]) @ (1 / apart) @ charge)

    step = 1e-5
    slopes = [
        (energy(Rotation.from_rotvec(-step * e).as_matrix()) - energy(Rotation.from_rotvec(step * e).as_matrix()))
        / (2 * step)
        for e in np.eye(3)
    ]
    lengths = 0.2 * PM_LENGTH, 0.442 * EM_LENGTH
    corrected = eq_9(X_AXIS, R, *lengths)
    assert corrected == pytest.approx(slopes, abs=1e-7)
    assert corrected == pytest.approx([0.0, -0.1961, 0.0259], abs=1e-4)
    printed = eq_9(X_AXIS, R, *lengths, as_printed=True)
    assert printed == pytest.approx([0.0, 5.916, -0.857], abs=2e-3)


def test_e6_only_equation_6b_conserves_power() -> None:
    rng = np.random.default_rng(6)
    zeta = np.array([0.4, 0.7, 0.2])  # ζ̂1, ζ̂2, ζ̂3 [m/rad]
    for force, (psi_dot, lam_dot, phi_dot) in zip(rng.normal(size=(20, 3)), rng.normal(size=(20, 3)), strict=True):
        power = force @ (zeta * (lam_dot, psi_dot, phi_dot))  # eq. (6a): X' from λ, Y' from ψ
        by_6b = (zeta[1] * force[1], zeta[0] * force[0], zeta[2] * force[2]) @ np.array([psi_dot, lam_dot, phi_dot])
        by_text = (zeta[1] * force[0], zeta[0] * force[1], zeta[2] * force[2]) @ np.array([psi_dot, lam_dot, phi_dot])
        assert by_6b == pytest.approx(power, abs=1e-12)
        assert abs(by_text - power) > 1e-3
