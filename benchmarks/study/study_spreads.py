"""Intervals of a psychometric function whose answers hardly depend on the level; fixed seeds.

    python benchmarks/study/study_spreads.py [--studies 2000] [--groups 400] [--rows person group] [--json]
        [--observers careful ...] [--designs 0 1 2] [--people 6 12] [--seed 0]

Constant stimuli at levels from 0.6 to 1.4, the same number of answers at each. The spread of the observers goes from
0.1 to 5 times the range of the levels, and to no dependence at all. An observer is simulated trial by trial, without
the functions of the fit: a percept is the level plus normal noise, and is called the stronger above the observer's own
point of equality; in some trials (lapses) a key is pressed without attending. The comparison comes equally often in
both intervals.

careful     point of equality anywhere in the middle 60 % of the range, 4 % of the trials without attention on average
biased      point of equality at 80 % of the range
inattentive one trial in five without attention
one-key     one trial in five: always the same key
reversed    careful, with the keys taken for each other
always-1    key 1 in every trial: the truth is a function that does not depend on the level

An interval of the spread may be closed or have an open end (a limit). It holds the truth if the true spread is inside;
of observers who do not depend on the level, if the upper end is open. Reported in per cent, by observer and spread:

Groups: 9 levels, 20 answers each; people differ by 0.15 in log spread and 0.06 of the range in threshold. In a reversed
group one person takes the keys for each other, and is to be left out.

holds       intervals of the spread, open ends included, that hold the truth
closed      studies with both ends; the rest have a limit only
possible    the most that can be closed above: the power (2.5 %, one side) of the best test between the observer's own
            function, lapses and point of equality known, and one that does not depend on the level
threshold   the same of the threshold, point of equality (observers who have one)
reversed    studies in which the answers are called reversed
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from haptorb_study.statistics.population import fit_group
from haptorb_study.statistics.psychometric_function import LevelCounts
from haptorb_study.statistics.psychometric_likelihood import SlopeLikelihood

LOW, HIGH = 0.6, 1.4
SPREADS = (0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, np.inf)  #: over the range
OBSERVERS = ("careful", "biased", "inattentive", "one-key", "reversed", "always-1")
GROUP_SPREADS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, np.inf)
DESIGNS = ((9, 20), (7, 10), (5, 60))  #: levels, answers at each
GROUP_SD = (0.15, 0.06)  #: between people: of the log spread, and of the threshold in ranges
_AT_ONCE = 250
Numbers = np.ndarray[Any, Any]


def answer_trials(
    draw: np.random.Generator, equal: Numbers, spread: Numbers, absent: Numbers, levels: Numbers, each: int,
    favourite: float = 0.5, swapped: bool = False,
) -> Numbers:  # fmt: skip
    """(people, levels) how often the comparison was called the stronger, `each` trials at each level.

    equal     (people,) point of equality      spread    (people,) standard deviation of the percept
    absent    (people,) share of trials without attention, in which key 1 is pressed with probability `favourite`
    """
    shape = (len(equal), len(levels), each)
    second = np.arange(each) % 2 == 0  # the comparison comes in the second interval of every other trial
    noise = draw.standard_normal(shape)
    distance = levels[:, None] - equal[:, None, None]
    wide = spread[:, None, None]
    certain = np.where(np.isinf(wide), noise, distance + np.where(np.isinf(wide), 0.0, wide) * noise) > 0
    key = np.where(certain ^ swapped, np.where(second, 2, 1), np.where(second, 1, 2))
    pressed = np.where(draw.random(shape) < favourite, 1, 2)
    key = np.where(draw.random(shape) < absent[:, None, None], pressed, key)
    found: Numbers = (key == np.where(second, 2, 1)).sum(axis=2)
    return found


def seeded(observer: str, spread: float, size: int, other: int, seed: int) -> np.random.Generator:
    """A cell's own random numbers."""
    words = [OBSERVERS.index(observer), SPREADS.index(spread), size, other]
    return np.random.default_rng([*words, seed] if seed else words)


def draw_places(draw: np.random.Generator, observer: str, people: int) -> Numbers:
    """(people,) points of equality over the range of the levels."""
    return np.full(people, 0.8) if observer == "biased" else draw.uniform(0.2, 0.8, people)


def draw_absent(draw: np.random.Generator, observer: str, people: int) -> Numbers:
    """(people,) share of trials without attention."""
    absent = 2 * draw.beta(2, 98, people)
    if observer in ("inattentive", "one-key"):
        return np.full(people, 0.2)
    return np.ones(people) if observer == "always-1" else absent


def draw_observers(
    draw: np.random.Generator, observer: str, spread: float, people: int, levels: Numbers, each: int
) -> tuple[LevelCounts, Numbers]:
    """Counted answers of `people` alike, and each one's point of equality; `spread` in ranges of the levels."""
    span = levels[-1] - levels[0]
    equal = levels[0] + span * draw_places(draw, observer, people)
    absent = draw_absent(draw, observer, people)
    favourite = 1.0 if observer in ("one-key", "always-1") else 0.5
    yes = answer_trials(
        draw, equal, np.full(people, spread * span), absent, levels, each, favourite, observer == "reversed"
    )
    return LevelCounts(levels, yes.astype(float), np.full(yes.shape, float(each))), equal


def most_closed(observer: str, spread: float, design: tuple[int, int], people: int = 2000) -> float:
    """Power of the likelihood ratio between each observer's true function and its mean, as if both were known; the
    ratio's logarithm is a sum over the levels, nearly normal."""
    count, each = design
    levels = np.linspace(LOW, HIGH, count)
    draw = seeded(observer, spread, count, each, 99)
    span = HIGH - LOW
    middle = (LOW + span * draw_places(draw, observer, people))[:, None]
    absent = draw_absent(draw, observer, people)
    stronger = (1 - absent[:, None]) * ndtr((levels - middle) / (spread * span)) + 0.5 * absent[:, None]
    flat = stronger.mean(axis=1, keepdims=True)
    weight = np.log(stronger / flat) - np.log((1 - stronger) / (1 - flat))
    moved = each * (weight * (stronger - flat)).sum(axis=1)
    under, true = (np.sqrt(each * (weight**2 * p * (1 - p)).sum(axis=1)) for p in (flat, stronger))
    return float(ndtr((moved - ndtri(0.975) * under) / true).mean())


def check_people(observer: str, spread: float, design: tuple[int, int], studies: int, seed: int = 0) -> dict[str, Any]:
    """One cell: `studies` people with one kind of observer, spread and design."""
    count, each = design
    levels = np.linspace(LOW, HIGH, count)
    span = HIGH - LOW
    draw = seeded(observer, spread, count, each, seed)
    truth = np.inf if observer == "always-1" else spread * span
    rows = []
    for first in range(0, studies, _AT_ONCE):
        answered, equal = draw_observers(draw, observer, spread, min(_AT_ONCE, studies - first), levels, each)
        found = SlopeLikelihood(answered)
        for n, middle in enumerate(equal):
            low, high = found.spread_95(n)
            below, above = found.threshold_95(n)
            backwards = found.direction(n) == "falling"
            given = not np.isnan(low)
            right_way = backwards == (observer == "reversed") or not np.isfinite(truth)
            holds = given and low <= truth <= high and (right_way or high == np.inf)
            closed = given and low > 0 and high < np.inf
            rows.append((given, holds, closed, below <= middle <= above, np.isfinite([below, above]).all(), backwards))
    table = np.array(rows, dtype=float)
    given = table[:, 0] > 0
    flat = not np.isfinite(truth)
    return {
        "observer": observer, "spread_over_range": None if flat else spread, "levels": count, "answers_each": each,
        "studies": studies, "given": float(given.mean()), "holds": float(table[given, 1].mean()),
        "closed": float(table[:, 2].mean()),
        "closed_holds": float(table[table[:, 2] > 0, 1].mean()) if table[:, 2].any() else None,
        "threshold_holds": None if flat else float(table[given, 3].mean()),
        "threshold_closed": float(table[:, 4].mean()), "reversed": float(table[:, 5].mean()),
        "possible": None if flat else most_closed(observer, spread, design),
    }  # fmt: skip


def check_groups(observer: str, spread: float, people: int, studies: int, seed: int = 0) -> dict[str, Any]:
    """One cell: `studies` groups of people who differ by 0.15 in log spread and 0.06 of the range in threshold."""
    count, each = DESIGNS[0]
    levels = np.linspace(LOW, HIGH, count)
    span = HIGH - LOW
    draw = seeded(observer, spread, people, 7, seed)
    truth = np.inf if observer == "always-1" else spread * span
    rows = []
    for _ in range(studies):
        middle = (0.8 if observer == "biased" else 0.5) * span + LOW
        equal = middle + GROUP_SD[1] * span * draw.standard_normal(people)
        spreads = spread * span * np.exp(GROUP_SD[0] * draw.standard_normal(people))
        absent = draw_absent(draw, observer, people)
        favourite = 1.0 if observer in ("one-key", "always-1") else 0.5
        yes = answer_trials(draw, equal, spreads, absent, levels, each, favourite)
        if observer == "reversed":
            yes[-1] = each - yes[-1]
        answered = LevelCounts(levels, yes.astype(float), np.full(yes.shape, float(each)))
        group = fit_group(SlopeLikelihood(answered))
        if group is None:  # nobody is left: everybody's answers fall with the level
            rows.append((0, 0, 0, 0, 0, 1, 0))
            continue
        low, high = np.exp(group.log_spread.mean_95)
        below, above = group.threshold.mean_95
        given = not np.isnan(low)
        rows.append((
            given, given and low <= truth <= high, given and low > 0 and high < np.inf, below <= middle <= above,
            np.isfinite([below, above]).all(), not given, group.by_slope,
        ))  # fmt: skip
    table = np.array(rows, dtype=float)
    given, flat = table[:, 0] > 0, not np.isfinite(truth)
    return {
        "observer": observer, "spread_over_range": None if flat else spread, "people": people, "levels": count,
        "answers_each": each, "studies": studies, "given": float(given.mean()),
        "holds": float(table[given, 1].mean()) if given.any() else None, "closed": float(table[:, 2].mean()),
        "closed_holds": float(table[table[:, 2] > 0, 1].mean()) if table[:, 2].any() else None,
        "threshold_holds": None if flat or not given.any() else float(table[given, 3].mean()),
        "threshold_closed": float(table[:, 4].mean()), "reversed": float(table[:, 5].mean()),
        "by_slope": float(table[:, 6].mean()),
    }  # fmt: skip


def main() -> None:
    """Measure, and print for people or machines."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--studies", type=int, default=2000, help="people in each cell of the row person")
    parser.add_argument("--groups", type=int, default=400, help="groups in each cell of the row group")
    parser.add_argument("--rows", nargs="+", default=["person", "group"], choices=["person", "group"])
    parser.add_argument("--observers", nargs="+", default=list(OBSERVERS), choices=OBSERVERS)
    parser.add_argument("--designs", type=int, nargs="+", default=[0, 1, 2], choices=range(len(DESIGNS)))
    parser.add_argument("--people", type=int, nargs="+", default=[6, 12])
    parser.add_argument("--seed", type=int, default=0, help="other random numbers than those of the documentation")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    start, found = time.perf_counter(), []
    for check, arguments in list_cells(options):
        found.append(check(*arguments))
        if not options.json:
            print(describe(found[-1]), flush=True)
    if options.json:
        print(json.dumps({"seconds": time.perf_counter() - start, "rows": found}, indent=1))


def list_cells(options: argparse.Namespace) -> Iterator[tuple[Callable[..., dict[str, Any]], tuple[Any, ...]]]:
    """Which cells are measured: function and arguments."""
    for observer in options.observers:
        spreads = SPREADS[-1:] if observer == "always-1" else SPREADS[:-1] if observer == "reversed" else SPREADS
        if "person" in options.rows:
            for number in options.designs:
                design = DESIGNS[number]
                yield from (
                    (check_people, (observer, spread, design, options.studies, options.seed)) for spread in spreads
                )
        if "group" in options.rows:
            for people in options.people:
                few = [spread for spread in spreads if spread in GROUP_SPREADS]
                yield from ((check_groups, (observer, spread, people, options.groups, options.seed)) for spread in few)


def describe(one: dict[str, Any]) -> str:
    """One row for people."""

    def percent(value: float | None) -> str:
        return "   –  " if value is None else f"{100 * value:6.1f}"

    spread = "  ∞ " if one["spread_over_range"] is None else f"{one['spread_over_range']:4g}"
    return (
        f"{one.get('people', 1):2} × {one['levels']} × {one['answers_each']:2} {one['observer']:11} spread {spread} "
        f"given {percent(one['given'])} "
        f"holds {percent(one['holds'])} closed {percent(one['closed'])} closed holds {percent(one['closed_holds'])} "
        f"threshold {percent(one['threshold_holds'])} "
        f"closed {percent(one['threshold_closed'])} reversed {percent(one['reversed'])} "
        f"possible {percent(one.get('possible'))}"
    )


if __name__ == "__main__":
    main()
