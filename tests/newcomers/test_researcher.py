"""First hour of an HCI researcher at the shell: her own world run and checked, and a study rehearsed and analysed."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

import haptorb
from newcomers.newcomer_shell import NewcomerShell

pytestmark = pytest.mark.realtime

HILL = '''
from dataclasses import dataclass

import numpy as np

from haptorb.worlds import World
from haptorb.worlds.base import parameter


@dataclass(frozen=True)
class Hill(World):
    """A round hill: it pushes outwards, less the farther from its summit."""

    summit: tuple[float, float, float] = parameter((0.0, 0.0, 1.0), "1", -1, 1, "direction of the summit")
    push: float = parameter(0.2, "N", 0, 1, "at the summit")
    width: float = parameter(0.3, "rad", 0.1, 1, "angle at which 60 % are left")

    def wrench(self, state):
        outward = state.p / np.linalg.norm(state.p)
        summit = np.array(self.summit) / np.linalg.norm(self.summit)
        angle = np.arccos(np.clip(outward @ summit, -1.0, 1.0))
        force = self.push * np.exp(-0.5 * (angle / self.width) ** 2) * outward
        return np.append(force, np.zeros(3))
'''
STUDY = """
name = "hills"
procedure = "identification"
world = "hill.py:Hill"
instructions = "Find the place that pushes hardest, then answer with its number."

[set_points]
points = [
  { number = 1, theta_deg = 0 },
  { number = 2, theta_deg = 36, phi_deg = 0 },
  { number = 3, theta_deg = 36, phi_deg = 180 },
]

[trials]
repetitions = 1
seed = 1

[[conditions]]
name = "strong"

[[conditions]]
name = "weak"
parameters = { push = 0.1 }
"""
PEOPLE, TRIALS = 3, 3 * 2  #: simulated participants; set-points times conditions


@pytest.fixture
def shell(tmp_path: Path) -> NewcomerShell:
    (tmp_path / "hill.py").write_text(HILL)
    (tmp_path / "hills.toml").write_text(STUDY)
    return NewcomerShell(tmp_path)


@pytest.mark.slow
def test_she_runs_and_checks_her_world(shell: NewcomerShell) -> None:
    line = "haptorb run --world hill.py:Hill --set push='150 mN' --headless --duration 0.5 --record hill.mcap --json"
    report = json.loads(shell.run(line).stdout)
    assert report["world"] == "hill"
    assert report["world_values"]["push"] == pytest.approx(0.15)
    assert report["trips"] == []
    recording = haptorb.Recording(shell.folder / "hill.mcap")
    assert not recording["duty_applied"][-1].any(), "the coils are off at the end"
    assert "hill" in recording.worlds[0]["world"]
    assert abs(recording["wrench_commanded"]).max() > 0.01
    verdict = json.loads(shell.run("haptorb check --world hill.py:Hill --json").stdout)
    assert verdict["world"] == "hill.py:Hill"
    assert shell.list_running() == []


@pytest.mark.slow
def test_her_mistakes_are_told_before_anything_starts(shell: NewcomerShell) -> None:
    said = shell.run("haptorb run --world hill.py:Hil --headless", code=2).stderr
    assert "did you mean 'Hill'" in said
    said = shell.run("haptorb run --world hill.py --set push='3 kg' --headless", code=2).stderr
    assert "push" in said
    (shell.folder / "hill.py").write_text(HILL.replace("return np.append(force, np.zeros(3))", "return force"))
    said = shell.run("haptorb run --world hill.py:Hill --headless", code=2).stderr
    assert "wrench must return an array of shape (6,)" in said
    assert "hill.py" in said
    (shell.folder / "hills.toml").write_text(STUDY.replace("hill.py:Hill", "hil.py:Hill"))
    said = shell.run("haptorb study check hills.toml", code=2).stderr
    assert "hil.py" in said
    assert shell.list_running() == []


@pytest.mark.slow
def test_she_rehearses_a_study_with_her_world_and_reads_its_results(shell: NewcomerShell) -> None:
    assert "about 1 min" in shell.run("haptorb study check hills.toml").stderr
    shell.run(f"haptorb study simulate hills.toml --db hills.db --participants {PEOPLE}")
    shell.run("haptorb study analyse hills.db --out report")
    page = (shell.folder / "report" / "report.html").read_text(encoding="utf-8")
    assert "SIMULATED" in page
    shell.run("haptorb study export hills.db trials.csv")
    with (shell.folder / "trials.csv").open(encoding="utf-8", newline="") as file:
        trials = list(csv.DictReader(file))
    assert len([trial for trial in trials if trial["phase"] == "main"]) == PEOPLE * TRIALS
    assert {trial["condition"] for trial in trials} == {"strong", "weak"}
    assert all(trial["answer"] for trial in trials if trial["phase"] == "main")
