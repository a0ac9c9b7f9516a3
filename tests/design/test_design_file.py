"""Design files: parsing, and the message of each mistake."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from haptorb.errors import InputError
from haptorb_design.design_file import load_design
from haptorb_design.evaluate import evaluate
from oracles.designs.small_design import CODE, TEXT, make_design, write_design


def test_a_design_as_its_file_says_it(tmp_path: Path) -> None:
    design = make_design(tmp_path)
    radius, angle, shell = design.parameters
    assert (radius.unit, radius.low, radius.high, radius.step) == ("mm", 26.0, 34.0, 0.0)
    assert (angle.unit, angle.step, shell.labels) == ("deg", 5.0, ("thin", "thick"))
    assert [(goal.name, goal.sense, goal.quantity.unit) for goal in design.goals] == [
        ("cost", "minimise", "m"),
        ("reach", "maximise", ""),
    ]
    assert design.bounds[0].high == pytest.approx(0.031)
    assert design.goals[0].quantity.text.startswith("Radius of the dome")


def test_units_places_and_shares_of_the_base_device(tmp_path: Path) -> None:
    text = TEXT.replace('high = "34 mm"', 'high = "3.4 cm"').replace('at_most = "31 mm"', 'at_most = "1.1 base"')
    text = text.replace(
        '["dome.radius"]', '["dome.radius", { key = "tool.outer_radius", factor = 0.2, offset = "1 mm" }]'
    )
    design = make_design(tmp_path, text)
    assert design.parameters[0].high == pytest.approx(34.0)
    assert design.bounds[0].high == pytest.approx(1.1 * 0.030)
    assert (design.parameters[0].places[1].factor, design.parameters[0].places[1].offset) == (0.2, 1.0)


def test_the_digest_is_of_file_functions_and_base_device(tmp_path: Path) -> None:
    digests = set()
    for number, (text, code) in enumerate(
        [
            (TEXT, CODE),
            (TEXT + "\n# remark\n", CODE),
            (TEXT, CODE + "\n"),
            (TEXT.replace('"bare.toml"', '"omni-fingertip"'), CODE),
        ]
    ):
        folder = tmp_path / str(number)
        folder.mkdir()
        digests.add(make_design(folder, text, code).digest)
    assert len(digests) == 4
    assert make_design(tmp_path).digest in digests


def test_the_digest_is_of_what_a_function_imports_from_beside_it_too(tmp_path: Path) -> None:
    (tmp_path / "tools_of_own").mkdir()
    inner = tmp_path / "tools_of_own" / "inner.py"
    (tmp_path / "first_of_own.py").write_text("def late():\n    from tools_of_own.inner import three\n")
    code = "import json, first_of_own\n" + CODE
    digests = set()
    for text in ("three = 3\n", "three = 4\n"):
        inner.write_text(text)
        digests |= {make_design(tmp_path, code=code).digest, make_design(tmp_path, code=code).digest}
    assert len(digests) == 2


def test_a_base_device_beside_the_file(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text('based_on = "omni"\nname = "mine"\n[dome]\nfriction = 0.2\n')
    design = make_design(tmp_path, TEXT.replace('"bare.toml"', '"mine.toml"'))
    assert evaluate(design, 0, {"radius": 30.0, "angle": 60.0, "shell": "thin"}).valid
    assert design.base == str(tmp_path / "mine.toml")


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('base = "bare.toml"', 'base = "omi"', "did you mean 'omni'"),
        ('"dome.radius"', '"dome.radus"', "has no key 'dome.radus'; did you mean 'dome.radius'?"),
        ('"dome.radius"', '"hall.positions.12.1"', "has 9 entries"),
        ('"dome.radius"', '"name"', "identifies the device"),
        ('"dome.radius"', '"dome.shell_thickness"', "is also written by 'radius'"),
        ('"dome.radius"', '"a b"', "parameters.radius.places must be a key"),
        ('"dome.radius"', '"-dome.radius"', "dome.radius must be greater than 0"),
        ('"26 mm"', '"26 deg"', "parameters.radius.high must be in deg"),
        ('low = "26 mm"', 'low = "36 mm"', "parameters.radius.high must be greater than low"),
        ('low = "26 mm"', 'low = "nan mm"', "parameters.radius.low must be a number"),
        ('low = "26 mm"', "low = true", "parameters.radius.low must be a number"),
        ('low = "26 mm"', "", "parameters.radius needs low and high, or choices"),
        ('step = "5 deg"', 'step = "50 deg"', "parameters.angle.step must be"),
        ('thin = "10 mm"', 'thin = "10 kg"', "parameters.shell, thin: dome.shell_thickness must be a length"),
        ('{ thin = "10 mm", thick = "20 mm" }', "[]", "empty list of choices"),
        ('{ thin = "10 mm", thick = "20 mm" }', '["1 mm", "1 mm"]', "'1 mm' appears twice"),
        ('"own.py:cost"', '"own.py:costs"', "objectives.cost: unknown function in"),
        ('"own.py:cost"', '"own.py"', "must be 'file.py:name'"),
        ('"own.py:cost"', '"other.py:cost"', "cannot be read"),
        ('at_most = "31 mm"', 'at_most = "31 kg"', "constraints.room.at_most must be a number in m"),
        ('at_most = "31 mm"', 'at_most = "33 mm"\nat_least = "1 m"', "is above at_most"),
        ('at_most = "31 mm"', "", "needs at_least or at_most"),
        ("[constraints.room]", "[constrains.room]", "constrains is not a known key; did you mean 'constraints'?"),
        ('sense = "maximise"', 'sense = "maximize"', "did you mean 'maximise'?"),
        ('name = "small"', 'name = "Small one"', "name must be a lower-case letter"),
        ('name = "small"', 'name = "small', "not a TOML file"),
    ],
)  # fmt: skip
def test_each_mistake_is_named(tmp_path: Path, old: str, new: str, told: str) -> None:
    assert old in TEXT
    with pytest.raises(InputError) as caught:
        make_design(tmp_path, TEXT.replace(old, new, 1))
    assert told in str(caught.value)
    assert all(line.startswith("design file ") for line in str(caught.value).splitlines())


def test_all_mistakes_at_once(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        make_design(tmp_path, TEXT.replace("dome.radius", "dom.radius").replace("half_angle", "half_angel"))
    assert len(str(caught.value).splitlines()) == 2


@pytest.mark.parametrize(
    ("code", "told"),
    [
        ("import nothing_like_it\n", "line 1: ModuleNotFoundError"),
        ("def cost(:\n", "line 1: SyntaxError"),
        ("raise SystemExit\n", "SystemExit"),
    ],
)
def test_a_file_of_functions_that_fails_says_where(tmp_path: Path, code: str, told: str) -> None:
    with pytest.raises(InputError, match=r"own\.py") as caught:
        load_design(write_design(tmp_path, code=code))
    assert told in str(caught.value)


def test_a_base_device_without_the_number_that_a_bound_wants(tmp_path: Path) -> None:
    code = CODE.replace("def room(candidate):\n", "def room(candidate):\n    return float('nan')\n")
    with pytest.raises(InputError, match=r"constraints\.room: the base device has no number"):
        make_design(tmp_path, TEXT.replace('"31 mm"', '"base"'), code)
    assert np.isfinite(make_design(tmp_path, TEXT, code).bounds[0].high or np.nan)
