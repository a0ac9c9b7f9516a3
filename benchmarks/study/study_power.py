"""Power by `study power` against the share of significant results of `study analyse` in simulated studies.

    python benchmarks/study/study_power.py [--studies 4000] [--json]

Simulated participants sit small studies once; they are the population. Groups are drawn from them, their answers are
put together as a study would store them, the whole analysis runs, and its p is compared with α. That share, counted
study by study, is set against the power that `power_of` tells from one number per person. Where differences are normal,
the power is also known in closed form, from the noncentral t distribution.
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
from scipy.stats import nct, t

from haptorb.child_process import count_cores
from haptorb_study.analysis.analysis import analyse
from haptorb_study.simulated.power import answer_study, list_columns, power_of, simulate_value
from haptorb_study.study_file import study_of

TWO = '[[conditions]]\nname = "base"\n[[conditions]]\nname = "other"\nparameters = {{ moment = {moment} }}\n'
PLACES = "[set_points]\npoints = [{number = 1, theta_deg = 0}, {number = 2, theta_deg = 36}]\n"
LEVELS = "[levels]\nreference = 1.2\nvalues = [0.9, 1.1, 1.3, 1.5]\n"
#: name → (study file, measure, people, test)
CASES = {
    "rating": ('procedure = "rating"\n[trials]\nrepetitions = 3\n' + TWO.format(moment=2.0), "rating", 8, "t"),
    "error": ('procedure = "localisation"\n' + PLACES + TWO.format(moment=0.7), "error", 12, "t"),
    "error, signs": (
        'procedure = "localisation"\n' + PLACES + TWO.format(moment=0.7), "error", 10, "sign-flip",
    ),
    "choice": ('procedure = "forced-choice"\n[trials]\nrepetitions = 6\n' + TWO.format(moment=2.3), "choice", 12, "t"),
}  # fmt: skip
POPULATION = 60


def sit(case: str) -> tuple[list[dict[str, np.ndarray]], list[float]]:
    """Columns and values of the population of `case`."""
    text, measure, _, _ = CASES[case]
    study = study_of(f'name = "power"\n{text}')
    between = ("base", "other")
    people, values = [], []
    for n in range(POPULATION):
        people.append(list_columns(study, answer_study(study, (7, n + 1), n)[1]))
        values.append(simulate_value(study, (7, n + 1), n, measure, between))
    return people, values


def count_found(case: str, people: list[dict[str, np.ndarray]], studies: int, seed: int, alpha: float) -> int:
    """In how many of so many `studies` the analysis finds p < `alpha`."""
    text, measure, n, test = CASES[case]
    between = 'between = ["base", "other"]'
    plan = f'\n[plan]\nparticipants = {n}\ntest = "{test}"\n[[plan.tests]]\nmeasure = "{measure}"\n{between}\n'
    study = study_of(f'name = "power"\n{text}{plan}')
    draw, found = np.random.default_rng([seed, 1]), 0
    for _ in range(studies):
        group = [people[k] for k in draw.integers(0, len(people), n)]
        columns = {name: np.concatenate([one[name] for one in group]) for name in group[0]}
        sizes = [len(one["answer"]) for one in group]
        columns["participant"] = np.repeat([f"P{k:02d}" for k in range(n)], sizes)
        count = len(columns["answer"])
        columns |= {
            "phase": np.full(count, "main"), "simulated": np.full(count, True), "trial": np.arange(count),
            "simulated_device": np.full(count, True, dtype=object), "safety": np.full(count, ""),
            "repeats": np.zeros(count, dtype=int), "seconds": np.ones(count),
        }  # fmt: skip
        planned = analyse(study, columns).comparisons
        found += bool(planned and planned[0].planned and planned[0].p_corrected < alpha)
    return found


def compare(case: str, studies: int, processes: int, alpha: float = 0.05) -> dict[str, object]:
    """Power as predicted, and as counted."""
    people, values = sit(case)
    _, measure, n, test = CASES[case]
    predicted = power_of(values, (n,), alpha, seed=3, test=test).power  # type: ignore[arg-type]
    shares = [studies // processes + (k < studies % processes) for k in range(processes)]
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as workers:
        counts = workers.map(
            count_found, *zip(*[(case, people, share, k, alpha) for k, share in enumerate(shares)], strict=True)
        )
        counted = sum(counts) / studies
    known = power_of(values, (n,), alpha, seed=3, test=test).people.index(n)  # type: ignore[arg-type]
    return {
        "case": case, "measure": measure, "people": n, "test": test, "power": predicted[known], "counted": counted,
        "studies": studies, "difference_points": 100 * (predicted[known] - counted),
        "standard_error_points": 100 * float(np.sqrt(counted * (1 - counted) / studies)),
    }  # fmt: skip


def compare_normal(effect: float, n: int, alpha: float = 0.05) -> dict[str, object]:
    """Power as predicted from a large pool of normal differences, and in closed form."""
    pool = np.random.default_rng(1).standard_normal(4000)
    pool = (pool - pool.mean()) / pool.std(ddof=1) + effect
    found = power_of(pool.tolist(), (n,), alpha)
    limit, shift = t.ppf(1 - alpha / 2, n - 1), effect * np.sqrt(n)
    exact = float(nct.sf(limit, n - 1, shift) + nct.cdf(-limit, n - 1, shift))
    predicted = found.power[found.people.index(n)]
    return {
        "effect_d_z": effect, "people": n, "power": predicted, "closed_form": exact,
        "difference_points": 100 * (predicted - exact),
    }  # fmt: skip


def main() -> None:
    """Compare, and print for people or machines."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--studies", type=int, default=4000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = [compare(case, options.studies, count_cores()) for case in CASES]
    normal = [compare_normal(effect, n) for effect in (0.0, 0.5, 1.0) for n in (6, 12, 24)]
    if options.json:
        print(json.dumps({"analyses": found, "normal": normal}))
        return
    for row in found:
        print(
            f"{row['case']}, {row['people']} people: power {row['power']:.3f}, counted {row['counted']:.3f} of "
            f"{row['studies']} analyses ({row['difference_points']:+.1f} ± {row['standard_error_points']:.1f} points)"
        )
    for row in normal:
        print(
            f"normal, d_z {row['effect_d_z']:g}, {row['people']} people: power {row['power']:.3f}, closed form "
            f"{row['closed_form']:.3f} ({row['difference_points']:+.1f} points)"
        )


if __name__ == "__main__":
    main()
