"""Companions of an export: units and levels of every column, and scripts that read it."""

from __future__ import annotations

import json
import re
import runpy
import shutil
import subprocess
from pathlib import Path

import pytest

from haptorb_study.bids import write_bids
from haptorb_study.columns import COLUMNS, Columns, tidy
from haptorb_study.data_dictionary import FLAGS, WORDS, describe_columns, describe_questions
from haptorb_study.database import database
from haptorb_study.export_scripts import make_r_script
from haptorb_study.export_table import write_csv, write_parquet
from haptorb_study.simulated.rehearsal import rehearse
from haptorb_study.study_file import Study, study_of

TWO = """
name = "two"
[set_points]
points = [{ number = 1, theta_deg = 0 }, { number = 2, theta_deg = 36 }]
[trials]
repetitions = 1
practice = 2
[[conditions]]
name = "strong"
[[conditions]]
name = "weak"
parameters = { moment = 0.3 }
[[questions]]
name = "hand"
text = "Which hand?"
choices = ["left", "right"]
"""
STAIRS = """
name = "s"
procedure = "staircase"
[levels]
reference = 1.2
least = 0.01
most = 1.0
start = 0.5
"""


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> tuple[Study, Columns]:
    study = study_of(TWO)
    engine = database(tmp_path_factory.mktemp("data") / "s.db")
    rehearse(engine, study, 2)
    return study, tidy(engine, study)


def test_every_column_has_its_unit_and_its_values_names() -> None:
    found = describe_columns(study_of(TWO))
    assert list(found) == list(COLUMNS)
    assert all(one["Description"] for one in found.values())
    # Whatever is called by its unit has that unit, and no description repeats it.
    for name, unit in {"x_m": "m", "distance_mm": "mm", "theta_deg": "deg", "seconds": "s"}.items():
        assert found[name]["Units"] == unit
        assert "[" not in found[name]["Description"]
    assert found["condition"]["Levels"] == {"strong": "parameters of the study file", "weak": "moment = 0.3"}
    assert found["set_point"]["Levels"]["2"] == "θ = 36 deg, φ = 0 deg"
    assert set(found["phase"]["Levels"]) == {"practice", "main"}
    stairs = describe_columns(study_of(STAIRS))
    assert stairs["level"]["Units"] == study_of(STAIRS).level_unit != ""
    assert set(stairs["answer"]["Levels"]) == {"1", "2"}
    assert describe_questions(study_of(TWO))["question"]["Levels"] == {"hand": "Which hand?"}
    assert {*FLAGS, *WORDS} <= set(COLUMNS)


@pytest.mark.parametrize("form", ["csv", "parquet", "bids"])
def test_the_python_script_reads_the_export(
    form: str, data: tuple[Study, Columns], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study, columns = data
    replies = {"SIM01": {"hand": "left"}}
    if form == "bids":
        folder = write_bids(study, columns, tmp_path / "out", replies=replies)
        script, described = folder / "code" / "read_trials.py", folder / "task-two_beh.json"
    else:
        write = write_csv if form == "csv" else write_parquet
        write(study, columns, tmp_path / f"t.{form}", replies=replies)
        end = ("", "") if form == "csv" else ("_parquet", "-parquet")
        script, described = tmp_path / f"read_t{end[0]}.py", tmp_path / f"t{end[1]}.json"
    names = runpy.run_path(str(script), run_name="__main__")
    told = capsys.readouterr().out
    assert "8 trials of 2 participants" in told
    assert "SIMULATED" in told
    trials = names["read_trials"](practice=True)
    assert len(trials) == 12
    assert list(trials.columns) == list(COLUMNS)
    assert list(trials["condition"].cat.categories) == ["strong", "weak"]
    assert trials["distance_mm"].to_numpy() == pytest.approx(columns["distance_mm"])
    assert trials["simulated"].tolist() == [True] * 12
    assert set(json.loads(described.read_text(encoding="utf-8"))) >= set(COLUMNS)


def test_the_r_script_reads_the_export(data: tuple[Study, Columns], tmp_path: Path) -> None:
    study, columns = data
    write_csv(study, columns, tmp_path / "t.csv")
    script = tmp_path / "read_t.R"
    text = script.read_text(encoding="utf-8")
    assert not re.search("@[A-Z]+@", text)
    # Without R: every bracket is closed, and every string ends on its line.
    code = re.sub(r'"(\\.|[^"\\\n])*"', '""', text)
    code = re.sub("#.*", "", code)
    assert code.count('"') % 2 == 0
    open_ones: list[str] = []
    for letter in code:
        if letter in "([{":
            open_ones.append(letter)
        elif letter in ")]}":
            assert open_ones.pop() + letter in ("()", "[]", "{}")
    assert not open_ones
    if (r := shutil.which("Rscript")) is None:
        pytest.skip("Rscript is not installed: brackets and strings of the script were checked, no more")
    found = subprocess.run([r, str(script)], capture_output=True, text=True, timeout=120, check=True).stdout
    assert "8 trials of 2 participants" in found
    assert "strong" in found


def test_names_with_quotes_do_not_leave_their_strings() -> None:
    script = make_r_script(study_of(TWO), 'a"b\\c.csv')
    assert '"a\\"b\\\\c.csv"' in script
