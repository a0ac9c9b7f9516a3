"""Files of candidate designs: the resulting candidates, and the message of each mistake."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from haptorb.errors import InputError
from haptorb.worlds import Outlet, SnapFit
from haptorb_study.feel import course, load_designs
from haptorb_study.feel import designs as module

EXAMPLE = Path(module.__file__).with_name("example.toml")

OUTLET = """
title = "Outlet of Bai 2012"
world = "outlet"
beam = "paper"
force_scale = 0.25

[common]
material = "phosphor bronze"
friction = 0.134
base_length = "5.4 mm"
thickness = "0.6 mm"
width = "8 mm"
height = "1.8 mm"
retention = "58.8 deg"
plug_width = "6.3 mm"
opening = "4.8 mm"

[design.printed]
peak = "9.6 mm"
top = "flat"
"""


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "designs.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_example_is_what_it_says() -> None:
    designs = load_designs(EXAMPLE)
    assert [design.name for design in designs.designs] == ["plain", "firm", "gentle", "slender"]
    assert designs["plain"].world == SnapFit()
    assert designs["firm"].hook.rear == pytest.approx(math.radians(60))
    assert designs.gains.verdict == "power-consistent"
    numbers = {design.name: course(design).numbers for design in designs.designs}
    assert numbers["firm"]["pull_out_force_n"] > 1.5 * numbers["plain"]["pull_out_force_n"]
    assert numbers["gentle"]["insertion_force_n"] < 0.8 * numbers["plain"]["insertion_force_n"]
    assert numbers["slender"]["root_strain"] < numbers["plain"]["root_strain"]
    assert numbers["plain"]["root_strain"] == pytest.approx(0.012, abs=0.003)
    for values in numbers.values():  # what goes in and comes out again costs work: friction
        assert values["insertion_work_j"] + values["pull_out_work_j"] > 0


def test_an_outlet_by_the_paper(tmp_path: Path) -> None:
    designs = load_designs(write(tmp_path, OUTLET))
    (design,) = designs.designs
    assert design.world == Outlet(beam="paper")
    assert designs.gains.verdict == "scaled"
    assert course(design).numbers["pull_out_force_n"] == pytest.approx(49.5, abs=0.2)
    assert design.remarks == (design.world.root_load.sentence,)  # beyond yield; the flat top was asked for


def test_a_design_is_known_by_what_makes_its_feel(tmp_path: Path) -> None:
    first = load_designs(write(tmp_path, OUTLET)).designs[0].digest
    assert load_designs(write(tmp_path, OUTLET.replace("Outlet of", "The outlet of"))).designs[0].digest == first
    assert load_designs(write(tmp_path, OUTLET.replace("0.134", "0.135"))).designs[0].digest != first


def test_e8_contradicting_sizes_are_told_with_the_amount(tmp_path: Path) -> None:
    with pytest.raises(InputError) as told:
        load_designs(write(tmp_path, OUTLET.replace('top = "flat"', "")))
    for part in ("designs.toml", "design 'printed'", "6.935 mm", "5.135 mm too much", "E8"):
        assert part in str(told.value)


def test_e7_a_soft_metal_is_remarked_upon(tmp_path: Path) -> None:
    text = OUTLET.replace("friction", 'youngs_modulus = "1.13 GPa"\nfriction')
    (design,) = load_designs(write(tmp_path, text)).designs
    assert any("E7" in remark and "1.13 GPa" in remark for remark in design.remarks)
    text = text.replace('material = "phosphor bronze"', 'material = "resin"\npoisson_ratio = 0.4')
    (design,) = load_designs(write(tmp_path, text)).designs
    assert not any("E7" in remark for remark in design.remarks)


def test_a_metal_among_the_plastics_is_remarked_upon(tmp_path: Path) -> None:
    text = OUTLET.replace('"phosphor bronze"', '"ABS"\nyoungs_modulus = "113 GPa"')
    (design,) = load_designs(write(tmp_path, text)).designs
    assert any("typical of a metal" in remark for remark in design.remarks)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('"0.6 mm"', '"0.6 kg"', "thickness must be a length; got '0.6 kg'"),
        ('"0.6 mm"', "0.6", "thickness must be a length with its unit"),
        ('"0.6 mm"', '"-0.6 mm"', "thickness must be greater than 0"),
        ("0.134", "7", "friction must be at most 1; got 7"),
        ('thickness = "0.6 mm"', "", "thickness is missing"),
        ("thickness", "thicknes", "thicknes is not a known key; did you mean 'thickness'?"),
        ("friction", "poisson_ratio = 0.6\nfriction", "poisson_ratio must be less than 0.5; got 0.6"),
        ('"phosphor bronze"', '"phosphor bronce"', "did you mean 'phosphor bronze'?"),
        (
            'world = "outlet"',
            'world = "socket"',
            "must be 'snap_fit', 'outlet' or a file FILE.py:NAME; got",
        ),
        ("plug_width", "half_width", "half_width is a key of world 'snap_fit'"),
        ('"4.8 mm"', '"7 mm"', "not wider than the opening"),
        ('"58.8 deg"', '"95 deg"', "rear must be less than 90°"),
        ("[design.printed]", "[designs.printed]", "design is missing"),
        ("title", "title = ", "is not TOML"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, old: str, new: str, told: str) -> None:
    with pytest.raises(InputError) as caught:
        load_designs(write(tmp_path, OUTLET.replace(old, new, 1)))
    assert told in str(caught.value)
    assert "designs.toml" in str(caught.value)


def test_all_mistakes_are_told_at_once(tmp_path: Path) -> None:
    text = OUTLET + '\n[design.second]\npeak = "9 kg"\n[design.third]\npeak = "9.6 mm"\ntop = "round"\n'
    with pytest.raises(InputError) as caught:
        load_designs(write(tmp_path, text))
    assert "design 'second': peak" in str(caught.value)
    assert "design 'third': top" in str(caught.value)


def test_files_that_are_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        load_designs(tmp_path / "none.toml")
    with pytest.raises(InputError, match="unknown design 'x'; known: plain"):
        load_designs(EXAMPLE)["x"]
