"""Errata E12 to E19: what Zárate et al. 2020 print, against point dipoles, exact magnets and plain arithmetic."""

from __future__ import annotations

from math import asin, cos, degrees, pi, radians, sin, sqrt

import numpy as np
import pytest
from scipy.integrate import quad

from haptorb.devices.state import State
from haptorb.physics import dipole
from haptorb.physics.arrays import Array
from haptorb.physics.charged_ring import ChargedRing
from haptorb.physics.dipole import MU0
from haptorb.physics.soft_sphere import SoftSphere
from haptorb.worlds.dome import Dome

D_MIN = 0.05
RING = ChargedRing(6e-3, 2.5e-3, 24e-3, 1.348, radial=4, azimuth=16)
M_P = float(RING.moment[2])
PER_AMPERE = np.array([2.52, 2.70, 2.82]) / 12.9
CORE = SoftSphere(15e-3)


def radial_tool(alpha: float, d: float = D_MIN) -> tuple[Array, Array, Array]:
    """Place of a tool at angle `alpha` from +z [m], the outward direction, and the direction away from +z."""
    out = np.array([sin(alpha), 0.0, cos(alpha)])
    return d * out, out, np.array([cos(alpha), 0.0, -sin(alpha)])


@pytest.mark.parametrize("alpha", [0.2, 0.7, 1.3])
def test_e12_the_sign_of_equation_2_asks_for_a_tangent_away_from_the_axis(alpha: float) -> None:
    p, out, away = radial_tool(alpha)
    force = dipole.force((0, 0, 1.0), M_P * out, p)
    scale = 3 * MU0 * M_P / (4 * pi * D_MIN**4)
    assert force @ out == pytest.approx(-2 * scale * cos(alpha))
    assert force @ away == pytest.approx(-scale * sin(alpha))


def test_e13_the_printed_argument_lets_the_radial_force_vanish_at_450_degrees() -> None:
    theta_1 = pi / 10
    printed, used = 2 * theta_1 / pi, pi / (2 * theta_1)
    assert degrees(pi / 2 / printed) == pytest.approx(450)
    assert degrees(pi / 2 / used) == pytest.approx(18)
    assert 2 * (pi / 2) / pi == pi / (2 * (pi / 2)) == 1  # both are a plain magnet at θ1 = 90°
    dome = Dome(half_width_deg=18, cut_off_deg=54, tool_moment=M_P)
    radial = [dome.wrench(State.at(p))[:3] @ out for p, out, _ in map(radial_tool, np.radians([10, 18, 30]))]
    assert radial[0] > 0 > radial[2]
    assert radial[1] == pytest.approx(0, abs=1e-12)
    # Printed, the same map falls by less than one part in 20 where it should be zero.
    assert cos(printed * radians(18)) == pytest.approx(0.998, abs=5e-4)
    assert cos(printed * radians(54)) == pytest.approx(0.982, abs=5e-4)


def test_e14_the_printed_inverse_lacks_the_tools_moment() -> None:
    p, out, away = radial_tool(0.6)
    aside = np.cross(out, away)
    wanted = 0.11 * away + 0.05 * aside - 0.3 * out
    frame = np.stack([away, aside, out])
    printed = 4 * pi * D_MIN**4 / (3 * MU0) * np.array([1.0, 1.0, -0.5]) * (frame @ wanted)
    given = dipole.force(frame.T @ printed, M_P * out, p)
    assert given == pytest.approx(M_P * wanted)
    assert dipole.force(frame.T @ printed / M_P, M_P * out, p) == pytest.approx(wanted)


def test_e15_the_supply_gives_20_ampere_not_24() -> None:
    ohm = 0.6
    assert 12 / ohm == pytest.approx(20.0)
    assert pytest.approx(19.98, abs=0.005) == 0.959 / 0.048
    assert 20**2 * ohm == pytest.approx(240)  # printed: 230 W
    assert pytest.approx(0.601, abs=5e-4) == 100 / 12.9**2
    assert 24**2 * ohm == pytest.approx(346, abs=0.5)
    assert pytest.approx(1.15, abs=0.005) == 24 * 0.048  # printed peak: 0.959 N
    assert sqrt(17 / ohm) == pytest.approx(5.32, abs=0.005)
    assert 48 * sqrt(17 / ohm) == pytest.approx(255.5, abs=0.1)  # printed: 258 mN


def test_e15_the_printed_force_per_ampere_names_the_magnet() -> None:
    per_moment = 6 * MU0 / (4 * pi * D_MIN**4) * PER_AMPERE.mean()
    assert 0.048 / per_moment == pytest.approx(2.407, abs=5e-4)
    assert pytest.approx(2.406, abs=5e-4) == M_P
    assert per_moment * M_P == pytest.approx(0.04799, abs=1e-5)


@pytest.mark.parametrize(("d", "excess"), [(0.05, 0.156), (0.06, 0.107), (0.07, 0.078)])
def test_e16_the_ring_is_too_long_for_a_point(d: float, excess: float) -> None:
    exact = RING.wrench_map(np.eye(3), (0, 0, d))[2, 2]
    point = dipole.force((0, 0, 1.0), (0, 0, M_P), (0, 0, d))[2]
    assert exact / point - 1 == pytest.approx(excess, abs=5e-4)


def test_e17_set_points_18_degrees_apart_on_four_rings() -> None:
    places = [(0, 0)] + [(theta, phi) for theta in (18, 36, 54) for phi in range(0, 360, 45)]
    assert len(places) == 25
    at = np.array(
        [[sin(radians(t)) * cos(radians(f)), sin(radians(t)) * sin(radians(f)), cos(radians(t))] for t, f in places]
    )
    apart = np.degrees(np.arccos(np.clip(at @ at.T, -1, 1))) + 360 * np.eye(25)
    assert apart[0].min() == pytest.approx(18)
    # Around the first ring the neighbours are nearer than along a meridian: "evenly" holds on meridians only.
    assert apart[1].min() == pytest.approx(13.58, abs=0.005)
    assert 2 * degrees(asin(sin(radians(54)) * sin(radians(22.5)))) == pytest.approx(36.07, abs=0.005)
    # Points really 18° apart everywhere would be about 44 on the same cap, not 25.
    cap = (1 - cos(radians(54 + 9))) / (1 - cos(radians(9)))
    assert cap == pytest.approx(44, abs=0.5)


@pytest.mark.parametrize(
    ("d", "exact", "as_a_point", "first_harmonic"),
    [(0.05, 52.9, 40.1, 30.0), (0.06, 12.25, 10.2, 8.4), (0.07, 3.74, 3.28, 2.85)],
)
def test_e18_the_core_pulls_the_tool_with_all_currents_off(
    d: float, exact: float, as_a_point: float, first_harmonic: float
) -> None:
    def pull(magnet: ChargedRing) -> float:
        points, charges = magnet.placed(np.eye(3), (0, 0, d))
        return -1e3 * float(CORE.forces(points, charges * M_P / magnet.moment[2]).sum(axis=0)[2])

    assert pull(RING) == pytest.approx(exact, rel=4e-3)
    assert pull(ChargedRing(1e-4, 0.0, 1e-4, 1.0)) == pytest.approx(as_a_point, rel=4e-3)
    induced = CORE.moment_in(dipole.field((0, 0, M_P), (0, 0, -d)))
    assert -1e3 * dipole.force(induced, (0, 0, M_P), (0, 0, d))[2] == pytest.approx(first_harmonic, rel=4e-3)


@pytest.mark.parametrize(("theta_1", "millijoule"), [(18.0, 4.11), (60.0, 0.0)])
def test_e19_a_sharpened_map_is_no_potential(theta_1: float, millijoule: float) -> None:
    dome = Dome(half_width_deg=theta_1, cut_off_deg=180, moment=2.4, tool_moment=M_P, reach=1.0)
    near, far, edge = D_MIN, 0.07, radians(theta_1 if theta_1 < 54 else 54)

    def force(alpha: float, d: float) -> tuple[float, float]:
        p, out, away = radial_tool(alpha, d)
        given = dome.wrench(State.at(p))[:3]
        return float(given @ out), float(given @ away)

    # Out over the summit, down the far side, in again, back up the near side.
    work = quad(lambda d: force(0.0, d)[0], near, far)[0] + quad(lambda a: force(a, far)[1] * far, 0, edge)[0]
    work -= quad(lambda d: force(edge, d)[0], near, far)[0] + quad(lambda a: force(a, near)[1] * near, 0, edge)[0]
    assert 1e3 * work == pytest.approx(millijoule, abs=0.01)
