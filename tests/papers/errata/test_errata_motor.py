"""Errata E1 to E6: statements of Bai et al. 2012 on the spherical motor, against laws for any such motor."""

from __future__ import annotations

import numpy as np
import pytest

from haptorb.devices.loader import load
from haptorb.devices.motor_layout import PartRing
from haptorb_papers.reproduce.bai2012.table_2 import PAIRS

BAI = "bai2012"


def test_e1_the_magnets_strengths_give_its_moment_only_for_a_fifth_and_with_the_axis_counted_once(numbers) -> None:
    ratio, per_metre = numbers(BAI, "table 1", "t1-pm-ratio", "t1-pm-per-metre")
    assert per_metre == pytest.approx(825.35, abs=0.01)
    assert ratio == pytest.approx(0.1996, abs=1e-4)
    assert numbers(BAI, "table 1", "t1-pm-printed", "t1-pm-often") == pytest.approx([1.50, 1.075], abs=0.005)
    assert 10 * (33.5 + 410.2) * 0.3 / per_metre - 1 == pytest.approx(0.61, abs=0.01)
    assert pytest.approx(4135.5) == 33.5 + 10 * (24.5 + 57.6 + 52.0 + 276.1)
    assert numbers(BAI, "table 1", "t1-em-moments") == pytest.approx([1.097], abs=5e-4)  # the coil fails the same test


def test_e1_only_inches_make_the_published_strengths_give_the_exact_torque(numbers) -> None:
    scale, shape, other = numbers(BAI, "equations 7 to 9", "dmp-9-scale", "dmp-9-shape", "dmp-9-aspect")
    assert scale == pytest.approx(1.045, abs=0.006)
    assert shape == pytest.approx(0.025, abs=0.004)
    assert other == pytest.approx(1.286, abs=0.002)


def test_e1_exact_torque_of_the_inch_reading(numbers) -> None:
    found = numbers(BAI, "equations 7 to 9", "dmp-9-exact-y", "dmp-9-exact-z")
    assert found == pytest.approx([-0.188419, 0.026007], abs=2e-6)


def test_e2_theta_is_a_latitude(numbers) -> None:
    # Read as colatitudes, ±15° puts a ring's magnets on a cone about Z, 15° wide: neighbours 7.7° apart, and each
    # spans 26.3° as seen from the centre.
    nearest, cone = numbers(BAI, "table A.1", "ta1-pm-nearest", "ta1-pm-cone-nearest")
    assert (nearest, cone) == pytest.approx((28.9, 7.7), abs=0.1)
    assert nearest > 2 * np.degrees(np.arctan(15.875 / 67.9)) == pytest.approx(26.3, abs=0.05)
    assert numbers(BAI, "table A.1", "ta1-em-17-x") == pytest.approx([0.0], abs=1e-6)


def test_e3_the_printed_coils_overlap_and_their_pairs_are_not_opposite(numbers) -> None:
    (printed,) = numbers(BAI, "table A.1", "ta1-em-printed")
    assert printed == pytest.approx(26.0, abs=1e-6)  # EM 9–16 under EM 17–24
    assert 2 * np.degrees(np.arctan(15.88 / 56.8)) == pytest.approx(31.2, abs=0.1)
    assert numbers(BAI, "table A.1", "ta1-printed-refused") == [1.0]
    u = load("pmsm-printed-table", override=True).electromagnets.directions
    off = [180 - np.degrees(np.arccos(np.clip(u[i - 1] @ u[j - 1], -1, 1))) for i, j in PAIRS]
    assert off == pytest.approx([20.2] * 8 + [0.0] * 4, abs=0.01)
    assert numbers(BAI, "table A.1", "ta1-em-17-printed") == pytest.approx([22.5])
    equator = PartRing(0.0, 8, 0.0, np.radians(45)).directions()  # EM 17–24 alone moved back to the X axis
    assert np.degrees(np.arccos((equator @ u[:8].T).max())) == pytest.approx(26.0, abs=1e-6)


def test_e3_half_a_step_in_the_other_column_fixes_everything(numbers) -> None:
    assert numbers(BAI, "table A.1", "ta1-em-nearest") == pytest.approx([33.9], abs=0.05)
    assert numbers(BAI, "table 2", "t2-opposite", "t2-opposite-printed") == pytest.approx([180.0, 159.8], abs=0.02)


def test_e4_the_polarity_decides_how_pairs_must_be_wired(numbers) -> None:
    ids = "t2-aiding", "t2-opposed-in-step", "t2-opposed", "t2-ratio"
    aiding, in_step, opposed, ratio = numbers(BAI, "table 2", *ids)
    assert max(aiding, in_step) < 1e-9
    assert opposed > 0.2
    assert ratio == pytest.approx(1.55, abs=0.2)


def test_e5_only_the_corrected_equation_is_the_derivative_of_the_energy(numbers, printed, reproduction) -> None:
    ids = "dmp-9-printed-y", "dmp-9-printed-z"
    assert numbers(BAI, "equations 7 to 9", *ids) == pytest.approx([-0.1961, 0.0259], abs=1e-4)
    assert printed(BAI, "equations 7 to 9", *ids) == pytest.approx([5.916, -0.857], abs=2e-3)
    by_energy = [item.corrected for item in reproduction(BAI, "equations 7 to 9").items if item.id in ids]
    assert numbers(BAI, "equations 7 to 9", *ids) == pytest.approx(by_energy, abs=1e-7)


def test_e6_the_torques_of_the_modes_belong_to_the_euler_angles(numbers) -> None:
    ids = "eq-6-cartesian-lambda", "eq-6-cartesian-phi"
    assert numbers(BAI, "equations 1 to 6", *ids) == pytest.approx([0.924, 0.854], abs=5e-4)
    # by statics: the axes of λ and φ in the stator at ψ = λ = 22.5°, from products of elementary rotations
    tilt = np.radians(22.5)
    about_x = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    about_y = np.array([[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]])
    assert numbers(BAI, "equations 1 to 6", *ids) == pytest.approx([about_x[1, 1], (about_x @ about_y)[2, 2]], abs=1e-6)


def test_e6_only_equation_6b_conserves_power(numbers) -> None:
    assert numbers(BAI, "equations 1 to 6", "eq-6-power", "eq-6-text") == pytest.approx([0.0, 1.75], abs=1e-12)
    rng = np.random.default_rng(6)
    zeta = np.array([0.4, 0.7, 0.2])  # ζ̂1, ζ̂2, ζ̂3 [m/rad]
    for force, (psi, lam, phi) in zip(rng.normal(size=(20, 3)), rng.normal(size=(20, 3)), strict=True):
        power = force @ (zeta * (lam, psi, phi))  # eq. (6a): X' from λ, Y' from ψ
        by_text = (zeta[1] * force[0], zeta[0] * force[1], zeta[2] * force[2]) @ np.array([psi, lam, phi])
        assert abs(by_text - power) > 1e-3
