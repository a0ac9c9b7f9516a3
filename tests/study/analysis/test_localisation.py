"""Localisation errors: planted ones are found, with their sign; undefined directions are reported."""

from __future__ import annotations

import json
from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from haptorb_study.analysis.analysis import Analysis, analyse
from haptorb_study.analysis.comparison import compare_conditions
from haptorb_study.analysis.tables import print_summary
from haptorb_study.columns import Columns
from haptorb_study.set_points import directions
from haptorb_study.statistics.sphere import find_away_axes, local_axes
from haptorb_study.study_file import Study, study_of

REACH = study_of('name = "reach"\nprocedure = "localisation"\nhand_deg = 90')
NAME = study_of('name = "name"')
CONTACT = REACH.load_device().contact_distance


def plant(study: Study, people: int, up: float, away: float = 0.0, growth: float = 0.0, seed: int = 0) -> Columns:
    """Everybody answers each set-point twice, off by `up` and `away` [deg]; `growth` [mm/deg] replaces both.

    Their own means and trials scatter; in an identification the nearest set-point is named.
    """
    draw = np.random.default_rng(seed)
    ways, numbers = directions(study.points), np.array([point.number for point in study.points])
    theta = np.array([point.theta_deg for point in study.points])
    meridian, _ = local_axes(ways)
    meridian = np.where(np.isfinite(meridian), meridian, 0.0)
    from_hand = find_away_axes(ways, study.hand_deg or 0.0)
    count = 2 * len(ways)
    which = np.tile(np.arange(len(ways)), 2)
    who, places = [], []
    for n in range(people):
        own = draw.normal(0.0, 0.5, 2)
        error = np.radians((up + own[0]) * meridian[which] + (away + own[1]) * from_hand[which])
        if growth:
            side = np.cross(ways[which], from_hand[which])
            error = (3e-3 + growth * (1 + own[:1] / 4) * 1e-3 * theta[which])[:, None] * side / CONTACT
        noise = draw.normal(0.0, np.radians(1.0), (count, 3))
        error += noise - np.sum(noise * ways[which], axis=1, keepdims=True) * ways[which]
        size = np.linalg.norm(error, axis=1, keepdims=True)
        places.append(CONTACT * (np.cos(size) * ways[which] + np.sinc(size / np.pi) * error))
        who += [f"P{n:02d}"] * count
    place, asked = np.concatenate(places), np.tile(which, people)
    answer = np.full(len(who), np.nan)
    if study.procedure == "identification":
        answer = numbers[np.argmax(place @ ways.T, axis=1)]
    return {
        "participant": np.array(who), "condition": np.full(len(who), "base"), "set_point": numbers[asked],
        "theta_deg": theta[asked], "answer": answer, "correct": (answer == numbers[asked]).astype(float),
        "distance_mm": 1e3 * np.linalg.norm(place - CONTACT * ways[asked], axis=1),
        "x_m": place[:, 0], "y_m": place[:, 1], "z_m": place[:, 2], "phase": np.full(len(who), "main"),
        "simulated": np.full(len(who), False), "simulated_device": np.full(len(who), False),
        "safety": np.full(len(who), ""), "repeats": np.zeros(len(who)), "trial": np.arange(len(who)),
        "seconds": np.ones(len(who)),
    }  # fmt: skip


def show(found: Analysis) -> str:
    out = StringIO()
    print_summary(found, Console(file=out, width=80))
    assert max(map(len, out.getvalue().splitlines())) <= 80
    assert json.dumps(found.numbers(), allow_nan=False)
    return " ".join(out.getvalue().split())


def test_a_planted_bias_is_found_along_its_axis_and_no_other() -> None:
    found = analyse(REACH, plant(REACH, 8, up=2.0))
    assert found.localisation is not None
    up, around, away = found.localisation.axes
    assert up.constant.low < 2.0 < up.constant.high
    assert up.constant.mean == pytest.approx(2.0, abs=0.6)
    assert up.constant.p < 1e-3
    assert up.trials == 8 * 48  # not at the top
    assert around.constant.mean == pytest.approx(0.0, abs=0.2)
    assert away.trials == 8 * 50
    assert up.variable == pytest.approx(1.0, abs=0.15)
    claim = next(one for one in found.comparisons if one.what == "upward-bias")
    assert (claim.difference, claim.low, claim.p) == (up.constant.mean, up.constant.low, up.constant.p)
    assert "answers go higher" in show(found)


def test_away_from_the_hand_is_away_from_it() -> None:
    axes = analyse(REACH, plant(REACH, 6, up=0.0, away=3.0)).localisation
    assert axes is not None
    by_name = {axis.axis: axis.constant.mean for axis in axes.axes}
    assert by_name["away from the hand"] == pytest.approx(3.0, abs=0.7)
    unknown = analyse(study_of('name = "r"\nprocedure = "localisation"'), plant(REACH, 3, up=0.0)).localisation
    assert unknown is not None
    assert [axis.axis for axis in unknown.axes] == ["up", "around"]


def test_a_planted_growth_over_the_angle_is_found() -> None:
    found = analyse(REACH, plant(REACH, 6, up=0.0, growth=0.1))
    assert found.localisation is not None
    assert found.localisation.slope is not None
    assert found.localisation.slope.low < 0.1 < found.localisation.slope.high
    assert found.localisation.intercept == pytest.approx(3.0, abs=0.5)
    assert "error grows with θ" in show(found)


def test_the_interval_holds_the_bias_as_often_as_it_says() -> None:
    """benchmarks/study/study_localisation.py in a reduced form: the pooled trials would claim far too much."""
    held = []
    for seed in range(120):
        columns = plant(REACH, 6, up=2.0, seed=seed)
        rows = compare_conditions(REACH, columns, sorted(set(columns["participant"].tolist())))
        row = next(one for one in rows if one.what == "upward-bias")
        held.append(row.low <= 2.0 <= row.high)
    assert np.mean(held) == pytest.approx(0.95, abs=4 * np.sqrt(0.05 * 0.95 / 120))


def test_the_outermost_ring_cannot_speak_for_upward_answers() -> None:
    # Whatever is felt, a numbered answer to the outermost ring lies on it or higher.
    columns = plant(NAME, 6, up=0.0)
    outer = columns["theta_deg"] == 54.0
    columns["answer"] = np.where(outer, 1, columns["set_point"])
    found = analyse(NAME, columns).localisation
    assert found is not None
    assert found.axes[0].constant.mean == 0.0
    assert found.axes[0].trials == 6 * 2 * 12


def test_people_without_any_error_are_no_error_of_the_program() -> None:
    columns = plant(NAME, 4, up=0.0)
    columns["answer"] = columns["set_point"].copy()
    found = analyse(NAME, columns)
    assert found.localisation is not None
    assert (found.localisation.axes[0].constant.mean, found.localisation.axes[0].constant.p) == (0.0, 1.0)
    information = found.localisation.information["base"]
    assert information.bits == pytest.approx(np.log2(25))
    assert all(np.isinf(place.spread.kappa) for place in found.localisation.places)
    assert "∞" in show(found)


def test_rounding_errors_are_no_result() -> None:
    """Whoever names the top for other set-points makes no error about the vertical, whatever directions compute to."""
    columns = plant(NAME, 6, up=0.0)
    wrong = np.random.default_rng(1).random(len(columns["set_point"])) < 0.3
    columns["answer"] = np.where(wrong, 1, columns["set_point"])
    found = analyse(NAME, columns).localisation
    assert found is not None
    around = {axis.axis: axis for axis in found.axes}["around"]
    assert (around.constant.mean, around.constant.p, around.variable) == (0.0, 1.0, 0.0)
    assert found.axes[0].constant.p < 0.01


def test_one_person_is_described_without_an_interval() -> None:
    found = analyse(REACH, plant(REACH, 1, up=2.0))
    assert found.localisation is not None
    assert np.isnan([found.localisation.axes[0].constant.low, found.localisation.axes[0].constant.p]).all()
    assert found.comparisons == ()
    assert "nan" not in show(found)
