"""Kind of data in a database: only one; older databases, mixed ones, and commands that must not mix them."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest

from haptorb.cli import main
from haptorb.errors import RecordingError
from haptorb_study.analysis.analysis import analysis_of
from haptorb_study.columns import tidy
from haptorb_study.data_kind import read_contents
from haptorb_study.database import database
from haptorb_study.prompts import Answer
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import Study

HERE = (0.0, 0.0, 0.05)


def command(*words: str) -> int:
    """Exit code of `haptorb study WORDS`."""
    try:
        return main(["study", *words])
    except SystemExit as end:
        return int(end.code or 0)


def answer_all(session: StoredSession, right: bool, driver: str) -> None:
    while (prompt := session.prompt) is not None:
        session.answer(Answer(prompt.set_point if right else 1, HERE), driver=driver)


def mixed(place: Path, study: Study) -> Path:
    """A database of the schema before this one, with two people on a real device and two simulated participants."""
    engine = database(place)
    for code in ("P01", "P02"):
        with StoredSession(engine, study, code) as session:
            answer_all(session, right=False, driver="serial:/dev/ttyUSB0")
    with sqlite3.connect(place) as raw:
        raw.execute("DELETE FROM contents")
    for code in ("SIM01", "SIM02"):
        with StoredSession(engine, study, code, simulated=True) as session:
            answer_all(session, right=True, driver="sim")
    engine.dispose()
    with sqlite3.connect(place) as raw:
        raw.executescript("DROP TABLE contents; DROP TABLE withdrawn; DROP TABLE copies;")
        raw.execute("UPDATE haptorb_schema SET version = 4")
    raw.close()
    return place


@pytest.mark.parametrize("first", ["real", "pilot", "simulated"])
@pytest.mark.parametrize("then", ["real", "pilot", "simulated"])
def test_a_database_holds_one_kind(identify: Study, tmp_path: Path, first: str, then: str) -> None:
    engine = database(tmp_path / "s.db")
    codes = {"real": ("P01", "P02"), "pilot": ("P03", "P04"), "simulated": ("SIM01", "SIM02")}
    assert read_contents(engine) == ""
    StoredSession(engine, identify, codes[first][0], simulated=first == "simulated", pilot=first == "pilot").close()
    assert read_contents(engine) == first

    def begin() -> None:
        StoredSession(engine, identify, codes[then][1], simulated=then == "simulated", pilot=then == "pilot").close()

    if first == then:
        begin()
    else:
        with pytest.raises(RecordingError, match="--db"):
            begin()


def test_an_older_mixed_database_opens_whole_and_is_never_one_number(identify: Study, tmp_path: Path) -> None:
    place = mixed(tmp_path / "s.db", identify)
    engine = database(place)
    assert read_contents(engine) == "mixed"
    assert len(tidy(engine, identify)["trial"]) == 28  # nothing lost
    people, simulated = analysis_of(place), analysis_of(place, data="simulated")
    assert people.confusion is not None
    assert simulated.confusion is not None
    assert (people.participants, simulated.participants) == (2, 2)
    assert people.confusion.accuracy == pytest.approx(1 / 3)
    assert simulated.confusion.accuracy == 1.0
    assert "14 simulated trials (2 participants" in people.left_out
    with StoredSession(engine, identify, "P03"):
        pass  # a study that was begun goes on
    with pytest.raises(RecordingError, match="older haptorb"):
        StoredSession(engine, identify, "SIM03", simulated=True)


def test_the_commands_refuse_another_kind_and_say_what_to_do(
    identify: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("s.toml").write_text(identify.text)
    StoredSession(database("real.db"), identify, "P01").close()
    StoredSession(database("pilot.db"), identify, "P01", pilot=True).close()
    for words in (
        ["simulate", "s.toml", "--db", "real.db"],
        ["run", "s.toml", "--db", "real.db", "--terminal", "-p", "P02"],  # on the simulated device: a pilot
        ["run", "s.toml", "--db", "pilot.db", "--terminal", "-p", "P02", "--driver", "serial:/dev/nowhere"],
    ):
        assert command(*words) == 2
        assert "--db" in capsys.readouterr().err
    assert command("participants", "pilot.db") == 0
    assert "pilot data" in capsys.readouterr().out
