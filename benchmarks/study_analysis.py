"""How long the analysis of a study takes: 300 trials, and as many as are asked for.

    python benchmarks/study_analysis.py [--trials 300] [--json]

The trials are made up (every answer the prompted number or a neighbour), because only their number matters here.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

from haptorb.apps.asking.prompt import Answer
from haptorb.apps.study.analysis.load_analysis import analysis_of
from haptorb.apps.study.analysis.report import write_report
from haptorb.apps.study.model.study_file import study_of
from haptorb.apps.study.session.stored_session import StoredSession
from haptorb.apps.study.store.database import database, trials


def fill_database(place: Path, count: int) -> None:
    """A database with `count` answered trials of the published study, 6 participants."""
    each = max(1, round(count / 6 / 25))
    study = study_of(f'name = "timed"\n[trials]\nrepetitions = {each}')
    engine = database(place)
    for person in range(6):
        with StoredSession(engine, study, f"SIM{person + 1:02d}", simulated=True) as sitting:
            rows = []
            while (prompt := sitting.prompt) is not None:
                value = prompt.set_point if sitting.number % 5 else 1 + prompt.set_point % 25
                x, y, z = (0.05 * c for c in study.point(value).direction)
                sitting.procedure = sitting.procedure.record_answer(Answer(value, (x, y, z), 1.0))
                rows.append(
                    {
                        "session": sitting.id, "number": sitting.number, "prompt": json.dumps(prompt.row()),
                        "answer": value, "x": x, "y": y, "z": z, "seconds": 1.0, "safety": "[]", "recording": None,
                        "answered": "",
                    }
                )  # fmt: skip
                sitting.number += 1
            with engine.begin() as connection:  # all at once: writing them one by one is timed elsewhere
                connection.execute(trials.insert(), rows)


def measure(count: int) -> dict[str, float]:
    """Seconds for numbers and for the report, figures included, after one warm-up."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder, "s.db")
        fill_database(place, count)
        analysis = analysis_of(place)
        start = time.perf_counter()
        analysis = analysis_of(place)
        numbers = time.perf_counter() - start
        write_report(analysis, Path(folder, "report"))
        return {"trials": analysis.trials, "numbers_s": numbers, "with_report_s": time.perf_counter() - start}


def main() -> None:
    """Measure, and print for people or machines."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=300)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = measure(options.trials)
    if options.json:
        print(json.dumps(found))
    else:
        print(
            f"{found['trials']} trials: numbers {found['numbers_s']:.2f} s, with report {found['with_report_s']:.2f} s"
        )


if __name__ == "__main__":
    main()
