"""Demagnetisation checks: self-field by formula, fields of the coils at drawn poses, and rejected devices."""

import numpy as np
import pytest

import haptorb
from haptorb.devices.build_checks import BuildError
from haptorb.devices.loader import parse
from haptorb.devices.magnet_grades import SERIES, choose_series, own_field
from haptorb.magnetics.magnets import CylinderMagnet, RingMagnet
from haptorb.rotations import rotation_from_euler

MU0 = 4e-7 * np.pi
KEPT, SOLD = "magnets that keep their polarization", "magnets that the series is sold with"


def on_axis(radius, half, z):
    """B/J of a full cylinder on its axis: two charged discs, and J between them."""
    return 0.5 * ((z + half) / np.hypot(z + half, radius) - (z - half) / np.hypot(z - half, radius))


@pytest.mark.parametrize(("radius", "length"), [(15.875e-3, 5.08e-3), (6e-3, 24e-3), (10e-3, 10e-3)])
def test_the_field_strength_in_a_magnet_is_that_of_its_charged_faces(radius, length):
    found = own_field(CylinderMagnet(radius, length, 1.31))
    expected = max(1.31 * (1 - on_axis(radius, length / 2, z)) / MU0 for z in (0.0, 0.45 * length))
    assert found == pytest.approx(expected, rel=0.01)


def test_a_ring_is_a_cylinder_without_one():
    outer, inner, length, z = 20e-3, 4e-3, 8e-3, 3.6e-3
    on_its_axis = on_axis(outer, length / 2, z) - on_axis(inner, length / 2, z)
    assert own_field(RingMagnet(outer, inner, length, 1.2)) > 0.5 * 1.2 * (1 - on_its_axis) / MU0
    assert own_field(RingMagnet(outer, 1e-5, length, 1.2)) == pytest.approx(
        own_field(CylinderMagnet(outer, length, 1.2)), rel=0.01
    )


@pytest.mark.parametrize(
    "magnet",
    [RingMagnet(51.4e-3, 45e-3, 1.5e-3, 1.3), RingMagnet(54e-3, 47e-3, 0.1e-3, 1.3),
     RingMagnet(6e-3, 2.5e-3, 24e-3, 1.35), RingMagnet(0.145, 0.116, 14.5e-3, 1.3),
     CylinderMagnet(15.875e-3, 5.08e-3, 1.31)],
)  # fmt: skip
def test_the_field_strength_in_a_magnet_is_that_of_its_closed_form(magnet):
    """By the compiled field of currents on its walls, which no device file is read with, at a fine grid within it."""
    wall = magnet.outer_radius - magnet.inner_radius
    rho, z = np.meshgrid(
        magnet.inner_radius + wall * np.linspace(0.03, 0.9, 30), 0.45 * magnet.length * np.linspace(-1, 1, 11)
    )
    field = magnet.field(np.stack([rho.ravel(), np.zeros(rho.size), z.ravel()], axis=1))[:, 2]
    assert own_field(magnet) == pytest.approx((magnet.polarization - field).max() / MU0, rel=0.01)


def test_coercivity_falls_as_that_of_a_measured_magnet():
    """N48SH, published: 21.06 kOe at 20 °C, 6.29 kOe at 150 °C."""
    known = choose_series(1.38, "SH")
    assert known.knee(423.15) / known.knee(293.15) == pytest.approx(6.29 / 21.06, rel=0.06)
    knees = np.array([[one.knee(273.15 + t) for one in SERIES] for t in (20, 80, 120)])
    assert (np.diff(knees, axis=1) > 0).all()
    assert (np.diff(knees, axis=0) < 0).all()


def parts(check):
    """Own field, neighbours' and coils' of a check's note [A/m]."""
    scale = {"": 1.0, "A/m": 1.0, "kA/m": 1e3, "MA/m": 1e6}
    found = []
    for text in check.note.partition(";")[0].split(", "):
        _, number, *unit = text.split(" ")
        found.append(float(number) * scale["".join(unit)])
    return found


def find(device, condition=KEPT, name=""):
    return next(one for one in device.build_checks if one.condition == condition and one.name.startswith(name))


def test_coils_at_their_peak_oppose_a_motors_magnet_at_most_as_stated():
    motor, draw = haptorb.load("pmsm"), np.random.default_rng(2)
    stated, tilt = MU0 * parts(find(motor, name="magnets"))[2], motor.workspace_tilt
    face, most = motor.magnets.distance - motor.magnet.length / 2, 0.0
    for _ in range(25):
        u = motor.magnets.directions @ rotation_from_euler(
            *draw.uniform(-tilt, tilt, 2), draw.uniform(0, 2 * np.pi)
        ).T  # fmt: skip
        each = [motor.coil_field(face * u, one) for one in np.diag(motor.driven_current)]
        most = max(most, np.abs(np.einsum("kpa,pa->kp", each, u)).sum(axis=0).max())
    assert 0.9 * stated < most < 1.02 * stated


def test_neighbours_with_like_poles_oppose_a_magnet_and_unlike_ones_help_it():
    phases = haptorb.load("pmsm-in-phase")
    beside = parts(find(phases, name="magnets"))[1]
    assert beside > 20e3
    assert parts(find(haptorb.load("pmsm"), name="magnets"))[1] == 0.0
    # at a magnet's centre, by dipoles of the two magnets that stand with like poles 30° away
    moment = phases.magnet.moment[2]
    i = 0
    far = phases.magnets.positions - phases.magnets.positions[i]
    far = np.delete(far, i, axis=0)
    turns = np.delete(phases.magnets.directions * phases.polarity[:, None], i, axis=0)
    away = np.linalg.norm(far, axis=1)[:, None]
    field = 1e-7 * moment * (3 * (turns * far).sum(axis=1, keepdims=True) * far / away**2 - turns) / away**3
    dipoles = -(field @ phases.magnets.directions[i]).sum() * phases.polarity[i]
    assert dipoles / MU0 < beside + 60e3


@pytest.mark.parametrize(
    ("tables", "condition", "words"),
    [
        ('[magnets]\ngrade = "H"', KEPT, "SH or stronger is needed"),
        ('[magnets]\ngrade = "N"\ngreatest_temperature = "20 degC"', KEPT, "M or stronger is needed"),
        ('[magnets]\ngrade = "AH"', SOLD, "series AH, stated"),
        ('[magnets]\npolarization = "1.55 T"', SOLD, "1.55 T"),
        ('[regulator.rotor]\nlength = "0.3 mm"\n[magnets]\ngreatest_temperature = "190 degC"', KEPT, "regulator.rotor"),
    ],
)
def test_magnets_that_lose_their_polarization_are_refused(tables, condition, words):
    with pytest.raises(BuildError) as refused:
        parse(f'based_on = "pmsm"\nname = "own"\n{tables}', "own")
    assert condition in {check.condition for check in refused.value.failures}
    assert words in str(refused.value)


def test_a_cool_magnet_needs_no_strong_grade():
    text = 'based_on = "pmsm"\nname = "own"\n[magnets]\ngrade = "H"\ngreatest_temperature = "45 degC"'
    assert find(parse(text, "own"), name="magnets").holds
    for kind, place in (("omni", "[tool]"), ("omni-fingertip", "[tool]")):
        device = parse(f'based_on = "{kind}"\nname = "own"\n{place}\ngrade = "M"', "own")
        assert find(device).note.count("series M, stated") == 1


def test_a_short_magnet_in_a_tool_and_in_an_array_is_refused():
    with pytest.raises(BuildError, match=KEPT):
        parse('based_on = "omni"\nname = "own"\n[tool]\nlength = "3 mm"\ninner_radius = "1 mm"\ngrade = "N"', "own")
    magnet = '{ position = ["0 mm", "0 mm", "0 mm"], axis = [0, 0, 1], outer_radius = "19 mm", length = "12.5 mm", '
    with pytest.raises(BuildError, match=KEPT):
        parse(
            f'based_on = "planar"\nname = "own"\n[tool]\nmagnets = [{magnet}remanence = "1.25 T", grade = "M" }}]',
            "own",
        )
