"""A candidate's device equals the device of its written file, for every form of key."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from haptorb.devices.loader import load
from haptorb.errors import DeviceError, InputError
from haptorb_design.design_file import parse_design
from haptorb_design.problem import Design, build_device, write_device_text
from oracles.designs.small_design import CODE

HEAD = 'name = "d"\nbase = "{base}"\n[objectives.cost]\nfunction = "own.py:cost"\n'
OMNI = """
[parameters.a]
low = "50 mm"
high = "6 cm"
places = ["hall.positions.1.1", "-hall.positions.2.1", { key = "windings.length.2", factor = 0.25, offset = "2.5 mm" }]
[parameters.turns]
low = 90
high = 100
step = 2
places = ["windings.turns.1"]
[parameters.friction]
low = 0.1
high = 0.2
places = ["dome.friction"]
[parameters.noise]
choices = { good = { noise = "0.01 mT", step = "0.005 mT" } }
places = ["hall"]
"""
PMSM = """
[parameters.latitude]
low = "26 deg"
high = "30 deg"
places = ["electromagnets.rings.2.latitude", "-electromagnets.rings.1.latitude"]
[parameters.count]
low = 11
high = 12
step = 1
places = ["magnets.rings.1.count"]
"""


def make(folder: Path, base: str, text: str) -> Design:
    (folder / "own.py").write_text(CODE)
    return parse_design(HEAD.format(base=base) + text, "d.toml", folder)


def test_the_file_that_is_written_is_the_device_that_was_computed(tmp_path: Path) -> None:
    design = make(tmp_path, "omni", OMNI)
    values = {"a": 57.25, "turns": 92.0, "friction": 0.125, "noise": "good"}
    device = build_device(design, values, "found-1")
    path = tmp_path / "found.toml"
    path.write_text(write_device_text(design, values, "found-1"), encoding="utf-8")
    again = load(path)
    assert (again.digest, again.name, again.title) == (device.digest, "found-1", device.title)
    assert again.assumed == device.assumed
    assert again.text == device.text  # what a recording of it keeps
    assert device.hall.positions[0].tolist() == [0.05725, 0.0, 0.0]
    assert device.hall.positions[1, 0] == -0.05725
    assert device.hall.positions[2:].tolist() == load("omni").hall.positions[2:].tolist()
    assert device.hall.noise == pytest.approx(1e-5)
    assert device.windings.length[1] == pytest.approx(0.016812, abs=1e-6)
    assert device.windings.turns[0] == 92
    assert "d" in device.assumed["dome.friction"]
    assert device.assumed["hall.positions"] == device.assumed["dome.friction"]  # no longer why the base had them
    assert "hall.offset" in device.assumed


def test_lists_of_tables_and_whole_numbers(tmp_path: Path) -> None:
    design = make(tmp_path, "pmsm", PMSM)
    values = {"latitude": 27.5, "count": 12.0}
    device = build_device(design, values)
    path = tmp_path / "found.toml"
    path.write_text(write_device_text(design, values, "candidate"), encoding="utf-8")
    assert load(path).digest == device.digest
    latitudes = np.degrees(np.arcsin(device.electromagnets.directions[:, 2]))
    assert np.allclose(latitudes[:16], np.repeat([-27.5, 27.5], 8))
    assert np.allclose(latitudes[16:], 0.0)
    with pytest.raises(DeviceError, match="magnets"):  # eleven of one ring are no checkerboard, or are in their way
        build_device(design, {"latitude": 27.5, "count": 40.0})


def test_a_parameter_may_write_into_the_choice_of_an_earlier_one(tmp_path: Path) -> None:
    ring = '{{ latitude = "{} deg", count = 8, first = "0 deg", step = "45 deg" }}'
    two, three = (f"[{', '.join(ring.format(angle) for angle in angles)}]" for angles in ((-20, 20), (-35, 0, 35)))
    design = make(tmp_path, "pmsm", f"""
[parameters.rings]
choices = {{ three = {three}, two = {two} }}
places = ["magnets.rings"]
[parameters.third]
low = "30 deg"
high = "40 deg"
places = ["magnets.rings.3.latitude"]
""")  # fmt: skip
    text = write_device_text(design, {"rings": "three", "third": 37.5}, "x")
    assert '"37.5 deg"' in text
    with pytest.raises(InputError, match=r"'magnets\.rings\.3\.latitude' does not exist with these values"):
        build_device(design, {"rings": "two", "third": 37.5})


def test_one_choice_may_write_several_tables(tmp_path: Path) -> None:
    """The number of a coil array's coils: names, places and resistances go together."""
    places = '["0 mm", "0 mm", "-20 mm"], ["19 mm", "0 mm", "7 mm"], ["-10 mm", "16 mm", "7 mm"]'
    axes = "[0, 0, -1], [1, 0, 0.3], [-0.5, 0.8, 0.3]"
    each = 'resistance = ["0.72 ohm", "0.72 ohm", "0.72 ohm"], inductance = ["1 mH", "1 mH", "1 mH"]'
    count = f"""
[parameters.count.choices.three]
windings = {{ position = [{places}], axis = [{axes}], fill = 0.6 }}
coils = {{ names = ["a", "b", "c"], {each}, current_limit = ["15 A", "15 A", "15 A"] }}
[parameters.count.choices.four]
supply = {{ voltage = "24 V" }}
"""
    design = make(tmp_path, "tetrahedron", f'[parameters.count]\nplaces = ["*"]\n{count}')
    three, four = (build_device(design, {"count": label}) for label in ("three", "four"))
    assert (three.channels, four.channels, three.supply.voltage, four.supply.voltage) == (3, 4, 12.0, 24.0)
    assert "d" in three.assumed["windings.position"]
    path = tmp_path / "found.toml"
    path.write_text(write_device_text(design, {"count": "three"}, "candidate"), encoding="utf-8")
    assert load(path).digest == three.digest
    for text, message in (
        ('[parameters.a]\nchoices = ["12 V"]\nplaces = ["*"]\n', "every choice must be a table of tables"),
        (f'[parameters.a]\nplaces = ["*"]\n{count.replace("count", "a").replace("voltage", "volts")}',
         "has no key 'supply.volts'"),
        (f'[parameters.a]\nchoices = ["9 V"]\nplaces = ["supply.voltage"]\n[parameters.count]\nplaces = ["*"]\n{count}',
         "'supply.voltage' is also written by 'a'"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=message):
            make(tmp_path, "tetrahedron", text)


def test_values_must_be_those_of_the_design(tmp_path: Path) -> None:
    design = make(tmp_path, "omni", OMNI)
    with pytest.raises(InputError, match="check 'a'"):
        build_device(design, {"turns": 92.0, "friction": 0.125, "noise": "good"})
    with pytest.raises(InputError, match="not one of its choices: good"):
        build_device(design, {"a": 57.0, "turns": 92.0, "friction": 0.125, "noise": "bad"})
    with pytest.raises(InputError, match="is a number"):
        build_device(design, {"a": "good", "turns": 92.0, "friction": 0.125, "noise": "good"})
