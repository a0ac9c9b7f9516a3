"""Plug and socket on the page agree with the world's computation."""

from __future__ import annotations

import json

import numpy as np
import pytest

from haptorb.beams import compute_bent_shape
from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.recording.row import RowLayout
from haptorb.web.session import object_scene
from haptorb.web.wire import COLUMNS, MODED, Columns
from haptorb.worlds import CATALOGUE, Outlet, SnapFit


def hook_of(scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    along, section = np.array(scene["along"]), np.array(scene["section"])
    return along, section, np.array(scene["bends"])


def test_every_world_has_a_scene_of_plain_json_or_none():
    for name in CATALOGUE:
        scene = object_scene(name, {})
        json.dumps(scene, allow_nan=False)
        assert (scene is None) == (name not in ("outlet", "snap_fit"))
    assert object_scene("a world that nobody made", {}) is None


@pytest.mark.parametrize("name", ["outlet", "snap_fit"])
def test_hooks_bend_as_computed_and_give_way_by_one_where_they_are_touched(name):
    scene = object_scene(name, {})
    along, _, bends = hook_of(scene)
    hook = CATALOGUE[name]().hook
    for place, bend in zip(scene["at"], bends, strict=True):
        assert np.interp(place, along, bend) == pytest.approx(1.0, abs=0.01)
        exact = compute_bent_shape(hook, place, 1.0, points=400)
        assert np.abs(np.interp(along, exact[:, 0], exact[:, 1]) - bend).max() < 0.003
        assert bend[0] == 0.0
        assert (np.diff(bend) >= 0).all()


def test_drawn_hook_of_the_outlet_meets_the_drawn_plug_where_the_world_says_they_touch():
    world, scene = Outlet(), object_scene("outlet", {})
    along, section, bends = hook_of(scene)
    state = State.at((0.004, 0, 0), R_SR=np.eye(3), v=(0.01, 0, 0))
    _, hooks = world.render_contacts(state)
    for hook, side in zip(hooks, (1.0, -1.0), strict=True):
        deflection, place, x, y = hook[:4]
        inner = scene["back"] - np.interp(place, along, section) + deflection * np.interp(place, along, bends[0])
        assert scene["root"] + place == pytest.approx(x, abs=1e-9)
        assert side * inner == pytest.approx(y, abs=2e-5)
        outline = np.array(scene["outline"])
        assert side * np.interp(x - state.p[0], outline[:, 0], outline[:, 1]) == pytest.approx(y, abs=1e-6)


def test_drawn_hook_of_the_snap_fit_meets_the_edge():
    world, scene = SnapFit(), object_scene("snap_fit", {})
    along, section, bends = hook_of(scene)
    _, hooks = world.render_contacts(State.at((0.0032, 0, 0), R_SR=np.eye(3), v=(0.01, 0, 0)))
    deflection, place, x, y = hooks[0, :4]
    assert deflection > 1e-3
    k = int(np.argmin(np.abs(np.array(scene["at"]) - place)))
    inner = scene["back"] - np.interp(place, along, section) + deflection * np.interp(place, along, bends[k])
    assert inner == pytest.approx(y, abs=0.1e-3)  # the drawn wedge has sharp edges, the computed one round ones
    assert (x, y) == pytest.approx((0.0032, world.half_width), abs=1e-9)


def test_scene_follows_the_values():
    thick = object_scene("outlet", {"thickness": 0.9e-3})
    assert thick["section"][0] == pytest.approx(0.9e-3)
    assert object_scene("outlet", {"opening": 9e-3}) is None, "a world that cannot be has no picture"


def test_only_devices_with_modes_send_the_target():
    motor, omni = RowLayout.of(load("pmsm")), RowLayout.of(load("omni"))
    assert Columns(omni).names == COLUMNS
    described = Columns(motor, moded=True).describe()
    assert [item["name"] for item in described] == [*COLUMNS, *MODED]
    assert len(Columns(motor, moded=True).index) == sum(item["width"] for item in described)
