"""Complete benchmarks/study/study_coverage.py, nightly: 93 to 97 % coverage of a population's intervals.

The standard error of a share of 1000 studies is 0.7 %, which is allowed below and above.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
STATED = ("threshold", "slope", "accuracy", "mean_error")


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    program = [sys.executable, "benchmarks/study/study_coverage.py", "--studies", "1000", "--json"]
    done = subprocess.run(
        [*program, "--rows", "group", "corners"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    found = json.loads(done.stdout)["rows"]
    rows = [row for row in found if row["quantity"] in STATED]
    assert len(rows) == 9 * len(STATED)
    # Of the corners: few trials, shares near 100 %, and people whose shares have another distribution. Their least
    # coverage is 92.0 %, of people with normal logits at 0.95, and their greatest is 97.3 %: docs, Psychometrics.
    rows += [row for row in found if row["row"] == "corners"]
    limits = {"group": (0.923, 0.977), "corners": (0.91, 0.98)}
    off = {(row["quantity"], row["people"], row["between_people_sd"]): row["coverage"] for row in rows
           if not limits[row["row"]][0] <= row["coverage"] <= limits[row["row"]][1]}  # fmt: skip
    assert off == {}
