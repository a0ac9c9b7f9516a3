"""Time to analyse a study: 300 trials of the published study, and 60 people with 500 trials each.

    python benchmarks/study/study_analysis.py [--people 60] [--trials 500] [--json]

The answers are made up (the prompted number or a neighbour; a normal psychometric function), because only their number
matters here. "numbers" is what `haptorb study analyse --json` computes; "with report" adds figures and report; "group"
is the hierarchical fit alone.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtr

from haptorb_study.analysis.analysis import analysis_of
from haptorb_study.analysis.report import write_report
from haptorb_study.database import database, trials
from haptorb_study.prompts import Prompt
from haptorb_study.statistics.population import fit_group
from haptorb_study.statistics.psychometric_likelihood import SlopeLikelihood
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import Study, study_of

LEVELS = "[levels]\nreference = 1.2\nvalues = [0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6, 1.7]\n"
TRACK = "[levels]\nreference = 1.2\nleast = 0.01\nmost = 1.0\nstart = 0.8\nreversals = 100\ntrials = 500\n"


def make_study(procedure: str, each: int) -> Study:
    """A study with about `each` trials per person."""
    rest = {
        "identification": f"[trials]\nrepetitions = {max(1, round(each / 25))}\n",
        "constant": f"[trials]\nrepetitions = {max(1, round(each / 10))}\n{LEVELS}",
        "staircase": TRACK,
        "bayesian": TRACK,
    }[procedure]
    return study_of(f'name = "timed"\nprocedure = "{procedure}"\n{rest}')


def fill_database(place: Path, study: Study, people: int, each: int) -> None:
    """A database with `each` answered trials per person."""
    engine = database(place)
    draw = np.random.default_rng(0)
    for person in range(people):
        with StoredSession(engine, study, f"SIM{person + 1:02d}", simulated=True) as session:
            prompts = _list_prompts(study, session.procedure, each, draw)
            rows = [_answer(study, prompt, number, draw) for number, prompt in enumerate(prompts)]
            with engine.begin() as connection:  # all at once: writing them one by one is timed elsewhere
                connection.execute(trials.insert(), [{"session": session.id, **row} for row in rows])
    engine.dispose()


def _list_prompts(study: Study, procedure: Any, each: int, draw: np.random.Generator) -> list[Prompt]:
    """What the plan lists; of an adaptive procedure, whose choices take longer than their analysis, any levels."""
    listed = [prompt for part in procedure.parts for prompt in getattr(part, "prompts", ())]
    if listed:
        return listed[:each]
    differences = np.geomspace(0.01, 1.0, 30)[draw.integers(0, 30, each)]
    name = study.conditions[0].name
    return [
        Prompt(condition=name, level=1.2 + float(d), interval=1 + n % 2, low=1, high=2)
        for n, d in enumerate(differences)
    ]


def _answer(study: Study, prompt: Prompt, number: int, draw: np.random.Generator) -> dict[str, Any]:
    """A row of the database."""
    if prompt.interval:
        p = ndtr((prompt.level - 1.2) / 0.15)
        value = prompt.interval if draw.random() < p else 3 - prompt.interval
        x = y = z = None
    else:
        value = prompt.set_point if number % 5 else 1 + prompt.set_point % 25
        x, y, z = (0.05 * c for c in study.point(value).direction)
    return {
        "number": number, "prompt": json.dumps(prompt.row()), "answer": value, "x": x, "y": y, "z": z, "seconds": 1.0,
        "safety": "[]", "recording": None, "answered": "2026-01-01T00:00:00+00:00",
    }  # fmt: skip


def measure(procedure: str, people: int, each: int) -> dict[str, Any]:
    """Seconds for numbers and for the report, figures included."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder, "s.db")
        fill_database(place, make_study(procedure, each), people, each)
        start = time.perf_counter()
        analysis = analysis_of(place)
        numbers = time.perf_counter() - start
        write_report(analysis, Path(folder, "report"))
        found = {
            "procedure": procedure, "people": people, "trials": analysis.trials, "numbers_s": numbers,
            "with_report_s": time.perf_counter() - start,
        }  # fmt: skip
        for one in analysis.curves.values():
            start = time.perf_counter()
            fit_group(SlopeLikelihood(one.answered))
            found["group_s"] = time.perf_counter() - start
        return found


def main() -> None:
    """Measure, and print for people or machines."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--people", type=int, default=60)
    parser.add_argument("--trials", type=int, default=500, help="of each person")
    parser.add_argument("--procedures", default="identification,constant,staircase,bayesian")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    measure("identification", 2, 25)  # warm-up: modules, fonts
    found = [measure(one, options.people, options.trials) for one in options.procedures.split(",")]
    if options.json:
        print(json.dumps({"runs": found}))
        return
    for one in found:
        group = f", group {one['group_s']:.2f} s" if "group_s" in one else ""
        print(
            f"{one['procedure']:15} {one['people']} people, {one['trials']} trials: numbers {one['numbers_s']:.2f} s, "
            f"with report {one['with_report_s']:.2f} s{group}"
        )


if __name__ == "__main__":
    main()
