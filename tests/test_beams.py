"""Hooks: validity and bending; every closed form against an independent integral."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import cumulative_simpson, quad

from haptorb.beams import (
    MODELS,
    TABLE_3,
    Hook,
    appendix_b,
    balance_face,
    compliance,
    compute_bent_shape,
    compute_handbook_force,
    force_ratio,
)
from haptorb.errors import GeometryError, InputError, UnknownName

STRAIGHT = TABLE_3.ramp_to_peak()


def section(hook: Hook, x: float) -> float:
    """h(x)/h₀ by the definition under eq. (12), X over h₀; written again, not taken from the package."""
    x *= hook.thickness
    up = max(0.0, x - hook.base_length) * math.tan(hook.rear)
    down = hook.height - (x - hook.peak) * math.tan(hook.front)
    return 1.0 + min(up, hook.height, down) / hook.thickness


def integral(hook: Hook, integrand, upper: float) -> float:
    points = [p / hook.thickness for p in (hook.base_length, hook.ramp_end, hook.peak)]
    return quad(integrand, 0.0, upper, points=[p for p in points if p < upper], limit=200)[0]


@st.composite
def hooks(draw) -> Hook:
    thickness = draw(st.floats(0.4e-3, 3e-3))
    base = thickness * draw(st.floats(4, 15))
    height = thickness * draw(st.floats(0.3, 3))
    rear, front = (math.radians(draw(st.floats(10, 80))) for _ in range(2))
    flat = thickness * draw(st.sampled_from([0.0, 0.5, 3.0]))
    return Hook(
        base, base + height / math.tan(rear) + flat, thickness, height, 6e-3, front, rear, 2e9, 0.35, flat_top=True
    )


def test_appendix_b_is_what_the_paper_prints() -> None:
    terms = appendix_b(TABLE_3)
    assert terms.plus_1 == pytest.approx(2944.1, abs=0.05)
    assert terms.plus_2 == pytest.approx(299.16, abs=0.005)
    assert terms.plus_3 == pytest.approx(2.619, abs=0.0005)
    assert (terms.minus_1, terms.minus_2) == pytest.approx((3024.0, 95.39), abs=0.005)  # H_x by (13), E9
    printed = appendix_b(TABLE_3, deflection=0.75e-3)
    assert (printed.minus_1, printed.minus_2) == pytest.approx((2376.0, 74.95), abs=0.005)
    assert printed[:3] == terms[:3]


@pytest.mark.parametrize(("modulus", "pull"), [(113e9, 50.8), (1.13e9, 0.508)])
def test_pull_out_force_with_the_printed_h_x(modulus: float, pull: float) -> None:
    terms = appendix_b(TABLE_3, deflection=0.75e-3)
    force = 0.134 * modulus * 8e-3 * 1.5e-3 / (terms.plus + 0.134 * terms.minus)
    assert force == pytest.approx(pull, rel=2e-3)


@given(hooks())
def test_the_paper_model_is_equations_12_and_13(hook: Hook) -> None:
    top = compliance(hook, hook.peak, "paper", shear_ratio=2.6)
    X, L_b = hook.peak / hook.thickness, hook.base_length / hook.thickness
    bending = integral(hook, lambda x: 12 * x**2 / section(hook, x) ** 3, X)
    shear = 1.2 * 2.6 * integral(hook, lambda x: 1 / section(hook, x), X)
    assert float(top.plus) == pytest.approx(bending + shear, rel=1e-7)
    turn = L_b + integral(hook, lambda x: 1 / section(hook, x) ** 3, X) - integral(hook, lambda x: 1.0, L_b)
    assert float(top.minus) == pytest.approx(6 * X * (section(hook, X) - 0.5) * turn, rel=1e-7)


@given(hooks())
def test_appendix_b_is_the_paper_model_up_to_the_end_of_the_ramp(hook: Hook) -> None:
    terms = appendix_b(hook)
    at_the_ramp = compliance(hook, hook.ramp_end, "paper", shear_ratio=2.6)
    assert terms.plus == pytest.approx(float(at_the_ramp.plus), rel=1e-7)


@given(hooks())
def test_the_timoshenko_model_is_virtual_work(hook: Hook) -> None:
    X = 0.5 * (hook.peak + hook.tip) / hook.thickness
    soft = compliance(hook, X * hook.thickness, "timoshenko", shear_ratio=2.6)
    bending = integral(hook, lambda x: 12 * (X - x) ** 2 / section(hook, x) ** 3, X)
    shear = 3.12 * integral(hook, lambda x: 1 / section(hook, x), X)
    assert float(soft.plus) == pytest.approx(bending + shear, rel=1e-7)
    top = section(hook, X)
    pulled = integral(hook, lambda x: 12 * (X - x) * (top - section(hook, x) / 2) / section(hook, x) ** 3, X)
    assert float(soft.minus) == pytest.approx(pulled, rel=1e-6)


def test_e11_loaded_at_the_contact_the_hook_is_almost_five_times_softer() -> None:
    straight = float(compliance(STRAIGHT, STRAIGHT.peak).plus)
    assert straight == pytest.approx(15490, rel=0.005)
    assert float(compliance(TABLE_3, TABLE_3.peak).plus) == pytest.approx(15206, rel=0.005)
    assert straight / appendix_b(TABLE_3).plus == pytest.approx(4.77, abs=0.01)


def test_on_the_uniform_beam_both_models_are_the_textbook_cantilever() -> None:
    for model in MODELS:
        soft = compliance(TABLE_3, 0.9 * TABLE_3.base_length, model, shear_ratio=2.6)
        X = 0.9 * 9.0
        assert float(soft.plus) == pytest.approx(4 * X**3 + 3.12 * X, rel=1e-12)
        assert float(soft.minus) == pytest.approx(6 * X**2 * 0.5, rel=1e-12)


@given(hooks(), st.floats(0.6, 1.0))
def test_the_bent_shape_obeys_the_beam_equation(hook: Hook, share: float) -> None:
    x = share * hook.tip
    shape = compute_bent_shape(hook, x, 1e-3, points=2001)
    load = 1e-3 / hook.thickness / float(compliance(hook, x).plus)  # F_y
    s = shape[:, 0] / hook.thickness
    h = np.array([section(hook, value) for value in s])
    inside = s <= x / hook.thickness
    curvature = np.where(inside, 12 * load * (x / hook.thickness - s) / h**3, 0.0)
    sheared = np.where(inside, 1.2 * hook.shear_ratio * load / h, 0.0)
    slope = cumulative_simpson(curvature, x=s, initial=0) + sheared
    bent = cumulative_simpson(slope, x=s, initial=0) * hook.thickness
    assert np.abs(bent - shape[:, 1]).max() < 2e-3 * np.abs(shape[:, 1]).max()


@given(hooks())
def test_half_the_growth_of_compliance_is_the_slope_under_the_load(hook: Hook) -> None:
    # what makes U = δ²/(2Ω) give the turned face of eq. (11): sliding a load along must cost what it climbs
    x = 0.97 * hook.peak
    step = 1e-6 * hook.thickness
    soft = compliance(hook, [x - step, x, x + step], shear_ratio=0.0).plus
    growth = (soft[2] - soft[0]) / (2 * step) / (2 * soft[1])
    X = x / hook.thickness
    turn = integral(hook, lambda s: 12 * (X - s) / section(hook, s) ** 3, X) / hook.thickness
    assert growth == pytest.approx(turn / soft[1], rel=1e-4)


@given(st.floats(0.05, 1.0), st.floats(0.0, 1.0))
def test_friction_leans_the_force_by_its_angle(slope: float, friction: float) -> None:
    up, down = force_ratio(slope, friction, True), force_ratio(slope, friction, False)
    if slope + math.atan(friction) < math.pi / 2:
        assert math.atan(up) - math.atan(down) == pytest.approx(2 * math.atan(friction))
    assert float(force_ratio(0.0, friction, True)) == pytest.approx(friction)


def test_e8_says_by_how_much_the_sizes_contradict_each_other() -> None:
    with pytest.raises(GeometryError) as told:
        replace(TABLE_3, flat_top=False)
    for number in ("58.8°", "4.2 mm", "6.935 mm", "5.135 mm too much", "E8", "23.2°", "6.49 mm", "3.11 mm"):
        assert number in str(told.value)
    with pytest.raises(GeometryError, match=r"rises 1\.529 mm, but hook\.height is 1\.8 mm: 0\.27\d+ mm too little"):
        replace(TABLE_3, rear=math.radians(20))
    assert replace(TABLE_3, rear=STRAIGHT.rear, flat_top=False).ramp_end == pytest.approx(TABLE_3.peak)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"poisson_ratio": 0.5}, "poisson_ratio must lie from 0"),
        ({"poisson_ratio": -0.1}, "poisson_ratio must lie from 0"),
        ({"youngs_modulus": 0.0}, "youngs_modulus must be greater than zero"),
        ({"thickness": math.nan}, "thickness must be a finite number"),
        ({"width": "8 mm"}, "width must be a finite number"),
        ({"front": math.pi / 2}, "front must be less than 90°"),
        ({"peak": 5e-3}, "there is no room for the rear face"),
    ],
)
def test_hooks_that_cannot_exist(changed: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(TABLE_3, **changed)


@pytest.mark.parametrize("thickness", [5e-6, 1e-9, 1e-300])
def test_a_cross_section_that_tapers_to_nothing_is_refused(thickness: float) -> None:
    with pytest.raises(GeometryError, match="is next to nothing"):
        replace(TABLE_3, thickness=thickness)


def test_a_face_that_locks_by_itself_is_said_and_not_infinite() -> None:
    # a block on an incline, by statics: P holds the hook, W pushes along it, N and μN on the face
    for degrees, friction in ((30.0, 0.3), (60.0, 0.5), (5.0, 1.0)):
        slope = math.radians(degrees)
        along, across = math.sin(slope) + friction * math.cos(slope), math.cos(slope) - friction * math.sin(slope)
        assert compute_handbook_force(2.0, slope, friction) == pytest.approx(2.0 * along / across)
    with pytest.raises(GeometryError, match=r"self-locking: .* 0.6 · tan 60° = 1.04, is 1 or more.* below 59°"):
        compute_handbook_force(1.0, math.radians(60.0), 0.6)
    with pytest.raises(GeometryError, match="locks by itself"):
        balance_face(TABLE_3, TABLE_3.peak, 1e-3, -math.radians(80.0), -0.6)


def test_e7_a_metal_as_soft_as_a_plastic_is_remarked_upon() -> None:
    said = replace(STRAIGHT, youngs_modulus=1.13e9)
    (remark,) = said.remarks(metal=True)
    assert "E7" in remark
    assert "1.13 GPa" in remark
    assert said.remarks(metal=False) == ()
    assert STRAIGHT.remarks(metal=True) == ()
    assert TABLE_3.remarks(metal=True) == ()


def test_bad_places_and_models() -> None:
    with pytest.raises(InputError, match="x must lie on the hook"):
        compliance(TABLE_3, 20e-3)
    with pytest.raises(InputError, match="finite"):
        compliance(TABLE_3, math.nan)
    with pytest.raises(UnknownName, match="did you mean 'timoshenko'"):
        compliance(TABLE_3, 5e-3, "timoshenk")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="x must lie on the hook"):
        compute_bent_shape(TABLE_3, 0.0, 1e-3)


@given(hooks())
def test_shapes_follow_the_points(hook: Hook) -> None:
    x = np.linspace(0.1, 1.0, 6).reshape(2, 3) * hook.tip
    for model in MODELS:
        soft = compliance(hook, x, model)
        assert soft.plus.shape == soft.minus.shape == (2, 3)
        assert (np.diff(soft.plus.ravel()) > 0).all()
