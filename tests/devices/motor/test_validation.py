"""Validation of geometry and wiring of a spherical motor: each mistake planted once."""

import re
from pathlib import Path

import numpy as np
import pytest

import haptorb
from haptorb.devices import loader
from haptorb.devices.build_checks import BuildError
from haptorb.devices.loader import parse
from haptorb.devices.motor import measure_ring_pull
from haptorb.devices.motor_wiring import grouping
from haptorb.errors import DeviceError
from haptorb.rotations import rotation_from_euler


def change_text(*replacements):
    """The catalogue's PMSM with pieces of its text replaced."""
    text = (Path(loader.__file__).parent / "catalogue" / "pmsm.toml").read_text(encoding="utf-8")
    for old, new in replacements:
        assert old in text, f"the catalogue file no longer has {old!r}"
        text = text.replace(old, new)
    return text


def refusal(*replacements):
    with pytest.raises(DeviceError) as caught:
        parse(change_text(*replacements), "mine")
    return str(caught.value)


def test_the_catalogue_has_the_variants():
    names = haptorb.devices.loader.catalogue()
    assert {"pmsm", "pmsm-in-phase", "pmsm-printed", "pmsm-printed-table"} <= set(names)


@pytest.mark.parametrize("name", ["pmsm", "pmsm-in-phase", "pmsm-thick-magnets"])
def test_sound_variants_pass_without_findings(name):
    device = haptorb.load(name)
    assert device.name == name
    assert device.findings == ()


def test_the_printed_layout_is_refused_naming_overlaps_and_pairs():
    with pytest.raises(DeviceError) as caught:
        haptorb.load("pmsm-printed")
    message = str(caught.value)
    assert "EM1 and EM17 at 26.0°" in message
    assert "EM8 and EM24 at 26.0°" in message
    assert "pairs that do not face each other" in message
    assert "EM1 and EM13 (20.2° off)" in message
    assert "override=True" in message
    assert message.count("26.0°") == 8
    assert message.count("20.2° off") == 8


def test_the_override_loads_it_and_keeps_what_was_found():
    device = haptorb.load("pmsm-printed", override=True)
    assert len(device.findings) == 1
    assert [c.condition for c in device.build_checks if not c.holds] == ["electromagnets beside each other"]
    assert haptorb.torque_characteristic(device, np.eye(3), model="dipole").shape == (3, 24)


def test_the_table_to_the_letter_contradicts_the_text_too():
    device = haptorb.load("pmsm-printed-table", override=True)
    assert abs(device.electromagnets.directions[16] @ [1, 0, 0]) < 0.93  # "located on the X axis": it is not
    assert any("EM9 and EM17" in check.note for check in device.build_checks if not check.holds)


def test_thick_coils_overlap_by_a_hair():
    with pytest.raises(DeviceError, match=r"beside each other.*EM1 and EM17 at 33\.9°"):
        haptorb.load("pmsm-thick-coils")


@pytest.mark.parametrize(("polarity", "winding"), [("checkerboard", "series-aiding"), ("in-phase", "series-opposed")])
def test_wrong_pairing_is_caught(polarity, winding):
    message = refusal(
        ('polarity = "checkerboard"', f'polarity = "{polarity}"'),
        ('winding = "series-opposed"', f'winding = "{winding}"'),
    )
    assert "no group produces any torque at any orientation" in message
    assert "groups.winding" in message


def test_one_magnet_turned_round_does_not_stop_the_motor():
    signs = [(1 if (j % 12 + j // 12) % 2 == 0 else -1) for j in range(24)]
    signs[5] = -signs[5]
    parse(change_text(('polarity = "checkerboard"', f"polarity = {signs}")), "mine")


def test_a_motor_that_cannot_turn_about_every_axis_is_caught():
    """All coils on the equator and all magnets near it: at zero tilt nothing turns the rotor about X or Y enough."""
    text = change_text(
        ('latitude = "-15 deg", count = 12', 'latitude = "0 deg", count = 12'),
        ('  { latitude = "15 deg", count = 12, first = "0 deg", step = "30 deg" },\n', ""),
        ('  { latitude = "-26 deg", count = 8, first = "22.5 deg", step = "45 deg" },\n', ""),
        ('  { latitude = "26 deg", count = 8, first = "22.5 deg", step = "45 deg" },\n', ""),
    )
    groups = text[text.index("coils = [\n") : text.index("# Resistance")]
    text = text.replace(groups, "coils = [[1, 5], [2, 6], [3, 7], [4, 8]]\n").replace("series-opposed", "series-aiding")
    with pytest.raises(DeviceError, match="about 1 of three axes"):
        parse(text, "mine")


def test_python_is_told_pythons_option_and_the_command_line_its_own():
    with pytest.raises(DeviceError, match="override=True") as refused:
        haptorb.load("pmsm-printed")
    assert "--" not in str(refused.value)
    assert "--override" in refused.value.command_message
    assert "=True" not in refused.value.command_message


def test_groups_with_missing_or_repeated_coils_are_named():
    assert "group 1 names EM33, but there are only 24" in refusal(("[1, 13]", "[1, 33]"))
    message = refusal(("[2, 14]", "[1, 14]"))
    assert "EM1 appears 2 times" in message
    assert "EM2 is in no group" in message
    assert "group 1 names EM0" in refusal(("[1, 13]", "[0, 13]"))


def test_grouping_gives_signs():
    matrix, wrong = grouping([[1, 3], [2]], 3, "series-opposed")
    assert not wrong
    np.testing.assert_array_equal(matrix, [[1, 0], [0, 1], [-1, 0]])


def test_wiring_that_follows_from_places_and_magnets_is_that_of_the_file():
    pmsm, three = haptorb.load("pmsm"), haptorb.load("pmsm-three-rings")
    for base in (pmsm, three):  # one of them opposed, the other aiding
        text = f'based_on = "{base.name}"\nname = "own"\n[groups]\ncoils = "antipodal"\nwinding = "matched"\n'
        np.testing.assert_array_equal(parse(text, "own").groups, base.groups)
    rings = '[{{ latitude = "{lat} deg", count = {n}, first = "0 deg", step = "even" }}]'
    text = 'based_on = "pmsm"\nname = "own"\n[electromagnets]\nrings = {}\n[groups]\ncoils = "antipodal"\n'
    with pytest.raises(DeviceError, match="rank 2"):  # nine coils around the equator face none
        parse(text.format(rings.format(lat=0, n=9)), "own")
    even = 'based_on = "pmsm"\nname = "own"\n[sensors]\nrings = ' + rings.format(lat=0, n=16)
    longitudes = np.degrees(np.arctan2(*parse(even, "own").sensor_layout.directions[:3, 1::-1].T))
    assert longitudes == pytest.approx([0, 22.5, 45])


def test_no_gap_between_rotor_and_stator_is_caught():
    assert "(gap between rotor and stator)" in refusal(('distance = "67.9 mm"', 'distance = "64 mm"'))


def test_magnets_that_overlap_are_named():
    assert "PM1 and PM2" in refusal(('radius = "15.875 mm"', 'radius = "17 mm"'))


def test_sensors_in_the_way_are_caught():
    swept = refusal(('distance = "62.4 mm"', 'distance = "66 mm"'))
    assert "(sensors clear of coils and magnets)" in swept
    assert "the magnets at a latitude" in swept
    inside = (
        ('distance = "62.4 mm"', 'distance = "56 mm"'),
        ('count = 16, first = "0 deg"', 'count = 16, first = "10 deg"'),
    )
    assert re.search(r"sensor \d+ and EM\d+", refusal(*inside))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('radius = "15.875 mm"', 'radius = "3 kg"', r"device 'mine': magnets\.radius must be a length; got '3 kg'"),
        ('radius = "15.875 mm"', 'radius = "-1 mm"', r"magnets\.radius"),
        ('inner_radius = "4.764 mm"', 'inner_radius = "20 mm"', r"inner_radius \(20 mm\) must be smaller"),
        ("turns = 1000", "turns = 0", r"electromagnets\.turns"),
        ('winding = "series-opposed"', 'winding = "parallel"', r"groups\.winding"),
        ('polarity = "checkerboard"', 'polarity = "stripes"', r"magnets\.polarity must be 'checkerboard'"),
        ('polarity = "checkerboard"', "polarity = [1, -1]", r"24 magnets but 2 values of polarity"),
        ('polarity = "checkerboard"', "polarity = [nan, 1]", r"magnets\.polarity"),
        ('tilt = "22.5 deg"', 'tilt = "100 deg"', r"workspace\.tilt"),
        ('tilt = "22.5 deg"', 'tild = "22.5 deg"', r"did you mean 'tilt'"),
        ("count = 12", "count = 0", r"count"),
        ('title = "PMSM', 'based_on = "pmsn"\ntitle = "PMSM', r"did you mean 'pmsm'"),
    ],
)
def test_bad_values_are_named(old, new, message):
    with pytest.raises((DeviceError, haptorb.errors.UnknownName), match=message):
        parse(change_text((old, new)), "mine")


def test_a_device_based_on_itself_is_refused(tmp_path):
    path = tmp_path / "loop.toml"
    path.write_text(f'based_on = "{path}"\nname = "loop"\ntitle = "loop"\n')
    with pytest.raises(DeviceError, match="without a cycle"):
        haptorb.load(path)


def test_a_variant_changes_only_what_it_says_and_has_its_own_digest():
    base, variant = haptorb.load("pmsm"), haptorb.load("pmsm-in-phase")
    assert base.digest != variant.digest
    np.testing.assert_array_equal(base.electromagnets.directions, variant.electromagnets.directions)
    assert not np.array_equal(base.polarity, variant.polarity)
    assert variant.assumed == base.assumed


OLD_REGULATOR = """
based_on = "pmsm"
name = "old"
[regulator]
stator = { outer_radius = "70 mm", inner_radius = "62 mm", length = "5 mm", height = "-70 mm" }
rotor = { outer_radius = "25 mm", inner_radius = "17 mm", length = "5 mm", height = "-55 mm" }
"""


def drawn_in_ring(motor, count, draw):
    """(count, 3) points in the regulator's ring on the rotor, rotor frame."""
    ring, height = motor.regulator.rotor_ring, motor.regulator.rotor_height
    rho = np.sqrt(draw.uniform(ring.inner_radius**2, ring.outer_radius**2, count))
    phi, z = draw.uniform(0, 2 * np.pi, count), height + draw.uniform(-0.5, 0.5, count) * ring.length
    return np.stack([rho * np.cos(phi), rho * np.sin(phi), z], axis=1)


@pytest.mark.parametrize("name", ["pmsm", "pmsm-three-rings"])
def test_the_regulators_ring_meets_no_coil_and_leaves_room_for_the_column(name):
    """Drawn tilts of the whole workspace, points drawn in the ring; the check takes its border and the ring's edges."""
    motor, draw = haptorb.load(name), np.random.default_rng(5)
    points = drawn_in_ring(motor, 4000, draw)
    tilt = motor.workspace_tilt
    nearest = np.inf
    for psi, lam in [(tilt, tilt), (tilt, -tilt), (tilt, 0.0), *draw.uniform(-tilt, tilt, (60, 2))]:
        at = points @ rotation_from_euler(psi, lam, 0.0).T
        for frame, place in zip(motor.electromagnets.frames, motor.electromagnets.positions, strict=True):
            own = (at - place) @ frame
            coil = motor.electromagnet
            full = (np.hypot(own[:, 0], own[:, 1]) < coil.outer_radius) & (np.abs(own[:, 2]) < coil.length / 2)
            assert not full.any()
        nearest = min(nearest, np.hypot(at[:, 0], at[:, 1]).min())
    assert nearest > 5e-3


def test_a_ring_that_tilts_into_a_coil_is_refused():
    """The regulator of 5e5cc684: an audit found its ring in a coil from 17° on, and no place for a column."""
    with pytest.raises(BuildError) as refused:
        parse(OLD_REGULATOR, "old")
    found = {check.condition: check for check in refused.value.failures}
    assert set(found) == {"regulator's ring on the rotor free to move", "room for the column that carries the stator"}
    motor, draw = parse(OLD_REGULATOR, "old", override=True), np.random.default_rng(6)
    coil, points = motor.electromagnet, drawn_in_ring(motor, 4000, draw)

    def meets(tilt):
        for psi, lam in draw.uniform(-tilt, tilt, (400, 2)):
            at = points @ rotation_from_euler(psi, lam, 0.0).T
            for frame, place in zip(motor.electromagnets.frames, motor.electromagnets.positions, strict=True):
                own = (at - place) @ frame
                if ((np.hypot(own[:, 0], own[:, 1]) < coil.outer_radius) & (np.abs(own[:, 2]) < coil.length / 2)).any():
                    return True
        return False

    assert meets(np.radians(22.5))
    assert not meets(np.radians(15.0))


def test_the_regulator_holds_the_weight_also_where_both_tilts_are_full():
    motor = haptorb.load("pmsm")
    weight = motor.rotor.mass * 9.80665 * motor.rotor.centre_of_mass
    for tilt in np.radians([1.0, 10.0, 20.0, 31.3]):
        assert motor.regulator.torque(tilt) == pytest.approx(weight * np.sin(tilt), rel=0.135)


@pytest.mark.slow
def test_what_the_coils_do_to_the_regulators_ring_is_told_and_small():
    """Against filaments of the coil in the ring's field: the torque of the nearest coil at the worst tilt."""
    motor = haptorb.load("pmsm")
    share = measure_ring_pull(motor)
    ring, tilt = motor.regulator.rotor_ring, motor.workspace_tilt
    radii, heights, turns = motor.electromagnet.filaments(6, 4)
    phi = 2 * np.pi * (np.arange(90) + 0.5) / 90
    most = greatest = 0.0
    for R in (rotation_from_euler(tilt, 0.0, 0.0), rotation_from_euler(tilt, tilt, 0.0)):
        middle = motor.regulator.rotor_height * R[:, 2]
        for frame, place in zip(motor.electromagnets.frames, motor.electromagnets.positions, strict=True):
            torque = np.zeros(3)
            for radius, height, count in zip(radii.ravel(), heights.ravel(), turns.ravel(), strict=True):
                own = np.stack([radius * np.cos(phi), radius * np.sin(phi), np.full(90, height)], axis=1)
                along = np.stack([-np.sin(phi), np.cos(phi), np.zeros(90)], axis=1) * 2 * np.pi * radius / 90
                at, step = own @ frame.T + place, along @ frame.T
                field = -ring.field((at - middle) @ R) @ R.T  # polarized along the rotor's −z
                torque -= count * np.cross(at, np.cross(step, field)).sum(axis=0)  # on the ring: what the coil has not
            most = max(most, np.linalg.norm(torque))
        greatest = max(greatest, np.linalg.norm(motor.torque_characteristic(R[None], "exact")[0], axis=0).max())
    assert share == pytest.approx(most / greatest, rel=0.06)
    assert 0.03 < share < 0.1


def test_two_rings_of_the_regulator_that_meet_are_refused():
    base = '[regulator.stator]\nouter_radius = "70 mm"\ninner_radius = "50 mm"\nheight = "-50 mm"\n'
    with pytest.raises(BuildError) as refused:
        parse(f'based_on = "pmsm"\nname = "own"\n{base}', "own")
    found = {check.condition for check in refused.value.failures}
    assert found >= {"regulator's ring on the rotor free to move", "magnets free to move"}
