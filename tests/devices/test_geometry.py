"""Positions of a device's parts: as in its file, part by part."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
import pytest

import haptorb
from haptorb.devices.loader import catalogue, parse

OMNI = (files("haptorb.devices") / "catalogue" / "omni.toml").read_text(encoding="utf-8")


def select_parts(found, role: str):
    return [part for part in found.round_parts if part.role == role]


def geometry(device):
    return device.geometry()


def change(text, *changes):
    """The device of the TOML `text` with words replaced, each of which must be there."""
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    return parse(text, "changed.toml")


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_every_device_has_a_channel_for_every_coil(name):
    device = haptorb.load(name, override=True)
    found = geometry(device)
    coils = select_parts(found, "coil")
    # an arm's motors are somewhere in its base: it has a workspace to draw, and no coils
    assert {coil.channel for coil in coils} == (set() if device.kind.name == "arm" else set(device.coils.names))
    assert coils or found.rods
    assert all(np.linalg.norm(part.axis) == pytest.approx(1.0, abs=1e-12) for part in found.round_parts)
    assert all(0 <= part.inner_radius < part.outer_radius for part in found.round_parts)
    assert len(found.select_spots("sensor")) == device.sensors


def test_windings_of_omni_are_those_of_the_file():
    coils = select_parts(geometry(haptorb.load("omni")), "coil")
    assert [coil.name for coil in coils] == ["x", "y", "z"]
    sizes = np.array([[coil.inner_radius, coil.outer_radius, coil.length] for coil in coils])
    assert sizes == pytest.approx(
        1e-3 * np.array([[15.4, 18.0, 15.1], [19.65, 22.55, 16.8], [24.17, 27.25, 16.3]]), abs=1e-12
    )
    assert all(coil.stated for coil in coils)


def test_a_changed_winding_and_a_changed_core_change_their_parts():
    device = change(
        OMNI, ("[15.4, 19.65, 24.17]", "[15.3, 19.65, 24.17]"), ("[15.1, 16.8, 16.3]", "[15.1, 16.9, 16.3]"),
        ('core_radius = "15 mm"', 'core_radius = "13 mm"'),
    )  # fmt: skip
    found = geometry(device)
    coils = select_parts(found, "coil")
    assert coils[0].inner_radius == pytest.approx(0.0153, abs=1e-12)
    assert coils[1].length == pytest.approx(0.0169, abs=1e-12)
    assert found.balls[0].radius == pytest.approx(0.013, abs=1e-12)


def test_without_windings_a_coil_is_marked_and_stays_between_core_and_dome():
    before, after = OMNI.split("[windings]")
    coils = 'inductance = ["0.4 mH", "0.4 mH", "0.4 mH"]\ncurrent_limit ='
    device = parse(before + after[after.index("[dome]") :].replace("current_limit =", coils), "bare.toml")
    found = geometry(device)
    for coil in select_parts(found, "coil"):
        assert not coil.stated
        assert device.core_radius < coil.inner_radius < coil.outer_radius < device.dome_radius
    assert any(note.startswith("not to scale") for note in found.notes)


def test_the_tool_touches_the_summit():
    device = haptorb.load("omni")
    magnet = select_parts(geometry(device), "magnet")[0]
    assert magnet.position == pytest.approx([0, 0, device.contact_distance])
    assert (magnet.inner_radius, magnet.outer_radius, magnet.length) == (
        device.tool.inner_radius, device.tool.outer_radius, device.tool.length,
    )  # fmt: skip
    assert magnet.moves
    assert magnet.polarity > 0


def test_parts_of_the_motor_are_at_the_places_of_the_paper():
    """Table A.1: EM 17 on the X axis, 56.8 mm from the centre; PM 1 at −15° of latitude, 67.9 mm."""
    found = geometry(haptorb.load("pmsm"))
    coils, magnets = select_parts(found, "coil"), select_parts(found, "magnet")
    assert [coil.name for coil in coils] == [f"EM{n}" for n in range(1, 25)]
    assert coils[16].position == pytest.approx([0.0568, 0, 0], abs=1e-12)
    low = np.radians(-15)
    assert magnets[0].position == pytest.approx(0.0679 * np.array([np.cos(low), 0, np.sin(low)]), abs=1e-12)
    assert coils[0].channel == coils[12].channel  # Table 2: EM 1 and EM 13 in series
    rings = select_parts(found, "ring")
    assert [ring.position[2] for ring in rings] == pytest.approx([-0.0665, -0.0582])
    assert rings[0].polarity * rings[1].polarity < 0  # they repel


def test_assumed_sizes_are_named():
    notes = " ".join(geometry(haptorb.load("omni")).notes)
    assert "windings.outer_radius" in notes
    assert "tool.mass" not in notes
