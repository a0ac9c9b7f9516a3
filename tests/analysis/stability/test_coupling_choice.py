"""Virtual coupling that a loop, a hand and a body permit."""

from __future__ import annotations

import re

import pytest

from haptorb.analysis.coupling import CouplingSetting, measure_margin
from haptorb.analysis.stability import GRIPS, MIN_STABILITY_MARGIN
from haptorb.devices.loader import load
from haptorb.errors import InputError
from haptorb.worlds import Nothing, Scene
from haptorb.worlds.scene_physics import SHIPPED


def couple(name: str, device: str, rate: float = 1000.0, **setting: float) -> tuple[Scene, float]:
    found, hand = load(device), GRIPS["light"]
    chosen = CouplingSetting(found, rate, hand, **setting)
    scene = chosen.couple(Scene(name))
    assert isinstance(scene, Scene)
    assert name in chosen.describe(scene) or scene.body in chosen.describe(scene)
    margin = measure_margin(scene, found, chosen.loop, hand)
    shown = re.search(r"up to (\d+\.?\d*) times", chosen.describe(scene))  # digits that can be read, no exponent
    assert shown is not None
    assert float(shown[1]) == pytest.approx(margin, rel=0.005)  # three digits
    return scene, margin


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_scene_is_inside_of_what_the_loop_renders(name: str) -> None:
    scene, margin = couple(name, "omni" if name == "boxes" else "pmsm")
    assert margin >= 0.99 * MIN_STABILITY_MARGIN
    assert scene.stiffness >= (500.0 if name == "boxes" else 1000.0)


def test_a_late_tracker_gets_a_softer_coupling_at_the_same_margin() -> None:
    quick, _ = couple("boxes", "omni")
    late, margin = couple("boxes", "omni", latency=0.020)
    assert late.stiffness < 0.5 * quick.stiffness
    assert margin == pytest.approx(MIN_STABILITY_MARGIN, rel=0.03)
    assumed, _ = couple("boxes", "omni", fed=True)
    assert late.stiffness < assumed.stiffness <= quick.stiffness


def test_what_a_person_gave_stays_and_other_worlds_are_left_alone() -> None:
    setting = CouplingSetting(load("omni"), 1000.0, GRIPS["light"])
    given = Scene("boxes", stiffness=77.0, damping=1.0)
    coupled = setting.couple(given)
    assert isinstance(coupled, Scene)
    assert (coupled.stiffness, coupled.damping) == (77.0, 1.0)
    nothing = Nothing()
    assert setting.couple(nothing) is nothing
    assert setting.describe(nothing) == ""
    both = setting.couple(Scene("boxes") + nothing)
    assert "boxes" not in setting.describe(nothing)
    assert "N/m" in setting.describe(both)


@pytest.mark.parametrize("latency", [-0.001, float("nan"), 0.2])
def test_a_latency_that_cannot_be_is_refused(latency: float) -> None:
    with pytest.raises(InputError, match="latency"):
        CouplingSetting(load("omni"), 1000.0, GRIPS["light"], latency=latency)
