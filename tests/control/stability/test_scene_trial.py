"""A random hand gets nothing out of a shipped scene; the whole ten minutes are in benchmarks/worlds/scenes.py."""

from __future__ import annotations

import pytest

from haptorb.control.stability.coupling_choice import CouplingSetting
from haptorb.control.stability.hand_grip import GRIPS
from haptorb.devices.loader import load
from haptorb.worlds import Scene
from haptorb.worlds.scene.scene_model import SHIPPED
from oracles.scene_trial import try_random_hand


@pytest.mark.parametrize("name", SHIPPED)
def test_a_random_hand_gets_less_than_a_millijoule_out_of_a_scene(name: str) -> None:
    device, hand = load("omni" if name == "boxes" else "pmsm"), GRIPS["light"]
    scene = CouplingSetting(device, 1000.0, hand).couple(Scene(name))
    assert isinstance(scene, Scene)
    trial = try_random_hand(scene, device, hand, 2.0)
    assert trial.lowest > -1e-3
    assert trial.put_in > 1e-3  # it was felt at all
    assert trial.greatest > 0.5
