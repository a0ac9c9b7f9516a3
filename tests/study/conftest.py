"""Small studies with real coils and forces, and databases in a temporary folder."""

from __future__ import annotations

import pytest

from haptorb_study.study_file import Study, study_of

IDENTIFY = """
name = "identify"
[set_points]
points = [
  { number = 1, theta_deg = 0 }, { number = 2, theta_deg = 36, phi_deg = 0 },
  { number = 3, theta_deg = 36, phi_deg = 180 },
]
[trials]
repetitions = 2
practice = 1
seed = 7
"""

STAIRCASE = """
name = "stairs"
procedure = "staircase"
[levels]
reference = 1.2
least = 0.01
most = 1.0
start = 0.8
trials = 60
reversals = 10
"""


@pytest.fixture
def identify() -> Study:
    return study_of(IDENTIFY)


@pytest.fixture
def stairs() -> Study:
    return study_of(STAIRCASE)
