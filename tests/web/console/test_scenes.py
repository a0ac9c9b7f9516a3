"""The page draws the device of the file: positions, sizes and names to 1e-9, following the file."""

from __future__ import annotations

import json
from importlib.resources import files

import numpy as np
import pytest

import haptorb
from haptorb.devices.loader import parse
from haptorb.web.session import describe_scene

CATALOGUE = files("haptorb.devices") / "catalogue"
OMNI = (CATALOGUE / "omni.toml").read_text(encoding="utf-8")
MOVED = """
based_on = "pmsm"
name = "moved"
title = "PMSM with its stator turned and larger"
[electromagnets]
distance = "57 mm"
rings = [
  { latitude = "-26 deg", count = 8, first = "24.5 deg", step = "45 deg" },
  { latitude = "26 deg", count = 8, first = "24.5 deg", step = "45 deg" },
  { latitude = "0 deg", count = 8, first = "2 deg", step = "45 deg" },
]
"""


def arriving_scene(device):
    """The scene as it arrives at the page."""
    return json.loads(json.dumps(describe_scene(device)))


def coils(scene):
    return [part for part in scene["parts"] if part["role"] == "coil"]


def test_coils_of_omni_have_the_sizes_and_axes_of_the_file():
    omni = haptorb.load("omni")
    scene = arriving_scene(omni)
    for k, coil in enumerate(coils(scene)):
        assert coil["name"] == omni.coils.names[k]
        assert coil["inner_radius"] == pytest.approx(omni.windings.inner_radius[k], abs=1e-9)
        assert coil["outer_radius"] == pytest.approx(omni.windings.outer_radius[k], abs=1e-9)
        assert coil["length"] == pytest.approx(omni.windings.length[k], abs=1e-9)
        moment = omni.moment_per_current[:, k]
        assert coil["axis"] == pytest.approx(moment / np.linalg.norm(moment), abs=1e-9)
    assert np.array(scene["sensors"]) == pytest.approx(omni.hall.positions, abs=1e-9)
    assert np.array(scene["marks"]) == pytest.approx(omni.marks.positions, abs=1e-9)
    assert [scene["core_radius"], scene["dome_wall"]] == pytest.approx([0.015, 0.0015], abs=1e-9)


def test_coils_sensors_and_names_that_the_file_changes_change_the_picture():
    text = OMNI.replace("[18.0, 22.55, 27.25]", "[18.0, 22.55, 27.3]").replace('["x", "y", "z"]', '["a", "b", "c"]')
    scene = arriving_scene(parse(text.replace("[55.0, 0.0, 0.0]", "[51.0, 2.0, 0.0]"), "mine.toml"))
    assert [coil["name"] for coil in coils(scene)] == ["a", "b", "c"]
    assert coils(scene)[2]["outer_radius"] == pytest.approx(0.0273, abs=1e-9)
    assert scene["sensors"][0] == pytest.approx([0.051, 0.002, 0.0], abs=1e-9)


def test_moved_coils_of_a_motor_move_in_the_picture():
    before, device = arriving_scene(haptorb.load("pmsm")), parse(MOVED, "moved.toml")
    after = arriving_scene(device)
    positions = np.array([coil["position"] for coil in coils(after)])
    assert positions == pytest.approx(device.electromagnets.positions, abs=1e-9)
    first, then = (coils(scene)[16]["position"] for scene in (before, after))
    turn = np.radians(2)
    assert first == pytest.approx([0.0568, 0, 0], abs=1e-9)
    assert then == pytest.approx([0.057 * np.cos(turn), 0.057 * np.sin(turn), 0], abs=1e-9)


def test_a_kind_without_a_scene_of_its_own_is_drawn_by_its_geometry():
    scene = describe_scene.dispatch(object)(haptorb.load("omni"))
    assert scene["kind"] == "axes"
    assert len(coils(scene)) == 3


def test_an_arm_is_drawn_by_the_edges_of_its_workspace() -> None:
    arm = haptorb.load("arm-touch")
    edges = [np.array(edge) for edge in describe_scene(arm)["edges"]]
    assert len(edges) == 6
    assert np.abs(np.concatenate(edges)).max(axis=0) == pytest.approx(arm.workspace.half)
