"""Errata E7 to E11, E20, E21, E27 to E29, E32: the snap-fit of Bai 2012 in print, against integrals and beam theory."""

from __future__ import annotations

import math

import numpy as np
import pytest

from haptorb.beams import TABLE_3, appendix_b, balance_face, compliance
from haptorb.devices.base import State
from haptorb.worlds import Outlet, SnapFit

BAI = "bai2012"


def test_appendix_b_is_the_closed_form_of_equation_12(numbers, printed) -> None:
    ids = "b-b3", "b-b4", "b-b5a"
    assert numbers(BAI, "appendix B", *ids) == pytest.approx((2944.1, 299.16, 2.619), abs=0.03)
    assert numbers(BAI, "appendix B", *ids) == pytest.approx(printed(BAI, "appendix B", *ids), rel=1e-8)


def test_e7_the_printed_modulus_makes_an_outlet_that_falls_open(numbers, printed) -> None:
    assert printed(BAI, "table 3", "t3-pull") == pytest.approx([0.508], abs=0.001)
    assert numbers(BAI, "table 3", "t3-pull", "t3-e-socket") == pytest.approx([50.8, 113.0], abs=0.1)


def test_e8_angle_height_and_length_of_the_ramp_cannot_all_hold(numbers) -> None:
    found = numbers(BAI, "table 3", "t3-ramp", "t3-ramp-angle", "t3-ramp-end", "t3-ramp-refused")
    assert found == pytest.approx([6.94, 23.2, 10.82, 1.0], abs=0.01)


def test_e9_the_closed_form_of_omega_minus_needs_another_h_x(numbers, printed) -> None:
    ids = "b-b5b", "b-b5c"
    assert numbers(BAI, "appendix B", *ids) == pytest.approx((3024, 95.39), abs=0.01)
    assert printed(BAI, "appendix B", *ids) == pytest.approx((2376, 74.95), abs=0.01)
    assert numbers(BAI, "appendix B", "b-e9-effect") == pytest.approx([-0.0244], abs=2e-4)


def test_e10_the_last_member_of_equation_18_is_a_length_squared(numbers, printed) -> None:
    (torque,), (area,) = (told(BAI, "figure 7", "fig7-18-factor") for told in (numbers, printed))
    assert torque / area == pytest.approx(2.467e5, rel=1e-3)  # [N/m]


def test_e11_a_beam_loaded_where_the_contact_is_is_almost_five_times_softer(numbers, printed) -> None:
    found = numbers(BAI, "appendix B", "b-12-load", "b-12-load-flat", "b-12-softer", "b-13-load")
    assert found == pytest.approx([15490, 15206, 4.77, 4425], rel=0.002)
    assert printed(BAI, "appendix B", "b-12-load-flat", "b-13-load") == pytest.approx([3245.9, 3119.4], abs=0.1)


def test_e20_the_reaction_torque_falls_with_the_tilt_not_against_it(numbers) -> None:
    assert numbers(BAI, "figure 7", "fig7-18-falls") == [1.0]


def test_e21_the_shear_ratio_is_another_poissons_ratio(numbers) -> None:
    ratio, change = numbers(BAI, "appendix B", "b-b2c", "b-b2c-effect")
    assert ratio == pytest.approx(2.82)
    assert change == pytest.approx(8.0e-4, abs=1e-4)


def test_e27_the_face_turns_by_the_slope_under_both_forces_not_by_the_chord(numbers, printed) -> None:
    (slope,), (chord,) = (told(BAI, "figure 6", "fig6-slope") for told in (numbers, printed))
    assert (slope, chord) == pytest.approx((23.3, 15.5), abs=0.05)
    hook = SnapFit().hook
    for x, face, friction, turn, arc, peak, by_chord in (
        (hook.ramp_end, hook.rear, 0.3, 8.1, 5.2, 8.22, 8.94), (hook.peak, -hook.front, -0.3, 6.4, 4.6, 9.61, 8.85),
    ):  # fmt: skip
        held = balance_face(hook, x, hook.height, face, friction)
        chord = math.atan(hook.height / x)
        assert (math.degrees(held.turn), math.degrees(chord)) == pytest.approx((turn, arc), abs=0.06)
        soft, ratio = compliance(hook, x), math.tan(face - chord + math.atan(friction))  # (10) and (11), E22's sign
        pull = ratio * hook.youngs_modulus * hook.width * hook.height / (soft.plus + ratio * soft.minus)
        assert (2 * abs(held.pull), 2 * abs(pull)) == pytest.approx((peak, by_chord), abs=0.006)


def test_e28_the_appendix_names_beta_sigma_and_p_k(numbers, printed) -> None:
    ids = "b-b4", "b-b5a"
    assert numbers(BAI, "appendix B", *ids) == pytest.approx(printed(BAI, "appendix B", *ids), rel=1e-8)
    assert numbers(BAI, "appendix B", "b-12-thickness") == pytest.approx([4.0])


def test_e28_a_length_in_16_and_a_ratio_in_10() -> None:
    # (17) with (16)'s lengths is the pull of the outlet in newtons; with (10)'s ratios it lacks a factor of h₀, 0.6 mm
    soft = appendix_b(TABLE_3)
    lengths = 113e9 * 8e-3 * 0.134 * (6.3e-3 - 4.8e-3) / (soft.plus + 0.134 * soft.minus)
    ratios = 113e9 * 8e-3 * 0.134 * (6.3 - 4.8) / 0.6 / (soft.plus + 0.134 * soft.minus)
    pull = Outlet(beam="paper").wrench(State.at((1e-3, 0, 0), R_SR=np.eye(3), v=(1e4, 0, 0)))[0]
    assert -pull == pytest.approx(lengths, rel=1e-6)
    assert -pull == pytest.approx(ratios * TABLE_3.thickness, rel=1e-6)


def test_e32_friction_on_the_faces_of_the_plug_is_a_couple(numbers) -> None:
    assert numbers(BAI, "figure 7", "fig7-18-couple") == pytest.approx([1 - 0.134 * 3.15 / 15], abs=1e-5)
    # by the contacts themselves: two forces along X', 3.15 mm to either side
    plug = State.at((1e-3, 0.1e-3, 0), R_SR=np.eye(3), v=(1e4, 0, 0))
    along = [contact.force[0] for contact in Outlet(beam="paper").contacts(plug)]
    couple = -3.15e-3 * (along[0] - along[1])
    wrench = Outlet(beam="paper").wrench(plug)
    assert wrench[5] - 15e-3 * wrench[1] == pytest.approx(couple, rel=1e-6)
    assert couple == pytest.approx(-0.134 * 3.15e-3 * wrench[1], rel=1e-6)


def test_e29_the_outlets_hooks_are_bent_beyond_yield() -> None:
    right, paper = Outlet().root_load, Outlet(beam="paper").root_load
    assert (right.stress, paper.stress) == pytest.approx((0.89e9, 4.18e9), rel=0.005)
    assert (right.strain, paper.strain) == pytest.approx((0.0079, 0.037), rel=0.005)
    assert right.yield_strength == pytest.approx(0.53e9)
    assert right.beyond_yield
    assert paper.beyond_yield
