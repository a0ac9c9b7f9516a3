"""Errata E7 to E11, E20, E21: what Bai et al. 2012 print of the snap-fit, against its integrals and beam theory."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

L_B, L_M, H_B = 5.4 / 0.6, 9.6 / 0.6, 1.8 / 0.6  # Table 3 over h₀ = 0.6 mm
SLOPE = np.tan(np.radians(58.8))
RAMP_END = L_B + H_B / SLOPE
E_OVER_G, P = 2.6, 1.2
FRICTION, WIDTH = 0.134, 8e-3
PLUG, SOCKET = 6.3e-3, 4.8e-3
MODULUS = 113e9
RHO = 1 / (1 + H_B)
FOOT = 1 - L_B * SLOPE
OMEGA_PLUS = (
    4 * (1 + 0.3 / L_B**2 * E_OVER_G) * L_B**3,  # (B.3)
    # (B.4)
    6 / SLOPE**3 * (-2 * np.log(RHO) - 4 * H_B * RHO * FOOT + H_B * (2 + H_B) * FOOT**2 * RHO**2),
    -P * E_OVER_G * np.log(RHO) / SLOPE,  # (B.5a)
)


def thickness(x: float) -> float:
    """h(x)/h₀ of eq. (12): ramp, then (E8) the flat top that joins it to the contact."""
    return 1.0 if x < L_B else min(1 + (x - L_B) * SLOPE, 1 + H_B)


def omega_minus(h_x: float) -> tuple[float, float]:
    """(B.5b) and (B.5c)."""
    return 3 * L_M * (2 * h_x + 1) * L_B, 3 * L_M / (2 * SLOPE) * (2 * h_x + 1) * (1 - RHO**2)


def stiffness(modulus: float, h_x: float) -> float:
    """E w/(Ω₊ + μΩ₋) [N/m], the factor of eq. (17)."""
    return modulus * WIDTH / (sum(OMEGA_PLUS) + FRICTION * sum(omega_minus(h_x)))


PRINTED_H_X = 1 + (PLUG - SOCKET) / 2 / 0.6e-3  # (B.2b) with the plug in


def test_appendix_b_is_the_closed_form_of_equation_12() -> None:
    assert pytest.approx((2944.1, 299.16, 2.619), abs=0.03) == OMEGA_PLUS
    bending = quad(lambda x: 12 * x**2 / thickness(x) ** 3, L_B, RAMP_END)[0]
    shear = P * E_OVER_G * quad(lambda x: 1 / thickness(x), L_B, RAMP_END)[0]
    assert OMEGA_PLUS[1:] == pytest.approx((bending, shear))


def test_e7_the_printed_modulus_makes_an_outlet_that_falls_open() -> None:
    pull_out = {E: FRICTION * stiffness(E, PRINTED_H_X) * (PLUG - SOCKET) for E in (1.13e9, 113e9)}
    assert pull_out[1.13e9] == pytest.approx(0.508, abs=0.001)
    assert pull_out[113e9] == pytest.approx(50.8, abs=0.1)


def test_e8_angle_height_and_length_of_the_ramp_cannot_all_hold() -> None:
    run = (L_M - L_B) * 0.6
    assert run == pytest.approx(4.2)
    assert run * SLOPE == pytest.approx(6.94, abs=0.01)  # mm of height, where 1.8 is printed
    assert np.degrees(np.arctan(1.8 / run)) == pytest.approx(23.2, abs=0.05)  # where 58.8° is printed
    assert pytest.approx(10.82, abs=0.005) == RAMP_END  # where the closed forms stop; contact is at L_m = 16


def test_e9_the_closed_form_of_omega_minus_needs_another_h_x() -> None:
    top = thickness(L_M)
    first = 6 * L_M * (top - 0.5) * L_B  # eq. (13)
    second = 6 * L_M * (top - 0.5) * quad(lambda x: 1 / thickness(x) ** 3, L_B, RAMP_END)[0]
    assert omega_minus(top - 1) == pytest.approx((first, second))
    assert omega_minus(top - 1) == pytest.approx((3024, 95.39), abs=0.01)
    assert omega_minus(PRINTED_H_X) == pytest.approx((2376, 74.95), abs=0.01)
    softer = stiffness(MODULUS, top - 1) / stiffness(MODULUS, PRINTED_H_X) - 1
    assert softer == pytest.approx(-0.0244, abs=2e-4)


def test_e10_the_last_member_of_equation_18_is_a_length_squared() -> None:
    epsilon, arm, y = np.radians(2), 5e-3, 0.0
    k = stiffness(MODULUS, PRINTED_H_X)
    force_y = k * (2 * np.tan(epsilon) * arm - 2 * y)  # (17)
    printed = 2 * np.tan(epsilon) * arm**2 - 2 * y * arm
    assert force_y * arm / printed == pytest.approx(k)
    assert k == pytest.approx(2.529e5, rel=1e-3)


def test_e11_a_beam_loaded_where_the_contact_is_is_almost_five_times_softer() -> None:
    def ramp_to_the_contact(x: float) -> float:
        return 1.0 if x < L_B else 1 + H_B * (x - L_B) / (L_M - L_B)

    found = {}
    for name, h in (("ramp", ramp_to_the_contact), ("flat top", thickness)):
        bending = 12 * quad(lambda x, h=h: (L_M - x) ** 2 / h(x) ** 3, 0, L_M, points=[L_B, RAMP_END])[0]
        shear = P * E_OVER_G * quad(lambda x, h=h: 1 / h(x), 0, L_M, points=[L_B, RAMP_END])[0]
        found[name] = bending + shear
    assert found["ramp"] == pytest.approx(15490, rel=0.005)
    assert found["flat top"] == pytest.approx(15206, rel=0.005)
    assert found["ramp"] / sum(OMEGA_PLUS) == pytest.approx(4.77, abs=0.01)


def test_e20_the_reaction_torque_falls_with_the_tilt_not_against_it() -> None:
    arm = 5e-3
    torque = [stiffness(MODULUS, PRINTED_H_X) * 2 * np.tan(np.radians(tilt)) * arm**2 for tilt in (2.0, 1.0, 0.5, 0.0)]
    assert torque == sorted(torque, reverse=True)
    assert torque[-1] == 0.0


def test_e21_the_shear_ratio_is_another_poissons_ratio() -> None:
    of_the_table = 2 * (1 + 0.41)
    assert of_the_table == pytest.approx(2.82)
    assert pytest.approx(2 * (1 + 0.3)) == E_OVER_G
    change = 4 * 0.3 * L_B * (of_the_table - E_OVER_G) + OMEGA_PLUS[2] * (of_the_table / E_OVER_G - 1)
    assert change / sum(OMEGA_PLUS) == pytest.approx(8.0e-4, abs=1e-4)
