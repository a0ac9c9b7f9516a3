"""Comparison of pymoo and Optuna: time of the optimiser itself, and quality of its Pareto front.

    python benchmarks/design/optimiser_libraries.py [--evaluations 10000] [--seeds 3]

Needs Optuna, which haptorb does not (pip install optuna). The problem: seven parameters (four ranges, two with steps of
0.05, one choice of three), two objectives, two constraints that cut the front; all a formula, so that the seconds are
processor time of the optimiser alone. "front" is the mean hypervolume below (1.1, 1.5) over the seeds, after so many
evaluations. Each asks for a whole generation and is told all of it.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

import numpy as np

from haptorb_design.problem import Bound, Design, DesignGoal, DesignParameter, DesignQuantity, Evaluation, Value
from haptorb_design.search import Optimiser

CHOICES = ("a", "b", "c")
RANGES, STEPS = ("x0", "x1", "x2", "x3"), ("s0", "s1")
WORST = (1.1, 1.5)
Judged = tuple[tuple[float, float], tuple[float, float]]


def judge(values: Mapping[str, Value]) -> Judged:
    """Two objectives, to be made small, and two constraints, kept where they are 0 or less."""
    x = np.array([float(values[name]) for name in RANGES])
    s, t, c = float(values["s0"]), float(values["s1"]), CHOICES.index(str(values["c"]))
    rest = 1.0 + 4.0 * float(np.sum((x[1:] - 0.4 - 0.05 * c) ** 2)) + 3.0 * (s - 0.6) ** 2 + abs(t - 0.3)
    rest += (0.3, 0.0, 0.15)[c]
    first = float(x[0])
    second = rest * (1.0 - np.sqrt(first / rest)) + (0.0, 0.1, 0.05)[c] * first
    return (first, float(second)), (0.2 - abs(first - 0.5), s + t - 1.2)


def measure_front(found: Iterable[Judged]) -> float:
    """Hypervolume of the valid."""
    area, best = 0.0, WORST[1]
    for first, second in sorted(goals for goals, bounds in found if max(bounds) <= 0.0):
        if first < WORST[0] and second < best:
            area += (WORST[0] - first) * (best - second)
            best = second
    return area


def run_haptorb(seed: int, count: int, population: int) -> tuple[list[Judged], float]:
    """haptorb's optimiser, which is pymoo's NSGA-II."""
    optimiser = Optimiser(_make_design(), seed=seed, population=population)
    found: list[Judged] = []
    own = 0.0
    while len(found) < count:
        begin = time.process_time()
        jobs = optimiser.ask()
        own += time.process_time() - begin
        judged = [judge(values) for _, values in jobs]
        found += judged
        answers = [_evaluation(number, values, one) for (number, values), one in zip(jobs, judged, strict=True)]
        begin = time.process_time()
        optimiser.tell(answers)
        own += time.process_time() - begin
    return found, own


def run_optuna(seed: int, count: int, population: int, make: Callable[[int, int], Any]) -> tuple[list[Judged], float]:
    """One of Optuna's samplers."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    warnings.simplefilter("ignore", FutureWarning)  # constraints_func goes in Optuna 7
    study = optuna.create_study(directions=["minimize", "minimize"], sampler=make(seed, population))
    found: list[Judged] = []
    own = 0.0
    while len(found) < count:
        begin = time.process_time()
        trials = [study.ask() for _ in range(population)]
        values = [_suggest(trial) for trial in trials]
        own += time.process_time() - begin
        judged = [judge(one) for one in values]
        found += judged
        begin = time.process_time()
        for trial, (goals, bounds) in zip(trials, judged, strict=True):
            trial.set_user_attr("bounds", bounds)
            study.tell(trial, goals)
        own += time.process_time() - begin
    return found, own


def make_nsga2(seed: int, population: int) -> Any:
    """Optuna's NSGA-II."""
    import optuna

    return optuna.samplers.NSGAIISampler(
        population_size=population, seed=seed, constraints_func=lambda trial: trial.user_attrs["bounds"]
    )


def make_tpe(seed: int, population: int) -> Any:
    """Optuna's tree-structured Parzen estimator."""
    import optuna

    return optuna.samplers.TPESampler(
        seed=seed, multivariate=True, constant_liar=True, constraints_func=lambda trial: trial.user_attrs["bounds"]
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--evaluations", type=int, default=10_000)
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    cases: dict[str, tuple[Callable[[int, int, int], tuple[list[Judged], float]], int]] = {
        "haptorb (pymoo NSGA-II)": (run_haptorb, options.evaluations),
        "Optuna NSGA-II": (partial(run_optuna, make=make_nsga2), options.evaluations),
        "Optuna TPE": (partial(run_optuna, make=make_tpe), min(options.evaluations, 1000)),
    }
    for name, (run, count) in cases.items():
        runs = [run(seed, count if seed == 0 else min(count, 2000), 50) for seed in range(options.seeds)]
        fronts = {
            stop: np.mean([measure_front(found[:stop]) for found, _ in runs if len(found) >= stop])
            for stop in (500, 1000, 2000, options.evaluations)
            if any(len(found) >= stop for found, _ in runs)
        }
        text = ", ".join(f"{front:.3f} after {stop}" for stop, front in fronts.items())
        print(f"{name:24} {runs[0][1]:6.1f} s of its own in {count} evaluations; front {text}", flush=True)


def _suggest(trial: Any) -> dict[str, Value]:
    values: dict[str, Value] = {name: trial.suggest_float(name, 0.0, 1.0) for name in RANGES}
    values |= {name: trial.suggest_float(name, 0.0, 1.0, step=0.05) for name in STEPS}
    values["c"] = trial.suggest_categorical("c", CHOICES)
    return values


def _make_design() -> Design:
    def quantity(name: str) -> DesignQuantity:
        return DesignQuantity(name, "", "minimise", name, (), lambda candidate: 0.0)

    parameters = (
        *(DesignParameter(name, (), high=1.0) for name in RANGES),
        *(DesignParameter(name, (), high=1.0, step=0.05) for name in STEPS),
        DesignParameter("c", (), choices=tuple((label, label) for label in CHOICES)),
    )
    goals = tuple(DesignGoal(quantity(name), "minimise") for name in ("first", "second"))
    bounds = tuple(Bound(name, quantity(name), high=0.0) for name in ("gap", "sum"))
    return Design("formula", "Formula", "omni", parameters, goals, bounds, {}, "", "")


def _evaluation(number: int, values: Mapping[str, Value], judged: Judged) -> Evaluation:
    goals, bounds = judged
    refused = next((name for name, bound in zip(("gap", "sum"), bounds, strict=True) if bound > 0.0), "")
    objectives = {} if refused else dict(zip(("first", "second"), goals, strict=True))
    return Evaluation(number, values, objectives, dict(zip(("gap", "sum"), bounds, strict=True)), refused)


if __name__ == "__main__":
    main()
