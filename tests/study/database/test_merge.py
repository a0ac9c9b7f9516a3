"""Merged databases and withdrawals: verified with plain SQL and by the bytes on disk."""

from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path

import pytest

from haptorb.cli import main
from haptorb.errors import InputError, RecordingError
from haptorb_study.database import database
from haptorb_study.database_copies import back_up, record_copy
from haptorb_study.export import export_study
from haptorb_study.merge import Renaming, merge_databases
from haptorb_study.prompts import Answer
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import Study, study_of
from haptorb_study.withdraw import withdraw

HERE = (0.0, 0.0, 0.05)
SECRET = "my sister Josephine"  #: what must be nowhere after its author has withdrawn
STUDY = """
name = "two"
[set_points]
points = [{ number = 1, theta_deg = 0 }, { number = 2, theta_deg = 36 }]
[trials]
repetitions = 2
[[questions]]
name = "remarks"
text = "Remarks?"
when = "before"
"""


@pytest.fixture
def two() -> Study:
    return study_of(STUDY)


def command(*words: str) -> int:
    """Exit code of `haptorb study WORDS`."""
    try:
        return main(["study", *words])
    except SystemExit as end:
        return int(end.code or 0)


def fill(place: Path, study: Study, codes: list[str], *, pilot: bool = False, words: str = "none") -> Path:
    """A database with a session of each of `codes`, each with a recording of its own."""
    place.parent.mkdir(exist_ok=True)
    engine = database(place)
    for code in codes:
        with StoredSession(engine, study, code, pilot=pilot) as session:
            name = f"{study.name}-session-{session.id}-trial-1.mcap"
            (place.parent / name).write_bytes(f"{place.name} {code}".encode())
            if session.question is not None:
                session.reply(session.question, words)
            while (prompt := session.prompt) is not None:
                answer = Answer(prompt.set_point, HERE, 1.5)
                session.answer(answer, recording=f"{name}#t=0.000,{session.number + 1}.000", driver="i2c:1")
    engine.dispose()
    return place


def rows(place: Path) -> list[tuple[object, ...]]:
    """Every trial of every code, as it is stored."""
    with sqlite3.connect(place) as raw:
        found = raw.execute(
            "SELECT p.code, t.number, t.prompt, t.answer, t.seconds, t.answered, s.plan, s.started, r.reply "
            "FROM trials t JOIN sessions s ON t.session = s.id JOIN participants p ON s.participant = p.id "
            "LEFT JOIN replies r ON r.session = s.id ORDER BY p.code, t.number"
        ).fetchall()
    raw.close()
    return found


def on_disk(folder: Path, words: str) -> list[str]:
    """Files under `folder` in which `words` are, whatever they are."""
    return [str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file() and words.encode() in p.read_bytes()]


def test_nothing_is_lost_and_recordings_follow(two: Study, tmp_path: Path) -> None:
    a = fill(tmp_path / "a" / "a.db", two, ["P01", "P02"])
    b = fill(tmp_path / "b" / "b.db", two, ["Q01", "Q02", "Q03"])
    before = rows(a) + rows(b)
    (tmp_path / "c").mkdir()
    done = merge_databases([a, b], tmp_path / "c" / "c.db")
    assert rows(tmp_path / "c" / "c.db") == before
    assert (done.trials, done.recordings, done.missing) == (20, 5, ())
    with sqlite3.connect(tmp_path / "c" / "c.db") as raw:
        assert raw.execute("SELECT count(DISTINCT ordinal) FROM participants").fetchone() == (5,)
        query = "SELECT p.code, t.recording FROM trials t JOIN sessions s ON t.session = s.id JOIN participants p ON "
        for code, part in raw.execute(query + "s.participant = p.id"):
            assert (tmp_path / "c" / part.partition("#")[0]).read_text().endswith(code)
    raw.close()
    assert rows(a) + rows(b) == before
    with StoredSession(database(tmp_path / "c" / "c.db"), two, "P09") as session:
        assert session.number == 0  # the merged database goes on


def test_codes_that_clash_are_listed_and_can_be_renamed(two: Study, tmp_path: Path) -> None:
    a, b = fill(tmp_path / "a.db", two, ["P01", "P02"]), fill(tmp_path / "b" / "b.db", two, ["p1", "P02", "P03"])
    with pytest.raises(InputError, match=r"2 codes clash.*P01 \(1\), p1 \(2\); P02 \(1\), P02 \(2\)"):
        merge_databases([a, b], tmp_path / "c.db")
    assert not (tmp_path / "c.db").exists()
    with pytest.raises(InputError, match="no such code"):
        merge_databases([a, b], tmp_path / "c.db", renamings=[Renaming(2, "*", "B-*"), Renaming(2, "P77", "Q77")])
    merge_databases([a, b], tmp_path / "c.db", renamings=[Renaming(2, "*", "B-*"), Renaming(2, "P03", "P03")])
    assert {row[0] for row in rows(tmp_path / "c.db")} == {"P01", "P02", "B-p1", "B-P02", "P03"}
    assert not list(tmp_path.glob(".merge-*"))


def test_different_studies_versions_and_kinds_are_never_merged(two: Study, tmp_path: Path) -> None:
    a = fill(tmp_path / "a.db", two, ["P01"])
    version = fill(tmp_path / "v" / "v.db", study_of(STUDY.replace("repetitions = 2", "repetitions = 1")), ["Q01"])
    other = fill(tmp_path / "o" / "o.db", study_of(STUDY.replace('"two"', '"three"')), ["Q01"])
    pilot = fill(tmp_path / "p" / "p.db", two, ["Q01"], pilot=True)
    for source, words in ((version, "differs in trials"), (other, "different studies"), (pilot, "never merged")):
        with pytest.raises(InputError, match=words):
            merge_databases([a, source], tmp_path / "c.db")
    with pytest.raises(InputError, match="twice"):
        merge_databases([a, tmp_path / "v" / ".." / "a.db"], tmp_path / "c.db")
    with pytest.raises(RecordingError, match="exists"):
        merge_databases([a, fill(tmp_path / "b" / "b.db", two, ["Q01"])], a)
    with StoredSession(database(tmp_path / "b" / "b.db"), two, "Q02"), pytest.raises(RecordingError, match="being run"):
        merge_databases([a, tmp_path / "b" / "b.db"], tmp_path / "c.db")
    assert not (tmp_path / "c.db").exists()


def test_a_merge_that_fails_leaves_nothing(two: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    a, b = fill(tmp_path / "a.db", two, ["P01"]), fill(tmp_path / "b" / "b.db", two, ["Q01"])
    before = sorted(tmp_path.rglob("*"))
    calls = []

    def fail(done: int, total: int) -> None:
        calls.append(done)
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        merge_databases([a, b], tmp_path / "c.db", progress=fail)
    assert calls == [1, 2]
    assert sorted(p for p in tmp_path.rglob("*") if not p.name.endswith(("-wal", "-shm"))) == [
        p for p in before if not p.name.endswith(("-wal", "-shm"))
    ]


def test_who_withdraws_is_gone_from_database_exports_merges_and_backups(two: Study, tmp_path: Path) -> None:
    a = fill(tmp_path / "a" / "a.db", two, ["P01", "P02"])
    b = fill(tmp_path / "b" / "b.db", two, ["P01"], words=SECRET)
    merge_databases([a, b], tmp_path / "c.db", renamings=[Renaming(2, "P01", "Q01")])
    back_up(tmp_path / "c.db", tmp_path / "c-backup.db")
    engine = database(tmp_path / "c.db")
    for name in ("t.csv", "bids"):
        export_study(engine, tmp_path / name)
        record_copy(engine, "export", tmp_path / name, "two", {"data": None})
    engine.dispose()
    recordings = {p.read_text() for p in tmp_path.rglob("*.mcap")}
    assert "b.db P01" in recordings
    assert len(on_disk(tmp_path, SECRET)) >= 5
    done = withdraw(tmp_path / "c.db", "Q01")
    assert (done.trials, done.replies, done.left) == (4, 1, ())
    assert not on_disk(tmp_path, SECRET)
    assert {p.read_text() for p in tmp_path.rglob("*.mcap")} == {"a.db P01", "a.db P02"}  # the other P01 stays
    assert {row[0] for row in rows(tmp_path / "c.db")} == {"P01", "P02"}
    assert {row[0] for row in rows(a)} == {"P01", "P02"}
    assert not rows(b)
    assert not (tmp_path / "bids" / "sub-Q01").exists()
    assert not on_disk(tmp_path / "bids", "Q01")
    for place, code in ((tmp_path / "c.db", "q01"), (tmp_path / "c.db", "Q1"), (b, "P01")):
        with pytest.raises(RecordingError, match="was withdrawn"):
            StoredSession(database(place), two, code)
    with sqlite3.connect(tmp_path / "c.db") as raw:
        (line,) = raw.execute("SELECT code, text FROM withdrawn").fetchall()
    raw.close()
    assert line[0] == "Q01"
    assert "4 trials" in line[1]
    assert withdraw(tmp_path / "c.db", "Q01").trials == 0  # again: copies are looked for, nothing else


def test_what_cannot_be_reached_is_named_and_a_running_session_stays(two: Study, tmp_path: Path) -> None:
    place = fill(tmp_path / "a.db", two, ["P01", "P02"])
    engine = database(place)
    export_study(engine, tmp_path / "t.csv")
    record_copy(engine, "export", tmp_path / "t.csv", "two")
    engine.dispose()
    (tmp_path / "t.csv").unlink()
    shutil.move(tmp_path / "two-session-1-trial-1.mcap", tmp_path / "moved.mcap")
    with pytest.raises(RecordingError, match="is 'P01' meant"):
        withdraw(place, "p01")
    done = withdraw(place, "P01")
    assert len(done.left) == 2
    assert any("t.csv" in one for one in done.left)
    with StoredSession(database(place), two, "P03"), pytest.raises(RecordingError, match="being run"):
        withdraw(place, "P03")
    assert {row[0] for row in rows(place)} == {"P02"}


def test_the_commands(
    two: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    fill(tmp_path / "a.db", two, ["P01"])
    fill(tmp_path / "b" / "b.db", two, ["P01"])
    assert command("merge", "a.db", "b/b.db", "--into", "c.db") == 2
    assert "--rename" in capsys.readouterr().err
    assert command("merge", "a.db", "b/b.db", "--into", "c.db", "--rename", "2:*=B-*") == 0
    assert "8 trials, 2 recordings" in capsys.readouterr().out
    assert command("backup", "c.db", "kept.db") == 0
    assert command("withdraw", "c.db", "B-P01", "--yes") == 0
    assert "removed from 2 other databases" in capsys.readouterr().out
    assert command("participants", "c.db") == 0
    assert "withdrawn" in capsys.readouterr().out
