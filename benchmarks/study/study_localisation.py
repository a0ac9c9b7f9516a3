"""Recovery of planted errors on the sphere and of planted information, in simulated studies.

    python benchmarks/study/study_localisation.py [--studies 1000] [--people 6] [--json]

Bias and slope: made-up people answer each of the 25 published set-points twice. Each has an upward bias of their own
(mean 2°) or a slope of their own of the distance over θ (mean 0.08 mm/°), and scatters from trial to trial. Counted is
how often the 95 % interval of the analysis holds the planted mean, for several spreads between people.

Information: answers to 25 set-points, 12 each, are drawn from a known confusion matrix, whose information is computed
exactly. Told are bias and standard deviation of each estimate in per cent of the truth, over studies, and how often
the interval holds it. The spread is what 300 trials leave uncertain in one study; no estimator can lessen it much.
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numpy as np

from haptorb.child_process import count_cores
from haptorb_study.analysis.comparison import compare_conditions
from haptorb_study.set_points import directions
from haptorb_study.statistics.information import transfer_information
from haptorb_study.statistics.sphere import local_axes
from haptorb_study.study_file import Study, study_of

BIAS, SLOPE = 2.0, 0.08  #: planted: [deg], [mm/deg]
SPREADS = (0.0, 0.5, 1.5)  #: between people, in parts of the bias or of the slope
#: width of the confusion about the set-point [deg], share of answers that are random
CONFUSIONS = ((6.0, 0.02), (9.0, 0.02), (13.0, 0.02), (9.0, 0.1))


def make_study() -> Study:
    """Localisation on the published layout."""
    return study_of('name = "places"\nprocedure = "localisation"')


def plant(study: Study, people: int, seed: int, claim: str, spread: float) -> dict[str, np.ndarray]:
    """Columns of one study of `people`, with the `claim` planted."""
    draw = np.random.default_rng([seed, 1])
    ways = directions(study.points)
    theta = np.array([point.theta_deg for point in study.points])
    contact = study.load_device().contact_distance
    up, around = local_axes(ways)
    up, around = (
        np.where(np.isfinite(up), up, [1.0, 0.0, 0.0]),
        np.where(np.isfinite(around), around, [0.0, 1.0, 0.0]),
    )
    parts = []
    for n in range(people):
        own = 1 + spread * draw.standard_normal()
        which = np.tile(np.arange(len(ways)), 2)
        if claim == "upward-bias":
            along = BIAS * own + 6.0 * draw.standard_normal(len(which))
            side = 6.0 * draw.standard_normal(len(which))
        else:
            # A chord as long as is wanted on average, at an angle that is drawn: distances are never negative.
            mean = np.maximum(3.0 + SLOPE * own * theta[which], 0.05)
            chord = mean * draw.gamma(4.0, 0.25, len(which))
            angle = np.degrees(2 * np.arcsin(np.minimum(chord / (2e3 * contact), 1.0)))
            turn = draw.uniform(0, 2 * np.pi, len(which))
            along, side = angle * np.cos(turn), angle * np.sin(turn)
        size = np.radians(np.hypot(along, side))[:, None]
        step = np.radians(along)[:, None] * up[which] + np.radians(side)[:, None] * around[which]
        place = contact * (np.cos(size) * ways[which] + np.sinc(size / np.pi) * step)
        parts.append((np.full(len(which), f"P{n:02d}"), which, place))
    who, which, place = (np.concatenate([part[k] for part in parts]) for k in range(3))
    return {
        "participant": who, "condition": np.full(len(who), "base"), "theta_deg": theta[which],
        "set_point": np.array([point.number for point in study.points])[which], "answer": np.full(len(who), np.nan),
        "distance_mm": 1e3 * np.linalg.norm(place - contact * ways[which], axis=1),
        "x_m": place[:, 0], "y_m": place[:, 1], "z_m": place[:, 2],
    }  # fmt: skip


def cover(claim: str, spread: float, people: int, seeds: range) -> list[tuple[float, bool, bool]]:
    """Of each study: what was found, whether the interval holds what was planted, and whether p < 0.05."""
    study, truth, found = make_study(), BIAS if claim == "upward-bias" else SLOPE, []
    for seed in seeds:
        columns = plant(study, people, seed, claim, spread)
        rows = compare_conditions(study, columns, sorted(set(columns["participant"].tolist())))
        row = next(one for one in rows if one.what == claim)
        found.append((row.difference, row.low <= truth <= row.high, row.p < 0.05))
    return found


def confuse(width: float, stray: float) -> np.ndarray:
    """(25, 25) share of answers by set-point: neighbours by distance, and the share `stray` anywhere."""
    ways = directions(make_study().points)
    apart = np.degrees(np.arccos(np.clip(ways @ ways.T, -1, 1)))
    near = np.exp(-0.5 * (apart / width) ** 2)
    matrix: np.ndarray = (1 - stray) * near / near.sum(axis=1, keepdims=True) + stray / len(ways)
    return matrix


def true_information(matrix: np.ndarray) -> float:
    """Of equally frequent prompts answered by `matrix` [bit], by its definition."""
    joint = matrix / len(matrix)
    alone = joint.sum(axis=1, keepdims=True) * joint.sum(axis=0, keepdims=True)
    return float(np.sum(joint * np.log2(np.where(joint > 0, joint / alone, 1.0))))


def inform(width: float, stray: float, people: int, seeds: range) -> list[tuple[float, ...]]:
    """Of each study of 12 answers to each set-point: the estimates, and the interval's ends [bit]."""
    matrix, found = confuse(width, stray), []
    each = 12 // people
    for seed in seeds:
        draw = np.random.default_rng([seed, 2])
        counts = np.stack([[draw.multinomial(each, row) for row in matrix] for _ in range(people)]).astype(float)
        one = transfer_information(counts)
        found.append((one.bits, one.plug_in, one.miller_madow, one.plug_in - one.chance, one.low, one.high))
    return found


def measure(studies: int, people: int, processes: int) -> dict[str, Any]:
    """Coverage of bias and slope, and how near the estimates of the information come."""
    parts = [range(k, studies, processes) for k in range(processes)]
    claims, information = [], []
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as workers:
        for claim, truth in (("upward-bias", BIAS), ("error-slope", SLOPE)):
            for spread in SPREADS if claim == "upward-bias" else (0.0, 0.2, 0.3):
                runs = workers.map(cover, *zip(*[(claim, spread, people, part) for part in parts], strict=True))
                rows = np.array([row for run in runs for row in run], dtype=float)
                claims.append(
                    {
                        "claim": claim, "planted": truth, "between_people": spread * truth, "people": people,
                        "mean_found": float(rows[:, 0].mean()), "coverage": float(rows[:, 1].mean()),
                        "power": float(rows[:, 2].mean()), "studies": studies,
                    }
                )  # fmt: skip
        for width, stray in CONFUSIONS:
            truth = true_information(confuse(width, stray))
            runs_ = workers.map(inform, *zip(*[(width, stray, 6, part) for part in parts], strict=True))
            rows = np.array([row for run in runs_ for row in run])
            names = ("corrected", "plug_in", "miller_madow", "less_shuffled")
            information.append(
                {
                    "random_percent": 100 * stray,
                    "correct_percent": 100 * float(confuse(width, stray).diagonal().mean()), "true_bit": truth,
                    "trials": 300, "studies": studies,
                    **{f"{n}_bias_percent": 100 * float(rows[:, k].mean() / truth - 1) for k, n in enumerate(names)},
                    **{f"{n}_sd_percent": 100 * float(rows[:, k].std() / truth) for k, n in enumerate(names)},
                    "coverage": float(np.mean((rows[:, 4] <= truth) & (truth <= rows[:, 5]))),
                }
            )  # fmt: skip
    return {"claims": claims, "information": information}


def main() -> None:
    """Measure, and print for people or machines."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--studies", type=int, default=1000)
    parser.add_argument("--people", type=int, default=6)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = measure(options.studies, options.people, count_cores())
    if options.json:
        print(json.dumps(found))
        return
    for row in found["claims"]:
        print(
            f"{row['claim']} {row['planted']:g}, ±{row['between_people']:.3g} between {row['people']} people: found "
            f"{row['mean_found']:.4g} on average, 95 % interval holds it in {100 * row['coverage']:.1f} % of "
            f"{row['studies']} studies, p < 0.05 in {100 * row['power']:.0f} %"
        )
    for row in found["information"]:
        print(
            f"information {row['true_bit']:.3f} bit ({row['correct_percent']:.0f} % correct, "
            f"{row['random_percent']:.0f} % random), {row['trials']} trials: "
            f"corrected {row['corrected_bias_percent']:+.1f} ± {row['corrected_sd_percent']:.1f} %, Miller–Madow "
            f"{row['miller_madow_bias_percent']:+.1f} %, less shuffled {row['less_shuffled_bias_percent']:+.1f} %, "
            f"plug-in {row['plug_in_bias_percent']:+.1f} %; interval holds it in {100 * row['coverage']:.1f} %"
        )


if __name__ == "__main__":
    main()
