"""`haptorb inspect A B …`: all numbers of all devices at any width, curves, and mistakes in one line."""

from __future__ import annotations

import io
import json
from importlib.resources import files

import numpy as np
import pytest
from rich.console import Console

import haptorb
from haptorb.cli.cards import card
from haptorb.cli.comparison import Comparison, name_devices
from haptorb.devices.loader import load
from haptorb.errors import InputError
from oracles.command import run_command

LONGER = """
based_on = "omni"
name = "longer"
title = "Omni with a longer tool magnet"
[tool]
length = "30 mm"
"""


@pytest.fixture(scope="module")
def longer(tmp_path_factory):
    path = tmp_path_factory.mktemp("devices") / "longer.toml"
    path.write_text(LONGER, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def cards(longer):
    return [card(load(name)) for name in ("omni", "pmsm", str(longer))]


@pytest.fixture(scope="module")
def three(cards):
    return Comparison(cards, ["omni", "pmsm", "longer"])


def text_of(report, width):
    out = io.StringIO()
    report.show(Console(file=out, width=width))
    return out.getvalue()


@pytest.mark.parametrize("width", [80, 120, 60])
def test_every_number_of_every_device_is_whole_at_every_width(three, width):
    text = text_of(three, width)
    assert all(len(line) <= width for line in text.splitlines())
    words = text.split()
    for one in three.cards:
        for quantity in one.quantities():
            assert set(quantity.text.split()) <= set(words)
            assert all(word in words for word in quantity.head.split())


def test_a_quantity_that_a_kind_does_not_have_is_a_dash(three):
    rows = [line for line in text_of(three, 120).splitlines() if line.startswith("peak radial force in contact [mN]")]
    assert rows[0].split()[-3:] == [f"{1e3 * three.cards[0].numbers()['layers'][0]['peak_radial_n']:.0f}", "-",
                                    f"{1e3 * three.cards[2].numbers()['layers'][0]['peak_radial_n']:.0f}"]  # fmt: skip


def test_two_of_a_kind_have_their_change(cards):
    omni, _, long = cards
    text = text_of(Comparison([omni, long], ["omni", "longer"]), 100)
    row = next(line for line in text.splitlines() if line.startswith("moment of the tool"))
    assert row.split()[-1] == "+25"  # 30 mm for 24 mm
    row = next(line for line in text.splitlines() if line.startswith("supply"))
    assert row.split()[-1] == "0"


def test_curves_lie_over_each_other_with_units_and_a_legend(three):
    figure = three.draw()
    force = next(axes for axes in figure.axes if axes.get_title(loc="left").startswith("Radial force"))
    assert "[mm]" in force.get_xlabel()
    assert "[mN]" in force.get_ylabel()
    layers = three.cards[0].numbers()["layers"]
    peak = force.lines[0]
    assert peak.get_ydata() == pytest.approx([1e3 * layer["peak_radial_n"] for layer in layers])
    colours = {line.get_color() for line in force.lines}
    assert len(colours) == 2  # omni and longer; the motor has no such curve
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["omni", "pmsm", "longer"]
    endurance = next(axes for axes in figure.axes if axes.get_title(loc="left").startswith("Endurance"))
    assert len({line.get_color() for line in endurance.lines}) == 3


def test_the_command_compares_and_json_is_a_list(capsys, longer, tmp_path):
    picture = tmp_path / "both.pdf"
    code, out, _ = run_command(capsys, "inspect", "omni", str(longer), "--json", "--plot", str(picture))
    assert code == 0
    told = json.loads(out)
    assert [one["name"] for one in told] == ["omni", "longer"]
    assert told[1]["tool_moment_a_m2"] == pytest.approx(1.25 * told[0]["tool_moment_a_m2"])
    assert picture.read_bytes().startswith(b"%PDF")


def test_one_device_keeps_its_object(capsys):
    assert json.loads(run_command(capsys, "inspect", "omni", "--json")[1])["name"] == "omni"


def test_devices_of_one_name_are_called_by_their_files(longer):
    omni = haptorb.load("omni")
    assert name_devices([omni, omni], ["omni", "copy.toml"]) == ["omni", "copy.toml"]
    assert name_devices([omni, load(longer)], ["omni", "x.toml"]) == ["omni", "longer"]


def test_a_copy_is_said_to_be_one(capsys, tmp_path):
    copy = tmp_path / "copy.toml"
    original = files("haptorb.devices") / "catalogue" / "omni.toml"
    copy.write_text(original.read_text(encoding="utf-8"), encoding="utf-8")
    _, out, _ = run_command(capsys, "inspect", "omni", str(copy))
    assert "the same in every value" in out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["omni", "omni"], "device 'omni' is given twice"),
        (["omni", "pmsn"], "did you mean 'pmsm'"),
        (["omni", "no/such.toml"], "no/such.toml: cannot be read"),
        (["omni", "pmsm", "--assumed"], "one device"),
        (["omni", "--plot", "card.jpg"], "must be a .png, .svg or .pdf file"),
        (["omni", "--plot", "/proc/card.png"], "cannot write '/proc/card.png'"),
        ([], "Missing argument 'devices'"),
    ],
)
def test_a_mistake_is_one_message(capsys, words, said):
    code, out, err = run_command(capsys, "inspect", *words)
    assert code == 2
    assert said in err
    assert not out


def test_too_many_devices_are_refused(cards):
    with pytest.raises(InputError, match="at most 7"):
        Comparison(cards * 3, list("abcdefghi"))


def test_changes_that_divide_by_nothing_are_left_out(cards):
    text = text_of(Comparison([cards[0], cards[2]], ["a", "b"]), 120)
    assert "nan" not in text
    assert "inf" not in text
    assert np.isfinite([one.value for one in cards[0].quantities()]).all()


def test_a_coil_is_called_by_its_name(cards):
    """Not by its number: the coils of the Omni are x, y and z."""
    names = [
        quantity.name for quantity in cards[0].quantities() if "coil" in quantity.name and "moment" in quantity.name
    ]
    assert [name.rsplit(" ", 1)[1] for name in names] == ["x", "y", "z"]
