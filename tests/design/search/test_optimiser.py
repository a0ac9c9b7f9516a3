"""Optimiser: its candidates are permitted, new, reproducible by seed, and improve."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np
import pytest

from haptorb.errors import InputError, RecordingError
from haptorb_design.problem import Bound, Design, DesignGoal, DesignParameter, DesignQuantity, Evaluation, Value
from haptorb_design.search import Optimiser, optimise
from haptorb_design.search_space import SearchSpace, measure_violation


def a_quantity(name: str) -> DesignQuantity:
    return DesignQuantity(name, "", "minimise", "", (), lambda candidate: 0.0)


PARAMETERS = (
    DesignParameter("angle", (), "deg", -20.0, 60.0),
    DesignParameter("radius", (), "mm", 1.0, 4.0, step=0.25),
    DesignParameter("pattern", (), choices=(("even", 0), ("odd", 1), ("mixed", 2), ("none", 3))),
)
MIXED = Design(
    "mixed", "Mixed", "pmsm", PARAMETERS, (DesignGoal(a_quantity("cost"), "minimise"),),
    (Bound("room", a_quantity("room"), 0.5),),
    {}, "", "",
)  # fmt: skip
TWO = replace(MIXED, goals=(DesignGoal(a_quantity("cost"), "minimise"), DesignGoal(a_quantity("gain"), "maximise")))


def judge(number: int, values: Mapping[str, Value]) -> Evaluation:
    """Best: angle 15, radius 2.75, pattern odd; a third of the space breaks `room`."""
    angle, radius = (float(values["angle"]) - 15.0) / 80.0, (float(values["radius"]) - 2.75) / 3.0
    room = 1.0 - 0.5 * angle - radius
    if room < 0.5:
        return Evaluation(number, values, {}, {"room": room}, "room", "too small")
    cost = angle**2 + radius**2 + (0.0 if values["pattern"] == "odd" else 0.3)
    return Evaluation(number, values, {"cost": cost, "gain": -((angle - 0.2) ** 2) - radius**2}, {"room": room})


def compute(jobs: Iterable[tuple[int, Mapping[str, Value]]]) -> Iterator[Evaluation]:
    """In an order that is never the same."""
    mixed = list(jobs)
    random.Random().shuffle(mixed)
    return (judge(*job) for job in mixed)


def run(design: Design = MIXED, count: int = 300, seed: int = 1, population: int = 20) -> list[Evaluation]:
    found = list(optimise(Optimiser(design, seed=seed, population=population), compute, {}, count))
    return sorted(found, key=lambda one: one.number)


def test_the_order_in_which_results_come_changes_nothing_and_the_seed_does() -> None:
    first = run(TWO)
    np.random.seed(3)  # nothing hangs on the state that others share
    assert run(TWO) == first
    assert [one.number for one in first] == list(range(300))
    assert run(TWO, seed=2) != first


def test_every_candidate_is_allowed_and_none_comes_twice() -> None:
    found = [one.values for one in run(count=400)]
    assert len({tuple(values.items()) for values in found}) == 400
    for values in found:
        assert -20.0 <= float(values["angle"]) <= 60.0
        assert float(values["radius"]) in {1.0 + 0.25 * k for k in range(13)}
        assert values["pattern"] in {"even", "odd", "mixed", "none"}


@pytest.mark.parametrize("seed", range(4))
def test_the_best_of_ranges_steps_and_choices_is_found(seed: int) -> None:
    best = min((one for one in run(seed=seed, count=500) if one.valid), key=lambda one: one.objectives["cost"])
    assert (best.values["radius"], best.values["pattern"]) == (2.75, "odd")
    assert best.values["angle"] == pytest.approx(15.0, abs=0.5)


def test_of_two_objectives_the_whole_front_is_found() -> None:
    best = [one for one in run(TWO, count=600) if one.valid and one.values["radius"] == 2.75]
    angles = sorted(float(one.values["angle"]) for one in best if one.values["pattern"] == "odd")
    on_front = [angle for angle in angles if 15.0 <= angle <= 31.0]
    assert on_front[0] < 16.0
    assert on_front[-1] > 30.0
    assert max(np.diff(on_front)) < 2.0


def test_a_generation_near_the_best_still_employs_every_worker() -> None:
    """Differential evolution that has converged makes mostly children that the run had before."""
    optimiser = Optimiser(MIXED, seed=1, population=20)
    assert optimiser.method == "de"
    sizes = []
    for _ in range(100):
        generation = optimiser.ask()
        sizes.append(len(generation))
        optimiser.tell(list(compute(generation)))
    assert np.mean(sizes[50:]) > 19.0
    assert min(sizes) > 10


def test_a_space_of_few_candidates_is_gone_through_and_then_it_ends() -> None:
    few = replace(MIXED, parameters=(replace(PARAMETERS[1], low=2.0, high=2.5), PARAMETERS[2]))
    optimiser = Optimiser(few, seed=0, population=10)
    found = list(
        optimise(optimiser, lambda jobs: (judge(n, {**values, "angle": 15.0}) for n, values in jobs), {}, 1000)
    )
    assert len({tuple(one.values.items()) for one in found}) == len(found) == 12


def test_a_single_candidate_is_proposed_once() -> None:
    alone = replace(MIXED, parameters=(replace(PARAMETERS[1], low=2.0, high=2.0),))
    optimiser = Optimiser(alone, seed=0)
    values = {"angle": 15.0, "pattern": "odd"}
    assert len(list(optimise(optimiser, lambda jobs: (judge(n, values | dict(v)) for n, v in jobs), {}, 9))) == 1


@pytest.mark.parametrize("stop", [0, 7, 20, 133, 300])
def test_a_run_goes_on_as_if_it_had_not_been_interrupted(stop: int) -> None:
    whole = run()
    known = {one.number: one for one in whole[:stop] if one.number % 5 or one.number < stop - 30}
    more = list(optimise(Optimiser(MIXED, seed=1, population=20), compute, known, 300))
    assert sorted([*known.values(), *more], key=lambda one: one.number) == whole


def test_a_run_may_end_within_a_generation_and_be_made_longer() -> None:
    part = run(count=107)
    assert len(part) == 107
    more = optimise(Optimiser(MIXED, seed=1, population=20), compute, {one.number: one for one in part}, 300)
    assert sorted([*part, *more], key=lambda one: one.number) == run()


def test_results_of_another_optimiser_are_refused() -> None:
    known = {one.number: one for one in run(seed=2, count=40)}
    with pytest.raises(RecordingError, match="candidate 0 of the results"):
        list(optimise(Optimiser(MIXED, seed=1, population=20), compute, known, 100))


def test_where_nothing_is_valid_it_goes_towards_where_something_might_be() -> None:
    def refuse(jobs: Iterable[tuple[int, Mapping[str, Value]]]) -> Iterator[Evaluation]:
        for number, values in jobs:
            if values["pattern"] == "none":
                yield Evaluation(number, values, {}, {}, "device", "none")
            else:
                yield Evaluation(number, values, {}, {"room": -abs(float(values["angle"]) - 15.0)}, "room", "small")

    found = list(optimise(Optimiser(MIXED, seed=1, population=20), refuse, {}, 400))
    late = [abs(float(one.values["angle"]) - 15.0) for one in found[200:] if one.values["pattern"] != "none"]
    assert np.median(late) < 2.0
    assert len(late) > 150  # of 200


@pytest.mark.parametrize(
    ("refused", "constraints", "violation"),
    [
        ("", {"a": 1.0, "b": 0.0}, 0.0),
        ("a", {"a": 0.5}, 1.0 + 1.0 / 3.0),
        ("a", {}, 2.0),
        ("b", {"a": 2.0, "b": 3.0}, 0.75),
        ("b", {"a": 2.0, "b": math.inf}, 1.0),
        ("device", {}, 3.0),
        ("objective", {"a": 2.0, "b": 0.0}, 1.0),
    ],
)
def test_violation(refused: str, constraints: dict[str, float], violation: float) -> None:
    bounds = (Bound("a", a_quantity("a"), low=1.0), Bound("b", a_quantity("b"), high=0.0))
    assert measure_violation(Evaluation(0, {}, {}, constraints, refused), bounds) == pytest.approx(violation)


def test_points_of_the_cube_are_brought_to_what_the_parameters_can_be() -> None:
    space = SearchSpace(PARAMETERS)
    points = space.snap(np.random.default_rng(1).uniform(-0.2, 1.2, (200, 3)))
    assert (space.snap(points) == points).all()
    values = [space.values(point) for point in points]
    assert {one["pattern"] for one in values} == {"even", "odd", "mixed", "none"}
    assert len({one["radius"] for one in values}) == 13
    angles = [float(one["angle"]) for one in values]
    assert (min(angles), max(angles)) == (-20.0, 60.0)


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda: Optimiser(MIXED, seed=1, population=3), "population"),
        (lambda: Optimiser(MIXED, seed=-1), "seed"),
        (lambda: Optimiser(replace(MIXED, goals=()), seed=1), "no objective"),
        (lambda: Optimiser(replace(MIXED, parameters=()), seed=1), "no free parameter"),
        (lambda: Optimiser(MIXED, seed=1).tell([]), "asked"),
    ],
)
def test_what_makes_no_optimiser_is_named(make: Callable[[], object], what: str) -> None:
    with pytest.raises(InputError, match=what):
        make()
