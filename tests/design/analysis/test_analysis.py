"""Pareto front, choice of the best, and sensitivity: against definitions and functions with known results."""

import numpy as np
import pytest
from scipy.stats import rankdata

from haptorb_design.pareto_front import choose_best, find_front
from haptorb_design.sensitivity import MIN_DESIGNS, estimate_sensitivity


@pytest.mark.parametrize(("count", "objectives"), [(1, 2), (200, 1), (300, 2), (300, 3)])
def test_the_front_is_what_its_definition_says(count, objectives):
    costs = np.random.default_rng(3).integers(0, 12, (count, objectives)).astype(float)  # with equal rows
    beaten = [((costs <= one).all(axis=1) & (costs < one).any(axis=1)).any() for one in costs]
    assert find_front(costs).tolist() == np.flatnonzero(~np.array(beaten)).tolist()


def test_ten_thousand_designs_have_their_front_at_once():
    angle = np.random.default_rng(0).uniform(0, np.pi / 2, 10_000)
    costs = 1 - np.stack([np.cos(angle), np.sin(angle)], axis=1) * np.linspace(0.5, 1, 10_000)[:, None]
    assert 5 < len(find_front(costs)) < 500
    assert not len(find_front(np.empty((0, 2))))


def test_with_one_objective_near_copies_of_the_best_are_left_out():
    costs = np.array([[1.0], [1.1], [1.2], [1.3], [1.4]])
    places = np.array([[0.5, 0.0], [0.51, 0.0], [0.5, 1.0], [0.6, 0.0], [0.52, 0.0]])
    assert [one.row for one in choose_best(costs, places, ["heat"], 3)] == [0, 2, 3]
    assert [one.row for one in choose_best(costs, places, ["heat"], 4)] == [0, 1, 2, 3]  # filled up with the next best
    assert len(choose_best(costs, places, ["heat"], 9)) == 5
    assert choose_best(np.empty((0, 1)), np.empty((0, 2)), ["heat"]) == ()


def test_with_several_objectives_the_front_is_spread_from_the_compromise():
    x = np.linspace(0, 1, 41)
    costs = np.concatenate([np.stack([x, (1 - x) ** 2], axis=1), [[0.9, 0.9]]])
    picks = choose_best(costs, np.zeros((42, 1)), ["a", "b"], 5)
    rows = [one.row for one in picks]
    assert len(set(rows)) == 5
    assert 41 not in rows
    assert picks[0].reason == "compromise"
    assert costs[rows[0]] == pytest.approx([0.41, 0.35], abs=0.03)  # nearest to (0, 0) on y = (1 - x)²
    assert {0, 40} <= set(rows[1:3])  # the best of each objective
    assert np.diff(np.sort(x[rows])).max() < 0.45
    few = choose_best(np.array([[0.0, 0.0], [1.0, 1.0]]), np.zeros((2, 1)), ["a", "b"])
    assert [one.row for one in few] == [0, 1]
    assert "next front" in few[1].reason


def _ishigami(x):
    return np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])


def test_intervals_of_a_share_hold_the_truth_and_find_nothing_where_nothing_is():
    generator = np.random.default_rng(5)
    points = generator.uniform(-np.pi, np.pi, (400_000, 4))
    ranks = rankdata(_ishigami(points))
    parts = np.minimum(((points + np.pi) / (2 * np.pi) * 200).astype(int), 199)
    truth = []
    for column in parts.T:
        means = np.bincount(column, ranks) / np.bincount(column)
        truth.append(np.var(means[column]) / np.var(ranks))
    assert truth[:2] == pytest.approx([0.302, 0.513], abs=0.005)
    kept, directions = np.zeros(4), []
    for _ in range(25):
        x = generator.uniform(-np.pi, np.pi, (300, 4))
        found = [estimate_sensitivity(column, _ishigami(x)) for column in x.T]
        intervals = [one.share_interval for one in found]
        kept += [low - 1e-3 <= true <= high for (low, high), true in zip(intervals, truth, strict=True)]
        directions.append([one.direction for one in found])
        assert all(one.share < 0.2 for one in found[2:])
    assert kept.min() >= 20  # of 25, for 95 %
    assert np.mean(directions, axis=0) == pytest.approx([0.5, 0, 0, 0], abs=0.1)


def test_a_choice_has_a_share_and_no_direction_and_outliers_decide_nothing():
    generator = np.random.default_rng(2)
    choice, other = generator.integers(0, 3, 200).astype(float), generator.uniform(size=200)
    objective = np.array([1.0, 3.0, 2.0])[choice.astype(int)] + 0.1 * other
    objective[7] = 1e9  # a design that hardly works
    found = estimate_sensitivity(choice, objective, ordered=False)
    assert found.share > 0.8
    assert found.direction is None
    assert estimate_sensitivity(other, objective).share < 0.2
    same = estimate_sensitivity(np.ones(MIN_DESIGNS), generator.uniform(size=MIN_DESIGNS))
    assert (same.share, same.share_interval, same.direction) == (0.0, (0.0, 0.0), 0.0)
