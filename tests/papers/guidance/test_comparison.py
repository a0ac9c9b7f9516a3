"""The comparison in a reduced form: one grip, one path; the whole is `haptorb guidance`."""

import json

import pytest

from haptorb.analysis.stability import GRIPS
from haptorb.cli.program import main
from haptorb.devices.loader import load
from haptorb_papers.guidance import WAYS, compare_guidance


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


def test_a_hand_at_rest_is_dragged_by_the_clock_only(found):
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


def test_numbers_are_json(found):
    assert json.loads(json.dumps(found.numbers()))["plan_over_valley"]["light"] == found.find_ratio("light")
