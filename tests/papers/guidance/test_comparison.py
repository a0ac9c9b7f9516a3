"""Reduced comparison: one grip, one path (nightly); the complete one is `haptorb guidance`."""

import json
from dataclasses import replace

import numpy as np
import pytest

from haptorb.analysis.stability import GRIPS
from haptorb.cli.program import main
from haptorb.devices.loader import load
from haptorb.worlds.path import make_shape
from haptorb.worlds.path_guidance import PathGuidance
from haptorb_papers.guidance import WAYS, GuidanceComparison, compare_guidance
from haptorb_papers.guidance.comparison import GuidanceRow
from haptorb_papers.guidance.person import Habits
from haptorb_papers.guidance.trial import MovingPoint, run_trial


@pytest.fixture(scope="module")
def found():
    return compare_guidance(load("omni"), paths=("line",), grips=("light",), seconds=2.0, seed=1)


@pytest.mark.slow
def test_the_plan_keeps_a_light_hand_nearer_to_the_path_than_the_valley_does(found):
    assert {row.way for row in found.rows} == set(WAYS)
    plan, valley, none = (found.find_row("line", "light", way) for way in ("plan", "valley", "none"))
    assert plan.error < 0.7 * valley.error < none.error
    assert not any(row.tripped for row in found.rows)
    assert found.find_inequality("light") <= 0.03


@pytest.mark.slow
@pytest.mark.parametrize("grip", GRIPS)
def test_at_equal_mean_force_the_plan_halves_the_valleys_error_for_every_grip(grip):
    whole = compare_guidance(load("omni"), grips=(grip,))
    assert whole.find_inequality(grip) <= 0.03
    assert whole.find_ratio(grip) < 0.5
    assert whole.drift[grip, "plan"] < 5e-4


@pytest.mark.slow
def test_in_the_comparison_a_hand_at_rest_is_dragged_by_the_clock_only(found):
    assert found.drift["light", "plan"] < 5e-4
    assert found.drift["light", "spring"] > 1e-3


@pytest.mark.parametrize(
    "words",
    [
        ("pmsm",),
        ("--path", "triangle"),
        ("--grip", "iron"),
        ("--duration", "1"),
        ("--seconds", "1"),
        ("--seed", "-1"),
        ("--plot", "a.txt"),
    ],
)
def test_mistakes_are_told(words, capsys):
    assert main(["guidance", *words]) == 2
    assert "haptorb: " in capsys.readouterr().err


def find_drift(world, path):
    """[m] from one to two seconds after the hand stopped."""
    still = replace(Habits(), rest_after=2.0)
    places = run_trial(load("omni"), world, path, GRIPS["light"], still, 4.2, 1).places  # from the first second on
    return np.linalg.norm(places[-200:].mean(axis=0) - places[2000:2200].mean(axis=0))


def test_a_hand_at_rest_is_dragged_by_the_clock_only():
    path = make_shape("line", radius=load("omni").shell.contact_distance)
    assert find_drift(PathGuidance(path=path), path) < 2e-4
    assert find_drift(MovingPoint(path=path, strength=0.35, pace=Habits().pace), path) > 5e-4


def test_numbers_are_json():
    rows = [
        GuidanceRow("line", "light", way, error, 2 * error, 0.1, 0.2, 0.35, np.nan, np.nan, False)
        for way, error in zip(WAYS, (4e-3, 2e-3, 3e-3, 1e-3), strict=True)
    ]
    made = GuidanceComparison("omni", 2.0, 1, "tracker", tuple(rows), {("light", "plan"): 1e-4}, {})
    numbers = json.loads(json.dumps(made.numbers()))
    assert numbers["plan_over_valley"]["light"] == pytest.approx(0.5)
    assert numbers["at_rest"] == [{"grip": "light", "guidance": "plan", "way_m": 1e-4}]
