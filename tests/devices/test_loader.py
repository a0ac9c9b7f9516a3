"""Device files: parsing, and the message of each mistake."""

from importlib.resources import files

import numpy as np
import pytest

import haptorb
from haptorb.devices.base import DeviceText
from haptorb.devices.build_checks import BuildError
from haptorb.devices.loader import catalogue, load, parse
from haptorb.errors import DeviceError, InputError, UnknownName

OMNI = (files("haptorb.devices") / "catalogue" / "omni.toml").read_text(encoding="utf-8")


def test_the_catalogue_lists_what_can_be_loaded():
    assert "omni" in catalogue()


def test_omni_as_printed():
    omni = load("omni")
    assert np.allclose(np.diag(omni.moment_per_current) * 12.9, (2.52, 2.70, 2.82), atol=2e-3)
    assert omni.contact_distance == pytest.approx(0.050)
    assert omni.tool.moment == pytest.approx(2.407, rel=1e-3)
    assert omni.coils.current_limit.tolist() == [20.0] * 3  # E15: 12 V over 0.6 Ω, not the printed 24 A
    assert (omni.supply.voltage / omni.coils.resistance).tolist() == pytest.approx([20.0] * 3)


def test_what_the_paper_does_not_give_says_so():
    assumed = load("omni").assumed
    assert "tool.mass" in assumed
    assert "tool.remanence" in assumed
    assert "electromagnet.core_radius" not in assumed
    assert all(len(why) > 5 for why in assumed.values())


def test_devices_differ_by_digest():
    assert load("omni").digest != parse(OMNI.replace('"15 mm"', '"14 mm"', 1), "x").digest


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('radius = "30 mm"', 'radius = "3 kg"', "device 'x': dome.radius must be a length; got '3 kg'"),
        ('core_radius = "15 mm"', 'core_radus = "15 mm"', "electromagnet.core_radus is not a known key"),
        ('core_radius = "15 mm"', 'core_radus = "15 mm"', "did you mean 'core_radius'?"),
        ('core_radius = "15 mm"', 'core_radus = "15 mm"', "electromagnet.core_radius is missing"),
        ('outer_radius = "6 mm"', 'outer_radius = "-6 mm"', "tool.outer_radius must be greater than 0; got '-6 mm'"),
        ('inner_radius = "2.5 mm"', 'inner_radius = "7 mm"', "must be smaller than outer_radius"),
        ('voltage = "12 V"', "voltage = 12", "supply.voltage must be a voltage with its unit"),
        ('voltage = "12 V"', 'voltage = "nan V"', "supply.voltage must be a voltage"),
        ('voltage = "12 V"', 'voltage = "inf V"', "supply.voltage must be a finite voltage"),
        ('voltage = "12 V"', "voltage = true", "supply.voltage must be a voltage"),
        ('names = ["x", "y", "z"]', 'names = ["x", "y"]', "coils has 2 names but 3 values of resistance"),
        ('names = ["x", "y", "z"]', 'names = ["x", "y", "y"]', "has a duplicate name"),
        ('kind = "spherical-e', 'kind = "e', "kind must be one of"),
        ('"65 degC"', '"90 degC"', "ambient < warn < derate < stop"),
        ('assumed = "copper"', 'assumed = " "', "must give the reason"),
        ('assumed = "copper"', 'asumed = "copper"', "only the keys value, unit, source and assumed"),
        ("duty_bits = 12", "duty_bits = 12 12", "not a TOML file"),
        ('names = ["front", "left", "rear"]', 'names = ["front", "left"]', "marks.names"),
        ('names = ["front", "left", "rear"]', 'names = ["front", "left", "left"]', "marks has a duplicate name"),
        ("[-25.096, -14.489, 7.765]", "[-28.978, 57.956, 7.765]", "marks must not lie on one line"),
        ("[0.195349, 0.003100, -0.002000]", "[-0.0024, 0.209302, 0.0018]", "singular"),
    ],
)
def test_a_mistake_is_told_with_its_place(old, new, told):
    assert old in OMNI
    with pytest.raises((DeviceError, InputError)) as failure:
        parse(OMNI.replace(old, new, 1), "x")
    assert told in str(failure.value)


def test_all_mistakes_are_told_at_once():
    broken = OMNI.replace('"30 mm"', '"3 kg"', 1).replace('voltage = "12 V"', 'voltage = "12 m"')
    with pytest.raises(DeviceError) as failure:
        parse(broken, "x")
    assert len(str(failure.value).splitlines()) == 2


def test_an_unknown_name_suggests_the_nearest():
    with pytest.raises(UnknownName, match="did you mean 'omni'"):
        load("omi")


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(DeviceError, match="cannot be read"):
        load(tmp_path / "nothing.toml")


def test_a_file_of_bytes(tmp_path):
    path = tmp_path / "bytes.toml"
    path.write_bytes(b"\xff\xfd\x00")
    with pytest.raises(DeviceError, match="not a text file"):
        load(path)


def test_a_device_of_ones_own(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(OMNI.replace('name = "omni"', 'name = "mine"'))
    assert haptorb.load(path).name == "mine"


def test_an_electromagnet_may_be_based_on_another(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('based_on = "omni"\nname = "mine"\ntitle = "a shorter magnet"\n\n[tool]\nlength = "16 mm"\n')
    mine, omni = load(path), load("omni")
    assert (mine.name, mine.tool.length) == ("mine", 16e-3)
    assert mine.tool.outer_radius == omni.tool.outer_radius
    assert mine.digest != omni.digest


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('"60 deg"', '"120 deg"', "dome.workspace_half_angle must be at most 90 deg; got '120 deg'"),
        ("[28.978, 0.0, 7.765]", "[8.978, 0.0, 7.765]", "mark 'front' is 11.9 mm from the centre, inside the dome"),
        ("[55.0, 0.0, 0.0]", "[5.0, 0.0, 0.0]", "hall.positions: sensor 1 is 5 mm from the centre, inside the core"),
        ('value = "1.2 N"', 'value = "1.2 kN"', "limits.force is 1200 N, 984 times what the coils give"),
        ('value = "60 mN*m"', 'value = "60 N*m"', "limits.torque is 60 N·m"),
        ('["20 A", "20 A", "20 A"]', '["20 A", "2 kA", "20 A"]', "coils.current_limit of coil y is 2000 A, but 12 V"),
        ('"15.05 J/K"', '"0.02 J/K"', "past the stop temperature in 5.8 ms"),
    ],
)
def test_what_cannot_be_built_is_refused_with_its_place(old, new, told):
    assert old in OMNI
    with pytest.raises(DeviceError) as failure:
        parse(OMNI.replace(old, new, 1), "x", override=True)
    assert told in str(failure.value)


def test_what_is_possible_but_idle_is_remarked_only():
    assert load("omni-fingertip").remarks == load("pmsm").remarks == ()
    remark = parse(OMNI.replace('value = "1.2 N"', 'value = "20 N"'), "x").remarks[-1]
    assert "limits.force is 20 N, 16 times" in remark
    text = (files("haptorb.devices") / "catalogue" / "pmsm.toml").read_text(encoding="utf-8")
    [remark] = parse(text.replace('value = "1 N*m"', 'value = "200 N*m"'), "x").remarks
    assert "limits.torque is 200 N·m" in remark
    with pytest.raises(DeviceError, match=r"limits\.torque is 2000 N·m"):
        parse(text.replace('value = "1 N*m"', 'value = "2 kN*m"'), "x")


def test_a_dot_in_the_dome_and_a_level_tool_are_possible():
    engraved = OMNI.replace("[28.978, 0.0, 7.765]", "[27.3, 0.0, 7.3]").replace('"60 deg"', '"90 deg"')
    engraved = engraved.replace('"40 mT"', '"200 mT"')  # a level tool comes near the sensors
    with pytest.raises(BuildError, match=r"tool clear of the sensors.*sensor 1"):  # which stand on the equator
        parse(engraved, "x")
    before, title, after = engraved.partition("[hall.positions]")
    below = before + title + after.replace(", 0.0],", ", -30.0],", 9)
    assert parse(below, "x").workspace_half_angle == pytest.approx(np.pi / 2)


@pytest.mark.parametrize("name", ["", 'name = "omni"\n'])
def test_a_variant_needs_a_name_of_its_own(name):
    with pytest.raises(DeviceError, match="a name of its own, other than 'omni'"):
        parse(f'based_on = "omni"\n{name}[tool]\nlength = "20 mm"\n', "x")


def test_a_variant_without_a_title_is_told_from_its_base():
    assert parse('based_on = "omni"\nname = "short"\n', "x").title == f"{load('omni').title} (short)"


def test_a_device_knows_its_file_and_those_that_it_is_based_on(tmp_path):
    mine = tmp_path / "mine.toml"
    mine.write_text('based_on = "omni"\nname = "mine"\n', encoding="utf-8")
    text = load(mine).text
    assert text == DeviceText(mine.read_text(encoding="utf-8"), {"omni": OMNI})
    assert DeviceText.from_note(text.as_note()) == text
    other = OMNI.replace('"12 V"', '"13 V"')
    assert parse(text.own, "x", bases={"omni": other}).supply.voltage == 13.0  # as it was then, not as it is here
    assert parse(text.own, "x", bases={}).digest == load(mine).digest
    with pytest.raises(DeviceError, match="is missing"):
        parse(f'based_on = "{mine}"\nname = "x"\n', "x", bases={})  # no file of this computer is read for a recording
    assert DeviceText.from_note({"file": "x", "bases": "[" * 9000}) == DeviceText("x")
    assert DeviceText.from_note({"file": ""}) is None


def test_a_variant_tells_what_it_states_itself():
    text = 'based_on = "omni"\nname = "mine"\ndrop = ["marks"]\n[tool]\nlength = { value = "20 mm", assumed = "why" }'
    told = parse(text, "x").text.inheritance
    assert (told.base, told.own, told.dropped) == ("omni", ("tool.length",), ("marks",))
    assert load("omni").text.inheritance is None
