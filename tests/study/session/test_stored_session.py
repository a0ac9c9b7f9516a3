"""Answers are durable one by one, resumed after kill -9, and protected against two writers."""

from __future__ import annotations

import importlib.util
import json
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sqlalchemy import Connection, inspect

from haptorb.errors import InputError, RecordingError
from haptorb_study import database as migrations
from haptorb_study.bids import write_bids
from haptorb_study.columns import COLUMNS, find_begun_version, read_replies, read_study, tidy
from haptorb_study.database import SCHEMA, database, list_participants, lock_session
from haptorb_study.export_table import write_csv
from haptorb_study.prompts import Answer
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import Study, study_of

HERE = (0.0, 0.0, 0.05)
ROOT = Path(__file__).resolve().parents[3]


def kill_sessions(folder: Path, kills: int, *, forked: bool = False) -> dict[str, Any]:
    """What benchmarks/safety/study_kill.py finds."""
    spec = importlib.util.spec_from_file_location("study_kill", ROOT / "benchmarks" / "safety" / "study_kill.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.kill_workers(folder, kills, forked=forked)


def test_a_session_is_answered_to_its_end_and_read_back(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    with StoredSession(engine, identify, "P01") as session:
        assert f"of P01, study '{identify.name}': 0 trials answered" in repr(session)
        while session.prompt is not None:
            session.answer(Answer(1, HERE, 1.5), safety=[{"code": "OVERHEATED"}] if session.number == 2 else ())
        assert "everything is answered" in repr(session)
    columns = tidy(engine, read_study(engine))
    assert list(columns) == list(COLUMNS)
    assert columns["trial"].tolist() == list(range(1, 8))
    assert columns["safety"].tolist().count("OVERHEATED") == 1
    top = columns["set_point"] == 1
    assert columns["distance_mm"][top] == pytest.approx(0.0, abs=1e-9)
    # 36° apart on a sphere of 50 mm: a chord of 2 · 50 · sin 18°.
    assert columns["distance_mm"][~top] == pytest.approx(30.9017, abs=1e-3)
    assert columns["correct"].tolist() == [float(x) for x in top]


@pytest.mark.parametrize("key", ["parts", "pauses", "turns"])
@pytest.mark.parametrize("value", [None, 7, "x", [{}], {"x": 1}, {"9" * 5000: 1}])
def test_a_plan_of_a_stranger_is_refused_in_words(identify: Study, tmp_path: Path, key: str, value: object) -> None:
    """And the session is free again for whoever mends it."""
    engine = database(tmp_path / "s.db")
    with StoredSession(engine, identify, "P01"):
        pass
    with sqlite3.connect(tmp_path / "s.db") as raw:
        (plan,) = raw.execute("SELECT plan FROM sessions").fetchone()
        raw.execute("UPDATE sessions SET plan = ?", [json.dumps({"turns": [], **json.loads(plan), key: value})])
    raw.close()
    for _ in range(2):
        with pytest.raises(RecordingError, match=r"plan cannot be read|data were changed"):
            StoredSession(engine, identify, "P01")


def test_a_code_that_has_finished_is_refused(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    with StoredSession(engine, identify, "P01") as session:
        while session.prompt is not None:
            session.answer(Answer(1, HERE))
    with pytest.raises(RecordingError, match="another code"):
        StoredSession(engine, identify, "P01")


def test_an_aborted_session_keeps_its_answers_and_is_over(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    with StoredSession(engine, identify, "P01") as session:
        session.answer(Answer(1, HERE))
        session.abort("tired")
    with pytest.raises(RecordingError, match="aborted"):
        StoredSession(engine, identify, "P01")
    assert len(tidy(engine, identify)["trial"]) == 1


def test_names_are_no_codes(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    for code in ("Anna", "", "-01", "../P01", "P01; DROP TABLE trials", "P01\u202e", "P" * 16 + "1"):
        with pytest.raises(InputError, match="never a name"):
            StoredSession(engine, identify, code)


@pytest.mark.parametrize("typed", ["P01\n", " P01", "P 01", "P\u00a001", "Ｐ01", "P０１"])
def test_a_code_is_taken_as_typed_or_refused_with_what_to_enter(identify: Study, tmp_path: Path, typed: str) -> None:
    engine = database(tmp_path / "s.db")
    with pytest.raises(InputError, match="enter 'P01'"):
        StoredSession(engine, identify, typed)
    assert not list_participants(engine, identify)


@pytest.mark.parametrize("other", ["p01", "Р01", "PO1", "P0l", "P1", "Ρ01"])
def test_another_spelling_of_a_taken_code_is_no_other_person(identify: Study, tmp_path: Path, other: str) -> None:
    engine = database(tmp_path / "s.db")
    StoredSession(engine, identify, "P01").close()
    with pytest.raises(RecordingError, match="another spelling of 'P01'"):
        StoredSession(engine, identify, other)
    for free in ("P11", "P10", "vp-1", "PP01", "Q01"):
        StoredSession(engine, identify, free).close()


def test_codes_are_those_that_people_use(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    for code in ("P1", "anna01", "vp-7", "S_07.b", "Ä3", "被験者12"):
        StoredSession(engine, identify, code).close()
    StoredSession(engine, identify, "A\u03083").close()  # Ä in two characters is the same code
    assert [one.code for one in list_participants(engine, identify)] == [
        "P1",
        "anna01",
        "vp-7",
        "S_07.b",
        "Ä3",
        "被験者12",
    ]
    with pytest.raises(RecordingError, match=r"'p1' is another spelling of 'P1'"):
        StoredSession(engine, identify, "p1")
    with pytest.raises(RecordingError, match="reserved for simulated"):
        StoredSession(engine, identify, "SIM07")


def test_who_took_part_is_listed_with_what_became_of_them(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    for code, answers in (("P01", 7), ("P02", 2), ("P03", 1)):
        with StoredSession(engine, identify, code) as session:
            for _ in range(answers):
                session.answer(Answer(1, HERE))
            if code == "P03":
                session.abort()
    people = list_participants(engine, identify)
    assert [(one.code, one.state, one.answered) for one in people] == [
        ("P01", "finished", 7), ("P02", "open", 2), ("P03", "aborted", 1),
    ]  # fmt: skip


def test_simulated_and_real_do_not_share_a_code(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    StoredSession(engine, identify, "SIM01", simulated=True).close()
    for code, simulated in (("SIM01", False), ("S1M2", False), ("P01", True)):
        with pytest.raises(RecordingError, match="simulated"):
            StoredSession(engine, identify, code, simulated=simulated)


def test_two_experimenters_cannot_run_one_session(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    with StoredSession(engine, identify, "P01") as first:
        first.answer(Answer(1, HERE))
        with pytest.raises(RecordingError, match="another experimenter"):
            StoredSession(database(tmp_path / "s.db"), identify, "P01")
    with StoredSession(engine, identify, "P01") as second:
        assert second.number == 1


def test_a_refused_answer_leaves_nothing_behind(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    with StoredSession(engine, identify, "P01") as session:
        with pytest.raises(InputError, match="1 to 3"):
            session.answer(Answer(9, HERE))
        assert session.number == 0
    with pytest.raises(RecordingError, match="no answered trials"):
        tidy(engine, identify)


def test_a_trial_that_somebody_else_wrote_is_not_written_twice(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    with StoredSession(engine, identify, "P01") as session:
        lock, session._lock = session._lock, None  # as if the lock had failed
        lock.release()
        with StoredSession(engine, identify, "P01") as other:
            other.answer(Answer(1, HERE))
            with pytest.raises(RecordingError, match="already answered"):
                session.answer(Answer(2, HERE))
        session._lock = lock_session(engine, session.id)
    assert tidy(engine, identify)["answer"].tolist() == [1]


def test_changed_data_are_noticed_on_resuming(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    with StoredSession(engine, identify, "P01") as session:
        session.answer(Answer(1, HERE))
        session.answer(Answer(1, HERE))
    with sqlite3.connect(tmp_path / "s.db") as raw:
        raw.execute("DELETE FROM trials WHERE number = 0")
    raw.close()
    with pytest.raises(RecordingError, match="data were changed"):
        StoredSession(engine, identify, "P01")


def test_a_newer_schema_is_refused_and_left_alone(identify: Study, tmp_path: Path) -> None:
    database(tmp_path / "s.db").dispose()
    with sqlite3.connect(tmp_path / "s.db") as raw:
        raw.execute("UPDATE haptorb_schema SET version = ?", (SCHEMA + 1,))
    raw.close()
    with pytest.raises(RecordingError, match="update haptorb"):
        database(tmp_path / "s.db")


def test_databases_that_are_none_are_told(tmp_path: Path) -> None:
    (tmp_path / "text.db").write_text("this is no database, and long enough to look at" * 20)
    with pytest.raises(RecordingError, match="not a database"):
        database(tmp_path / "text.db")
    with pytest.raises(RecordingError, match="cannot be opened"):
        database(tmp_path / "no-such-folder" / "s.db")
    with pytest.raises(RecordingError, match="does not exist"):
        database(tmp_path / "none.db", make=False)
    with pytest.raises(RecordingError, match=r"is not a database|not installed"):
        database("nonsense://x/y")
    with sqlite3.connect(tmp_path / "other.db") as raw:
        raw.execute("CREATE TABLE cats (name TEXT)")
    raw.close()
    with pytest.raises(RecordingError, match="of another program"):
        database(tmp_path / "other.db")


def test_sqlite_writes_through(tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    with engine.connect() as connection:
        told = [connection.exec_driver_sql(f"PRAGMA {p}").scalar() for p in ("journal_mode", "synchronous")]
    assert told == ["wal", 2]


#: what was stored by the older version, to the letter
UNTOUCHED = (
    "SELECT digest, name, text FROM studies", "SELECT id, plan, started, versions FROM sessions",
    "SELECT number, prompt, answer, x, y, z, seconds, safety, recording, answered FROM trials WHERE number < 3",
)  # fmt: skip


def test_an_older_schema_is_brought_forward_and_its_session_goes_on(identify: Study, tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "s.db") as raw:
        raw.executescript((Path(__file__).parents[1] / "schema_1.sql").read_text(encoding="utf-8"))
    raw.close()
    with sqlite3.connect(tmp_path / "s.db") as raw:
        stored = [raw.execute(query).fetchall() for query in UNTOUCHED]
    raw.close()
    engine = database(tmp_path / "s.db")
    with sqlite3.connect(tmp_path / "s.db") as raw:
        assert raw.execute("SELECT version FROM haptorb_schema").fetchall() == [(SCHEMA,)]
    raw.close()
    begun = find_begun_version(engine, identify)
    assert begun.digest == "87432234ffc10fc3"
    with StoredSession(engine, begun, "P01") as session:
        assert (session.number, session.question) == (3, None)
        while session.prompt is not None:
            session.answer(Answer(1, HERE))
    assert tidy(engine, begun)["trial"].tolist() == list(range(1, 8))
    with sqlite3.connect(tmp_path / "s.db") as raw:
        assert [raw.execute(query).fetchall() for query in UNTOUCHED] == stored
    raw.close()


def test_migrated_and_new_tables_are_the_same(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "old.db") as raw:
        raw.executescript((Path(__file__).parents[1] / "schema_1.sql").read_text(encoding="utf-8"))
    raw.close()
    known = [inspect(database(tmp_path / name)) for name in ("old.db", "new.db")]
    names = [sorted(one.get_table_names()) for one in known]
    assert names[0] == names[1]
    for name in names[0]:
        one, two = ([(c["name"], str(c["type"]), c["nullable"]) for c in k.get_columns(name)] for k in known)
        assert one == two
        assert known[0].get_unique_constraints(name) == known[1].get_unique_constraints(name)


def test_a_step_that_fails_leaves_the_older_schema_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with sqlite3.connect(tmp_path / "s.db") as raw:
        raw.executescript((Path(__file__).parents[1] / "schema_1.sql").read_text(encoding="utf-8"))
        before = list(raw.iterdump())
    raw.close()

    whole = migrations.STEPS[1]

    def fail(connection: Connection) -> None:
        whole(connection)
        connection.exec_driver_sql("SELECT * FROM there_is_no_such_table")

    with monkeypatch.context() as changed:
        changed.setattr(migrations, "STEPS", {1: fail})
        with pytest.raises(RecordingError, match="there_is_no_such_table"):
            database(tmp_path / "s.db")
    with sqlite3.connect(tmp_path / "s.db") as raw:
        assert list(raw.iterdump()) == before
    raw.close()


QUESTIONS = """
name = "asked"
[set_points]
points = [{ number = 1, theta_deg = 0 }]
[trials]
repetitions = 1
[[questions]]
name = "hand"
text = "Which hand holds the pen?"
when = "before"
choices = ["left", "right"]
[[questions]]
name = "tired"
text = "How tired are you, 0 to 10?"
low = 0
high = 10
[[questions]]
name = "remarks"
text = "Anything else?"
"""


def test_questions_are_asked_before_and_after_and_kept(tmp_path: Path) -> None:
    study = study_of(QUESTIONS)
    engine = database(tmp_path / "s.db")
    with StoredSession(engine, study, "P01") as session:
        asked = session.question
        assert asked is not None
        assert asked.name == "hand"
        with pytest.raises(InputError, match="left, right"):
            session.reply(asked, "both")
        with pytest.raises(InputError, match="left, right"):
            session.reply(asked, " right ")
        session.reply(asked, "right")
        assert session.question is None
        session.answer(Answer(1, HERE))
        assert not session.over
    with StoredSession(engine, study, "P01") as session:  # cut off between trials and questions: goes on there
        asked = session.question
        assert asked is not None
        for wrong in ("11", "ten", "", "-1", "5.0"):
            with pytest.raises(InputError):
                session.reply(asked, wrong)
        session.reply(asked, "3")
        assert not session.over
        assert session.question is not None
        session.reply(session.question, "no")
        assert session.over
    assert read_replies(engine, study) == {"P01": {"hand": "right", "tired": "3", "remarks": "no"}}
    answered = read_replies(engine, study)
    *_, path = write_csv(study, tidy(engine, study), tmp_path / "q.csv", replies=answered)
    assert path.name == "q-questions.csv"
    assert path.read_text(encoding="utf-8").splitlines()[2] == 'P01,tired,"How tired are you, 0 to 10?",3'
    folder = write_bids(study, tidy(engine, study), tmp_path / "bids", replies=read_replies(engine, study))
    lines = (folder / "participants.tsv").read_text(encoding="utf-8").splitlines()
    assert [line.split("\t") for line in lines] == [
        ["participant_id", "code", "simulated", "simulated_device", "hand", "tired", "remarks"],
        ["sub-P01", "P01", "false", "n/a", "right", "3", "no"],
    ]
    assert "How tired" in (folder / "participants.json").read_text(encoding="utf-8")
    with pytest.raises(RecordingError, match="another code"):
        StoredSession(engine, study, "P01")


def test_simulated_participants_are_asked_nothing_in_words(tmp_path: Path) -> None:
    with StoredSession(database(tmp_path / "s.db"), study_of(QUESTIONS), "SIM01", simulated=True) as session:
        session.answer(Answer(1, HERE))
        assert session.over


def test_kill_9_loses_and_doubles_nothing(tmp_path: Path) -> None:
    found = kill_sessions(tmp_path, 10, forked=True)
    assert (found["kills"], found["lost"], found["doubled"]) == (10, 0, 0)
    assert found["in_the_middle"] > 0


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_200_times_kill_9_loses_and_doubles_nothing(tmp_path: Path) -> None:
    found = kill_sessions(tmp_path, 200)
    assert (found["kills"], found["lost"], found["doubled"]) == (200, 0, 0)
    assert found["resume_s_median"] < 5.0


def test_the_error_of_an_identification_is_that_of_the_place_named(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    far = (0.0, 0.05, 0.0)  # the pen rests on the rim at every answer
    with StoredSession(engine, identify, "P01") as session:
        while (prompt := session.prompt) is not None:
            right = session.number % 2 == 0
            other = next(n for n in prompt.numbers if n != prompt.set_point)
            session.answer(Answer(prompt.set_point if right else other, far, 1.5))
    columns = tidy(engine, read_study(engine))
    right = columns["correct"] == 1
    assert columns["distance_mm"][right] == pytest.approx(0.0, abs=1e-9)
    assert columns["angle_deg"][right] == pytest.approx(0.0, abs=1e-5)
    ways = {point.number: np.asarray(point.direction) for point in identify.points}
    pairs = zip(columns["set_point"][~right], columns["answer"][~right], strict=True)
    assert columns["distance_mm"][~right] == pytest.approx([50 * np.linalg.norm(ways[a] - ways[b]) for a, b in pairs])
    ways_asked = np.array([ways[n] for n in columns["set_point"]])
    assert columns["pen_distance_mm"] == pytest.approx(1e3 * np.linalg.norm(far - 0.05 * ways_asked, axis=1))


def test_a_session_of_a_thousand_trials_and_more_can_be_read_again(tmp_path: Path) -> None:
    study = study_of('name = "long"\n[trials]\nrepetitions = 60\n')  # 1500 trials
    engine = database(tmp_path / "s.db")
    with StoredSession(engine, study, "P01") as session:
        session.answer(Answer(1, HERE, 1.0))
    engine.dispose()
    with StoredSession(database(tmp_path / "s.db", make=False), study, "P01") as session:
        assert session.number == 1
