"""`haptorb study new`: every template is checked, rehearsed and analysed; nothing is overwritten."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from haptorb.cli import main
from haptorb.devices.schema import list_keys
from haptorb.errors import InputError, RecordingError
from haptorb_study.analysis.analysis import analysis_of
from haptorb_study.analysis.report import page
from haptorb_study.analysis.tables import print_summary
from haptorb_study.database import database
from haptorb_study.simulated.forecast import forecast
from haptorb_study.simulated.rehearsal import rehearse
from haptorb_study.study_file import read_study, study_of
from haptorb_study.template import TEMPLATES, make_study_text, write_study


def run_new(*words: str) -> int:
    try:
        return main(["study", "new", *words])
    except SystemExit as end:
        return int(end.code or 0)


@pytest.mark.parametrize("like", TEMPLATES)
def test_every_key_of_a_template_is_explained_in_the_words_of_the_schema(like: str) -> None:
    text = make_study_text("mine", like)
    assert study_of(text).name == "mine"
    keys = list_keys(type(study_of(text)))
    meanings = [(key.path.rpartition(".")[2], key.meaning) for key in keys]
    lines = text.splitlines()
    assert all(len(line) <= 100 for line in lines if line.startswith("# ") and lines.index(line) > 3)
    comments = " ".join(line.removeprefix("#").strip() for line in lines if line.startswith("#"))
    for key in re.findall(r"^([a-z_]+) = ", text, re.MULTILINE):
        known = [meaning for name, meaning in meanings if name == key]
        assert not known or any(meaning in comments for meaning in known), key


@pytest.mark.parametrize("like", TEMPLATES)
def test_every_template_is_checked_rehearsed_and_analysed(like: str, tmp_path: Path) -> None:
    # Fewer trials than the template has: what it asks is all the same.
    text = re.sub(r"^repetitions = \d+", "repetitions = 1", make_study_text("mine", like), flags=re.MULTILINE)
    text = re.sub(r"^trials = \d+", "trials = 12", text, flags=re.MULTILINE)
    study = study_of(re.sub(r"^reversals = \d+", "reversals = 4", text, flags=re.MULTILINE))
    assert forecast(study_of(text)).holds
    answered = rehearse(database(tmp_path / "s.db"), study, 2)
    done = analysis_of(tmp_path / "s.db")
    assert (done.participants, done.trials + done.practice) == (2, answered)
    assert done.practice == 2 * study.trials.practice
    assert done.times
    print_summary(done)
    assert "Response times" in page(done)
    found = done.numbers()
    wanted = {"staircase": "thresholds", "magnitude": "magnitudes", "comparison": "choices"}.get(like, "accuracy")
    assert wanted in found


def test_new_says_what_is_next_and_overwrites_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_new("mine", "--like", "staircase") == 0
    assert "haptorb study check mine.toml" in capsys.readouterr().out
    assert read_study("mine.toml").procedure == "staircase"
    before = Path("mine.toml").read_text()
    assert run_new("mine") == 2
    assert "--force" in capsys.readouterr().err
    assert Path("mine.toml").read_text() == before
    assert run_new("mine", "--force") == 0
    assert read_study("mine.toml").procedure == "identification"
    assert run_new("mine.toml", "--force") == 0
    assert read_study("mine.toml").name == "mine"
    for words in (
        ("../mine",),
        (".toml",),
        ("a b",),
        ('x"\n[rating]\nlow = 1\n#',),
        ("mine2", "--like", "stairs"),
        ("",),
    ):
        assert run_new(*words) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["mine.toml"]
    with pytest.raises(RecordingError, match="overwrite=True"):
        write_study("mine")
    with pytest.raises(InputError, match="did you mean 'staircase'"):
        make_study_text("x", "stairs")
