"""Coverage of a study's 95 % intervals in simulated studies; all cores, fixed seeds.

    python benchmarks/study/study_coverage.py [--studies 1000] [--first 0] [--cores N] [--json]
        [--rows group corners misfit door adaptive] [--people 6 12 24] [--sd 0 0.05 0.15]

`--first` is the seed of the first study; `--people` and `--sd` choose cells of the rows group, corners and misfit.

group     6, 12 and 24 people, standard deviation between people 0, 0.05 and 0.15: of the threshold as a fraction of the
          reference, of the slope in units of its natural logarithm, of accuracy in proportion units, of the mean error
          as a fraction of it. Each interval comes from the function that `haptorb study analyse` uses.
corners   accuracy of 2 trials each; accuracy 0.95 on average, and people whose logits are normal instead of Beta
misfit    people and functions that the fits do not assume: logistic functions, exponential (skewed) differences between
          people, lapse rates of 5 % in three of ten people and 0.5 % in the others, 8 to 30 answers at each level
door      whole studies: study file, plan, every prompt answered, `analyse`. 6 people, standard deviation 0.05.
adaptive  staircases and QUEST+ as `haptorb study run` runs them, analysed as `haptorb study analyse` does: 6 people,
          60 trials (40 with QUEST+, and a tenth of the studies), standard deviation of log2 threshold 0.2.

Conditions: constant stimuli with a normal psychometric function, point of equality 1 (the reference), spread 0.12,
lapse rates Beta(2, 98) in both tails, 9 levels from 0.6 to 1.4, 20 answers each. Accuracy 0.72 on average (Beta over
people), 50 trials. Errors: gamma distributed, 6 mm on average, standard deviation three quarters of it, 16 trials.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numpy as np
from simulated_answers import (
    ACCURACY,
    ERROR,
    LEVELS,
    NOTICED,
    SPREAD,
    answer_identification,
    answer_track,
    draw_constant,
    draw_errors,
    draw_logistic_shares,
    draw_misfit,
    draw_shares,
    draw_stored,
)

from haptorb_study.analysis.analysis import analyse
from haptorb_study.statistics.intervals import mean_interval, share_interval
from haptorb_study.statistics.population import fit_group
from haptorb_study.statistics.psychometric_fit import fit_person
from haptorb_study.statistics.psychometric_likelihood import SlopeLikelihood

_ROWS = ["group", "corners", "misfit", "door", "adaptive"]
PEOPLE, SPREADS = (6, 12, 24), (0.0, 0.05, 0.15)
Hits = dict[str, list[bool]]


def check_group(people: int, sd: float, seed: int) -> Hits:
    """One study of each kind: quantity → whether its interval held the truth (of people: for each of them)."""
    draw = np.random.default_rng([seed, people, round(1000 * sd)])
    answered, truth = draw_constant(draw, people, sd)
    likelihood = SlopeLikelihood(answered)
    group = fit_group(likelihood)
    assert group is not None
    alone = [fit_person(likelihood, n, samples=0) for n in range(people)]
    right, of = draw_shares(draw, people, sd)
    low, high = mean_interval(draw_errors(draw, people, sd).mean(axis=1))
    return {
        "threshold": [_holds(group.threshold.mean_95, LEVELS.mean())],
        "slope": [_holds(group.log_spread.mean_95, np.log(SPREAD))],
        "sd_of_thresholds": [_holds(group.threshold.sd_95, sd)],
        "sd_of_slopes": [_holds(group.log_spread.sd_95, sd)],
        "accuracy": [_holds(share_interval(right, of), ACCURACY)],
        "mean_error": [_holds((float(low), float(high)), ERROR)],
        "own_threshold": [_holds(fit.middle_95, x) for fit, x in zip(alone, truth.middles, strict=True)],
        "own_slope": [_holds(fit.spread_95, x) for fit, x in zip(alone, truth.spreads, strict=True)],
    }


def check_corners(people: int, sd: float, seed: int) -> Hits:
    """Shares where they are hardest: few trials, and nearly everybody nearly always right."""
    draw = np.random.default_rng([seed, people, round(1000 * sd), 3])
    few, top = draw_shares(draw, people, sd, trials=2), draw_shares(draw, people, sd, mean=0.95)
    other, high = draw_logistic_shares(draw, people, sd), draw_logistic_shares(draw, people, sd, mean=0.95)
    return {
        "accuracy_of_2_trials": [_holds(share_interval(*few), ACCURACY)],
        "accuracy_of_0.95": [_holds(share_interval(*top), 0.95)],
        "accuracy_normal_logits": [_holds(share_interval(*other), ACCURACY)],
        "accuracy_of_0.95_normal_logits": [_holds(share_interval(*high), 0.95)],
    }


def check_misfit(people: int, sd: float, seed: int) -> Hits:
    """The group's threshold, and its distance from there to 75 %, where the model is not that of the data."""
    draw = np.random.default_rng([seed, people, round(1000 * sd), 4])
    group = fit_group(SlopeLikelihood(draw_misfit(draw, people, sd)))
    assert group is not None
    low, high = (0.6745 * np.exp(end) for end in group.log_spread.mean_95)
    return {
        "threshold": [_holds(group.threshold.mean_95, LEVELS.mean())],
        "noticed_in_75_percent": [_holds((low, high), NOTICED)],
    }


def check_door(people: int, sd: float, seed: int) -> Hits:
    """Two whole studies, from the file to the analysis: constant stimuli and identification."""
    draw = np.random.default_rng([seed, people, round(1000 * sd), 1])
    curve = analyse(*draw_stored(draw, people, sd)).curves["base"].group
    assert curve is not None
    found = analyse(*answer_identification(draw, people, sd))
    assert found.confusion is not None
    ring = next(ring for ring in found.rings if ring.theta_deg == 36.0)
    return {
        "threshold": [_holds(curve.threshold.mean_95, LEVELS.mean())],
        "slope": [_holds(curve.log_spread.mean_95, np.log(SPREAD))],
        "accuracy": [_holds(found.confusion.accuracy_95, ACCURACY)],
        "accuracy_of_a_set_point": [_holds(tuple(row), ACCURACY) for row in found.confusion.right_95],
        "mean_error": [_holds((ring.low, ring.high), ERROR)],
    }


def check_adaptive(procedure: str, people: int, sd: float, seed: int) -> Hits:
    """One study with a staircase or QUEST+."""
    draw = np.random.default_rng([seed, people, round(1000 * sd), 2])
    study, columns, own, truth = answer_track(draw, procedure, people, sd)
    tracks = analyse(study, columns).tracks["base"]
    assert tracks.group is not None
    fits = tracks.people.values()
    return {
        "threshold": [_holds(tracks.group.mean_95, truth)],
        "sd_of_thresholds": [_holds(tracks.group.sd_95, sd)],
        "own_threshold": [_holds(fit.fitted_95, x) for fit, x in zip(fits, own, strict=True)],
    }


def _holds(interval: Any, truth: float) -> bool:
    low, high = interval
    return bool(low <= truth <= high)


def _check(job: tuple[Any, ...]) -> tuple[tuple[Any, ...], Hits]:
    row, *rest = job
    check = {
        "group": check_group, "corners": check_corners, "misfit": check_misfit, "door": check_door,
        "adaptive": check_adaptive,
    }[row]  # fmt: skip
    return tuple(job[:-1]), check(*rest)


def list_jobs(rows: list[str], seeds: range, people: list[int], sds: list[float]) -> Iterator[tuple[Any, ...]]:
    """(row, arguments ..., seed) of every simulated study."""
    for row in rows:
        for seed in seeds:
            if row in ("group", "corners", "misfit"):
                yield from ((row, many, sd, seed) for many in people for sd in sds)
            elif row == "door":
                yield row, 6, 0.05, seed
            else:
                yield row, "staircase", 6, 0.2, seed
                if seed % 10 == 0:
                    yield row, "bayesian", 6, 0.2, seed


def measure(jobs: Iterator[tuple[Any, ...]], cores: int) -> list[dict[str, Any]]:
    """One entry for each row, its conditions and each quantity: number of intervals, and the share that held."""
    counts: dict[tuple[Any, ...], Hits] = {}
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # studies run side by side, not parts of one
    with ProcessPoolExecutor(cores, get_context("spawn")) as pool:
        for cell, hits in pool.map(_check, jobs, chunksize=4):
            known = counts.setdefault(cell, {})
            for name, one in hits.items():
                known.setdefault(name, []).extend(one)
    found = []
    for cell in sorted(counts, key=str):
        *what, people, sd = cell
        for name, hits in counts[cell].items():
            found.append({
                "row": " ".join(what), "people": people, "between_people_sd": sd, "quantity": name,
                "intervals": len(hits), "coverage": float(np.mean(hits)),
            })  # fmt: skip
    return found


def main() -> None:
    """Measure, and print for people or machines."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--studies", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--people", type=int, nargs="+", default=list(PEOPLE), choices=PEOPLE)
    parser.add_argument("--sd", type=float, nargs="+", default=list(SPREADS), choices=SPREADS)
    parser.add_argument("--cores", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--rows", nargs="+", default=_ROWS, choices=_ROWS)  # fmt: skip
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    start = time.perf_counter()
    seeds = range(options.first, options.first + options.studies)
    found = measure(list_jobs(options.rows, seeds, options.people, options.sd), options.cores)
    seconds = time.perf_counter() - start
    if options.json:
        print(json.dumps({"studies": options.studies, "seconds": seconds, "rows": found}, indent=1))
        return
    for one in found:
        print(
            f"{one['row']:20} {one['people']:3} people, SD {one['between_people_sd']:<5g} {one['quantity']:24} "
            f"{100 * one['coverage']:5.1f} % of {one['intervals']}"
        )
    print(f"{seconds:.0f} s")


if __name__ == "__main__":
    main()
