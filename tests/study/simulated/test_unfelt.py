"""Studies whose world renders nothing, or nothing different, at the set-points are detected in advance."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from haptorb.cli import main
from haptorb.errors import InputError
from haptorb_study.simulated.forecast import find_unfelt
from haptorb_study.study_file import study_of

WELL = """
from dataclasses import dataclass
import numpy as np
from haptorb.worlds import World
from haptorb.worlds.base import parameter

@dataclass(frozen=True)
class Well(World):
    summit: tuple = parameter((0.0, 0.0, 1.0), "1", -1, 1, "direction of the summit")
    force: float = parameter(0.2, "N", 0, 1, "outward, beyond the radius")
    radius: float = parameter(0.02, "m", 0, 1, "from the axis")

    def wrench(self, state):
        out = np.hypot(state.p[0], state.p[1]) > self.radius
        return np.append(out * self.force * state.p / np.linalg.norm(state.p), np.zeros(3))
"""
STAIRS = """
name = "stairs"
procedure = "{procedure}"
world = "well.py:Well"
[parameters]
radius = {radius}
[levels]
parameter = "{parameter}"
reference = 0.2
values = [0.1, 0.4]
least = 0.01
most = 0.2
start = 0.1
trials = 8
"""


@pytest.mark.parametrize(
    ("procedure", "radius", "parameter", "said"),
    [
        ("staircase", 0.02, "force", False),
        ("staircase", 0.9, "force", True),  # the tool never gets there
        ("bayesian", 0.9, "force", True),
        ("constant", 0.9, "force", True),
        ("bayesian", 0.02, "radius", True),  # all levels of it lie beyond the dome
    ],
)
def test_a_check_says_that_there_is_nothing_to_feel(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], procedure: str, radius: float, parameter: str, said: bool
) -> None:
    (tmp_path / "well.py").write_text(WELL)
    file = tmp_path / "s.toml"
    file.write_text(STAIRS.format(procedure=procedure, radius=radius, parameter=parameter))
    with pytest.raises(SystemExit) as ended:
        main(["study", "check", str(file), "--json"])
    (found,) = json.loads(capsys.readouterr().out)["unfelt"] or [None]
    assert (found is not None) == said
    assert ended.value.code == 1 or not said
    with pytest.raises(SystemExit):
        main(["study", "check", str(file)])
    output = capsys.readouterr()
    assert ("every answer is a guess" in " ".join((output.out + output.err).split())) == said


def test_every_force_is_felt_with_the_built_in_dome() -> None:
    places = "[set_points]\npoints = [{ number = 1, theta_deg = 0 }, { number = 2, theta_deg = 36 }]\n"
    assert find_unfelt(study_of(f'name = "x"\n{places}')) == ()
    assert find_unfelt(study_of('name = "x"\n' + places + "[parameters]\nmoment = 0\n")) != ()
    cut_off = '[levels]\nparameter = "cut_off_deg"\nreference = 40\nleast = 1\nmost = 10\nstart = 5\n'
    assert find_unfelt(study_of('name = "x"\nprocedure = "staircase"\n' + cut_off)) == ()


CONTROL = """
name = "sham"
procedure = "rating"
[trials]
repetitions = 1
[[conditions]]
name = "dome"
{0}
[[conditions]]
name = "sham"
parameters = {{ moment = 0 }}
{1}
"""


@pytest.mark.parametrize(
    ("dome", "sham", "found"),
    [
        ("", "", [("sham", False)]),
        ("", "no_force = true", []),
        ("no_force = true", "no_force = true", [("dome", True)]),  # it says so, and has a force
    ],
)
def test_a_control_condition_without_force_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], dome: str, sham: str, found: list[tuple[str, bool]]
) -> None:
    file = tmp_path / "s.toml"
    file.write_text(CONTROL.format(dome, sham))
    code: object = 0
    try:
        main(["study", "check", str(file), "--json"])
    except SystemExit as ended:
        code = ended.code
    unfelt = json.loads(capsys.readouterr().out)["unfelt"]
    assert [(one["condition"], one["no_force"]) for one in unfelt] == found
    assert (code in (0, None)) == (not found)


def test_only_a_control_condition_changes_the_digest_of_a_study() -> None:
    plain, said_no, said_yes = (
        study_of(CONTROL.format("", text)).digest for text in ("", "no_force = false", "no_force = true")
    )
    assert plain == said_no != said_yes
    with pytest.raises(InputError, match="no_force"):
        study_of(CONTROL.format("", "no_force = 1"))
