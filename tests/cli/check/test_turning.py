"""Torque is checked by its stiffness over the tool's orientation; unchecked parts are stated."""

import json

import numpy as np
import pytest

from haptorb import worlds
from haptorb.analysis.stability import GRIPS
from haptorb.analysis.workspace import find_asked_part, steepest_turn, turning_workspace
from haptorb.cli import main
from haptorb.cli.check_world import Setting, judge_world
from haptorb.devices.loader import load
from haptorb.errors import UnknownName
from haptorb.worlds.user_world import FunctionWorld

OMNI = load("omni")


def test_a_compass_is_as_stiff_as_its_potential_and_is_met_at_the_hands_arm():
    place = turning_workspace(OMNI)
    for world in (worlds.Compass(), worlds.Compass(direction=(-0.3, 0.8, 0.6), width_deg=5)):
        steepest_at_goal = world.strength / np.radians(world.width_deg)  # T/s
        assert steepest_turn(OMNI, world).stiffness == pytest.approx(steepest_at_goal, rel=0.02)
    spring = FunctionWorld(lambda s: np.r_[np.zeros(3), 0.02 * np.cross(s.axis, (0, 0, 1)) - 1e-4 * s.w])
    steep = steepest_turn(OMNI, spring)
    assert steep.damping == pytest.approx(1e-4, rel=1e-3)
    assert 0.015 < steep.stiffness <= 0.0201
    hand = place.grip(GRIPS["light"])
    assert hand.damping == pytest.approx(OMNI.hand.turn_damping)
    assert hand.mass == pytest.approx(0.1 * 1e-3 + OMNI.tool.inertia[0])


def test_the_verdict_is_on_the_part_that_is_rendered():
    turning = judge_world(OMNI, worlds.Compass(), Setting(), "compass")
    assert (turning.part, turning.place.force, turning.place.length) == ("torque", "N·m", "rad")
    assert turning.unjudged
    stiff = FunctionWorld(lambda s: np.r_[np.zeros(3), 30.0 * np.cross(s.axis, (0, 0, 1))])
    outside = judge_world(OMNI, stiff, Setting())
    assert (outside.part, outside.verdict) == ("torque", "outside")
    ignored = judge_world(OMNI, stiff, Setting(), render="force")
    assert (ignored.part, ignored.fit, ignored.unjudged) == ("force", True, ())
    with pytest.raises(UnknownName):
        judge_world(OMNI, stiff, Setting(), render="twist")


def test_both_are_judged_and_the_weaker_decides():
    verdict = judge_world(OMNI, worlds.Wall() + worlds.Compass(), Setting())
    assert verdict.part == "both"
    assert verdict.turning is not None
    assert verdict.margin == min(verdict.margins[0][0], verdict.turning.margin)
    assert verdict.numbers()["turning"]["unit"] == "N·m/rad"


def test_what_a_world_asks_is_found_out():
    assert find_asked_part(OMNI, worlds.Dome()) == "force"
    assert find_asked_part(OMNI, FunctionWorld(lambda s: np.zeros(6))) == "force"
    assert find_asked_part(OMNI, FunctionWorld(lambda s: np.r_[s.p, 1e-3 * s.w])) == "both"


def run(*arguments):
    """The exit code of the command."""
    try:
        return main(["check", *arguments])
    except SystemExit as ended:
        return ended.code


def test_the_command_says_what_it_does_not_judge(capsys):
    assert run("--world", "compass") == 0
    told = capsys.readouterr().out
    assert "N·m/rad" in told
    assert "Not judged" in told
    assert run("--world", "compass", "--json") == 0
    assert json.loads(capsys.readouterr().out)["part"] == "torque"
    assert run("--world", "compass", "--render", "torqe") == 2
    assert "did you mean 'torque'" in capsys.readouterr().err
    assert run("--render", "torque") == 2
