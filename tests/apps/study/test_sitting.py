"""Answers are kept: durable one by one, resumed after kill -9, refused where two would write one session."""

from __future__ import annotations

import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest

from haptorb.apps.study.claim import Claim
from haptorb.apps.study.columns import COLUMNS, studied, tidy
from haptorb.apps.study.database import SCHEMA, database
from haptorb.apps.study.prompt import Answer
from haptorb.apps.study.sitting import Sitting
from haptorb.apps.study.study_file import Study
from haptorb.errors import InputError, RecordingError

HERE = (0.0, 0.0, 0.05)

#: answers at once, and tells every answer only after it was kept
WORKER = """
import sys
from haptorb.apps.study.database import database
from haptorb.apps.study.prompt import Answer
from haptorb.apps.study.sitting import Sitting
from haptorb.apps.study.study_file import study_of
study = study_of('name = "killed"\\n[trials]\\nrepetitions = 40')
with Sitting(database(sys.argv[1]), study, "P01") as sitting:
    print("ready", sitting.number, flush=True)
    while sitting.prompt is not None:
        sitting.answer(Answer(sitting.prompt.set_point, (0.0, 0.0, 0.05), 1.0))
        print("kept", sitting.number - 1, flush=True)
print("done", flush=True)
"""


def test_a_session_is_answered_to_its_end_and_read_back(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    with Sitting(engine, identify, "P01") as sitting:
        while sitting.prompt is not None:
            sitting.answer(Answer(1, HERE, 1.5), safety=[{"code": "OVERHEATED"}] if sitting.number == 2 else ())
    columns = tidy(engine, studied(engine))
    assert list(columns) == list(COLUMNS)
    assert columns["trial"].tolist() == list(range(7))
    assert columns["safety"].tolist().count("OVERHEATED") == 1
    top = columns["set_point"] == 1
    assert columns["distance_mm"][top] == pytest.approx(0.0, abs=1e-9)
    # 36° apart on a sphere of 50 mm: a chord of 2 · 50 · sin 18°.
    assert columns["distance_mm"][~top] == pytest.approx(30.9017, abs=1e-3)
    assert columns["correct"].tolist() == [float(x) for x in top]


def test_a_code_that_has_finished_is_refused(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    with Sitting(engine, identify, "P01") as sitting:
        while sitting.prompt is not None:
            sitting.answer(Answer(1, HERE))
    with pytest.raises(RecordingError, match="another code"):
        Sitting(engine, identify, "P01")


def test_an_aborted_session_keeps_its_answers_and_is_over(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    with Sitting(engine, identify, "P01") as sitting:
        sitting.answer(Answer(1, HERE))
        sitting.abort("tired")
    with pytest.raises(RecordingError, match="aborted"):
        Sitting(engine, identify, "P01")
    assert len(tidy(engine, identify)["trial"]) == 1


def test_names_are_no_codes(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    for code in ("Anna", "anna01", "P1", "", "P01; DROP TABLE trials", "P01\n"):
        with pytest.raises(InputError, match="never a name"):
            Sitting(engine, identify, code)


def test_simulated_and_real_do_not_share_a_code(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    Sitting(engine, identify, "SIM01", simulated=True).close()
    with pytest.raises(RecordingError, match="simulated"):
        Sitting(engine, identify, "SIM01")


def test_two_experimenters_cannot_run_one_session(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    with Sitting(engine, identify, "P01") as first:
        first.answer(Answer(1, HERE))
        with pytest.raises(RecordingError, match="another experimenter"):
            Sitting(database(tmp_path / "s.db"), identify, "P01")
    with Sitting(engine, identify, "P01") as second:
        assert second.number == 1


def test_a_refused_answer_leaves_nothing_behind(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    with Sitting(engine, identify, "P01") as sitting:
        with pytest.raises(InputError, match="1 to 3"):
            sitting.answer(Answer(9, HERE))
        assert sitting.number == 0
    with pytest.raises(RecordingError, match="no answered trials"):
        tidy(engine, identify)


def test_a_trial_that_somebody_else_wrote_is_not_written_twice(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    with Sitting(engine, identify, "P01") as sitting:
        claim, sitting._claim = sitting._claim, None  # as if the lock had failed
        claim.release()
        with Sitting(engine, identify, "P01") as other:
            other.answer(Answer(1, HERE))
            with pytest.raises(RecordingError, match="answered before"):
                sitting.answer(Answer(2, HERE))
        sitting._claim = Claim(engine, sitting.id)
    assert tidy(engine, identify)["answer"].tolist() == [1]


def test_changed_data_are_noticed_on_resuming(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    with Sitting(engine, identify, "P01") as sitting:
        sitting.answer(Answer(1, HERE))
        sitting.answer(Answer(1, HERE))
    with sqlite3.connect(tmp_path / "s.db") as raw:
        raw.execute("DELETE FROM trials WHERE number = 0")
    raw.close()
    with pytest.raises(RecordingError, match="data were changed"):
        Sitting(engine, identify, "P01")


def test_a_newer_schema_is_refused_and_left_alone(identify: Study, tmp_path: Path) -> None:
    database(tmp_path / "s.db").dispose()
    with sqlite3.connect(tmp_path / "s.db") as raw:
        raw.execute("UPDATE haptorb_schema SET version = ?", (SCHEMA + 1,))
    raw.close()
    with pytest.raises(RecordingError, match="update haptorb"):
        database(tmp_path / "s.db")


def test_databases_that_are_none_are_told(tmp_path: Path) -> None:
    (tmp_path / "text.db").write_text("this is no database, and long enough to look at" * 20)
    with pytest.raises(RecordingError, match="cannot be opened"):
        database(tmp_path / "text.db")
    with pytest.raises(RecordingError, match="cannot be opened"):
        database(tmp_path / "no-such-folder" / "s.db")
    with pytest.raises(RecordingError, match="does not exist"):
        database(tmp_path / "none.db", make=False)
    with pytest.raises(RecordingError, match=r"names no database|not installed"):
        database("nonsense://x/y")
    with sqlite3.connect(tmp_path / "other.db") as raw:
        raw.execute("CREATE TABLE cats (name TEXT)")
    raw.close()
    with pytest.raises(RecordingError, match="other tables"):
        database(tmp_path / "other.db")


def test_sqlite_writes_through(tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    with engine.connect() as connection:
        told = [connection.exec_driver_sql(f"PRAGMA {p}").scalar() for p in ("journal_mode", "synchronous")]
    assert told == ["wal", 2]


def _kill(path: Path, kills: int) -> None:
    """Kill the worker `kills` times at random moments; every answer it said it kept is there, once."""
    worker, rng, kept = path / "worker.py", random.Random(4), 0
    worker.write_text(WORKER)
    for _ in range(kills):
        process = subprocess.Popen([sys.executable, str(worker), str(path / "s.db")], stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        first = process.stdout.readline().split()
        assert first[0] == "ready"
        assert int(first[1]) in (kept, kept + 1)  # the one after `kept` may have been kept and not yet told
        time.sleep(rng.uniform(0.0, 0.03))
        os.kill(process.pid, signal.SIGKILL)
        told = process.stdout.read().split("\n")
        process.wait()
        process.stdout.close()
        numbers = [int(line.split()[1]) for line in told[:-1] if line.startswith("kept")]
        kept = max([int(first[1]), *(n + 1 for n in numbers)])
    with sqlite3.connect(path / "s.db") as raw:
        numbers = [row[0] for row in raw.execute("SELECT number FROM trials ORDER BY number")]
        assert raw.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    raw.close()
    assert numbers == list(range(len(numbers)))
    assert len(numbers) in (kept, kept + 1)


def test_kill_9_loses_and_doubles_nothing(tmp_path: Path) -> None:
    _kill(tmp_path, 4)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_200_times_kill_9_loses_and_doubles_nothing(tmp_path: Path) -> None:
    _kill(tmp_path, 200)
