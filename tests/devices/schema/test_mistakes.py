"""Messages on mistakes in files: once each, in the file's own words, list entries counted from one."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import pytest

from haptorb.devices.loader import parse
from haptorb.errors import DeviceError, InputError
from haptorb_study.feel.designs import load_designs
from haptorb_study.study_file import study_of

CATALOGUE = files("haptorb.devices") / "catalogue"
OMNI, PMSM = ((CATALOGUE / f"{name}.toml").read_text(encoding="utf-8") for name in ("omni", "pmsm"))
DESIGN = 'title = "a"\nworld = "snap_fit"\n[common]\nmaterial = "ABS"\nfriction = 0.3\n[design.a]\n[design.b]\n'


def refusal(text: str) -> list[str]:
    with pytest.raises(DeviceError) as refused:
        parse(text, "x")
    return [line.removeprefix("device 'x': ") for line in str(refused.value).splitlines()]


@pytest.mark.parametrize(
    ("text", "old", "new", "told"),
    [
        (PMSM, 'first = "22.5 deg"', 'first = "22.5 mm"', ["electromagnets.rings.1.first must be an angle"]),
        (PMSM, "strengths = [33.5,", 'strengths = ["a",', ["magnets.multipole.strengths.1 must be a plain number"]),
        (PMSM, "[1, 13]", '[1, "13"]', ["groups.coils.1.2 must be a whole number; got '13'"]),
        (PMSM, 'tilt = "22.5 deg"', 'tilt = "95 deg"', ["workspace.tilt must be less than 90 deg; got '95 deg'"]),
        (PMSM, 'latitude = "-15 deg"', 'latitude = "-95 deg"', ["magnets.rings.1.latitude must be at least -90 deg"]),
        (PMSM, "antipodal = true", 'antipodal = "yes"', ["groups.antipodal must be true or false; got 'yes'"]),
        (
            PMSM,
            '"series-opposed"',
            '"series-oposed"',
            ["groups.winding must be 'series-aiding', 'series-opposed' or 'matched'"],
        ),
        (OMNI, "[38.891, 38.891, 0.0]", "[38.891, 38.891]", ["hall.positions.6 must have at least 3 entries; got 2"]),
        (
            OMNI,
            'names = ["front", "left", "rear"]',
            "names = []",
            ["marks.names must have at least 3 entries; got none"],
        ),
        (OMNI, "[28.978, 0.0, 7.765]", '["a", 0.0, 7.765]', ["marks.positions.1.1 must be a length"]),
        (OMNI, 'name = "omni"', 'name = "My Omni"', ["name must be a lower-case letter, then"]),
        (OMNI, 'voltage = "12 V"\n', "", ["supply.voltage is missing: voltage of the supply"]),
        (OMNI, '[dome]\nradius = "30 mm"', "[dome]", ["dome.radius is missing: outer radius of the dome"]),
        (
            OMNI,
            'length = "24 mm"',
            'length = "24 mm"\nlenght = "1 mm"',
            ["tool.lenght is not a known key"],
        ),
    ],
)
def test_one_mistake_is_one_line(text: str, old: str, new: str, told: list[str]) -> None:
    assert old in text
    lines = refusal(text.replace(old, new, 1))
    assert len(lines) == len(told)
    for line, begin in zip(lines, told, strict=True):
        assert line.startswith(begin)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('name = "a b"', "name must be at most 41 letters"),
        ('name = "a"\nprocedure = "forced-choic"', "did you mean 'forced-choice'?"),
        ('name = "a"\n[set_points]\npoints = [{ number = 1, theta_deg = "3" }]', "points.1.theta_deg must be a number"),
        ('name = "a"\n[[questions]]\nname = "b"', "questions.1.text is missing: the question"),
        ('name = "a"\n[parameters]\nmoment = "big"', "parameters.moment must be a number, or a list of three"),
        ('name = "a"\n[trials]\nrepetitions = 2.5', "trials.repetitions must be a whole number; got 2.5"),
    ],
)
def test_a_study_files_mistake_is_one_sentence(text: str, told: str) -> None:
    with pytest.raises(InputError) as refused:
        study_of(text)
    assert told in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1
    assert "Input should" not in str(refused.value)


def test_a_mistake_in_common_is_told_once_and_not_for_every_design(tmp_path: Path) -> None:
    path = tmp_path / "designs.toml"
    path.write_text(DESIGN.replace("friction = 0.3", 'friction = 7\nwidht = "6 mm"'))
    with pytest.raises(InputError) as refused:
        load_designs(path)
    assert str(refused.value).count("friction must be at most 1") == 1
    assert str(refused.value).count("widht") == 1
    path.write_text(DESIGN.partition("[design.a]")[0] + "[design]\n")
    with pytest.raises(InputError, match="design must have at least 1 entry; got none"):
        load_designs(path)
