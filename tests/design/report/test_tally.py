"""Tally of a run: best of each objective, rejections, and advice if no design is valid."""

from __future__ import annotations

from pathlib import Path

from haptorb_design.problem import Evaluation
from haptorb_design.tally import Tally
from oracles.designs.small_design import make_design


def make_row(number: int, cost: float = 0.0, by: str = "", reason: str = "") -> Evaluation:
    objectives = {} if by else {"cost": cost, "reach": cost}
    return Evaluation(number, {"radius": 30.0, "angle": 50.0, "shell": "thin"}, objectives, {}, by, reason)


def test_the_best_of_each_objective_does_not_depend_on_the_order(tmp_path: Path) -> None:
    design = make_design(tmp_path)
    rows = [make_row(0, 0.04), make_row(1, 0.03), make_row(2, 0.05), make_row(3, 0.03), make_row(4, by="room")]
    for found in (rows, rows[::-1]):
        tally = Tally(design, found)
        assert (tally.best["cost"].number, tally.best["reach"].number) == (1, 2)
        assert (tally.count, tally.valid, dict(tally.refused)) == (5, 4, {"room": 1})
        assert "cost 30 mm" in tally.short
        assert "20 % rejected" in tally.short
        assert tally.advice == ""
    assert "1 by room" in tally.sentence
    assert "design 1: radius 30 mm, angle 50 deg, shell thin" in dict(tally.list_best())["best cost"]


def test_a_range_without_a_valid_design_says_who_refuses_how_many(tmp_path: Path) -> None:
    rows = [make_row(n, by="room", reason=f"{n} m is above 2 m") for n in range(6)]
    rows += [make_row(n, by="device", reason=f"magnets: parts overlap: {n}") for n in range(6, 16)]
    tally = Tally(make_design(tmp_path), rows)
    assert tally.valid == 0
    assert "10 by device, 6 by room" in tally.sentence
    assert "10 of 16" in tally.advice
    assert "magnets: parts overlap: 6" in tally.advice
    assert tally.list_best() == []


def test_of_a_constraint_the_nearest_design_is_named(tmp_path: Path) -> None:
    rows = [
        Evaluation(n, {}, {}, {"room": room}, "room", f"{1e3 * room:g} mm is above 31 mm")
        for n, room in enumerate((0.034, 0.0312, 0.033))
    ]
    assert "The closest is design 1: 31.2 mm is above 31 mm" in Tally(make_design(tmp_path), rows).advice


def test_an_objective_that_fails_is_told_with_its_reason(tmp_path: Path) -> None:
    reason = "cost: ZeroDivisionError: division by zero (own.py, line 2)"
    rows = [make_row(n, by="objective", reason=reason) for n in (5, 3, 4)]
    tally = Tally(make_design(tmp_path), rows)
    assert reason in tally.advice
    assert "Design 3 (3 alike): " in tally.advice
    assert "constraint" not in tally.advice
    assert tally.failures == ""
    tally.add(make_row(6, 0.03))
    assert (tally.advice, reason in tally.failures) == ("", True)
