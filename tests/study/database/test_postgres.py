"""Two stations, one PostgreSQL: every trial of both is stored once, in order; errors of a server."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import text

from haptorb.errors import RecordingError
from haptorb_study.columns import tidy
from haptorb_study.database import SCHEMA, database
from haptorb_study.merge import merge_databases
from haptorb_study.prompts import Answer
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import Study, study_of
from haptorb_study.withdraw import withdraw
from oracles.postgres_server import explain_absence, start_postgres

pytestmark = [pytest.mark.realtime, pytest.mark.skipif(bool(explain_absence()), reason=explain_absence())]

STUDY = 'name = "two-stations"\n[trials]\nrepetitions = 4'  # 25 places, 4 times: 100 trials a session
EACH = 10  #: sessions at each station

#: one station: its own participants one after the other, every answer told after it was kept
STATION = """
import json, sys
from haptorb_study.database import database
from haptorb_study.procedures import Answer
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import study_of
url, first, each, text = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4]
engine, study = database(url), study_of(text)
for person in range(each):
    with StoredSession(engine, study, f"S{first + person:03d}") as sitting:
        kept = []
        while (prompt := sitting.prompt) is not None:
            value = 1 + (7 * sitting.number + person) % 25
            sitting.answer(Answer(value, (0.0, 0.0, 0.05), 1.0))
            kept.append(value)
        print(json.dumps([sitting.code, kept]), flush=True)
"""


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    with start_postgres() as place:
        yield place


@pytest.fixture
def fresh(url: str) -> str:
    """The server's database, emptied."""
    engine = database(url)
    with engine.begin() as connection:
        connection.execute(text("DROP SCHEMA public CASCADE"))
        connection.execute(text("CREATE SCHEMA public"))
    engine.dispose()
    return url


@pytest.mark.slow
def test_two_stations_2000_trials_consistent_ordered_none_lost(fresh: str, tmp_path: Path) -> None:
    program = tmp_path / "station.py"
    program.write_text(STATION)
    # Both at once, into a database without tables: who makes them, and who is the n-th participant, must not matter.
    stations = [
        subprocess.Popen(
            [sys.executable, str(program), fresh, str(first), str(EACH), STUDY], stdout=subprocess.PIPE, text=True
        )
        for first in (100, 200)
    ]
    told: dict[str, list[int]] = {}
    for station in stations:
        said, _ = station.communicate(timeout=200)
        assert station.returncode == 0
        told |= dict(json.loads(line) for line in said.splitlines())
    engine, study = database(fresh), study_of(STUDY)
    columns = tidy(engine, study)
    assert len(columns["trial"]) == 2 * EACH * 100 == 2000
    for code, kept in told.items():
        mine = columns["participant"] == code
        assert columns["trial"][mine].tolist() == list(range(1, 101))
        assert columns["answer"][mine].tolist() == kept
        assert columns["answered"][mine].tolist() == sorted(columns["answered"][mine].tolist())
        # 4 times every place, whatever the order was.
        assert sorted(columns["set_point"][mine].tolist()) == sorted([*range(1, 26)] * 4)
    with engine.connect() as connection:
        ordinals = connection.execute(text("SELECT ordinal FROM participants ORDER BY ordinal")).scalars().all()
        ended = connection.execute(text("SELECT count(*) FROM sessions WHERE ended IS NOT NULL")).scalar_one()
        plans = connection.execute(text("SELECT plan FROM sessions")).scalars().all()
    assert list(ordinals) == list(range(2 * EACH))
    assert ended == 2 * EACH
    assert len(set(plans)) == 2 * EACH  # nobody got somebody else's order
    # The stations really ran side by side, not one after the other.
    when = list(zip(columns["participant"].tolist(), columns["answered"].tolist(), strict=True))
    first, second = ([t for code, t in when if code.startswith(s)] for s in ("S1", "S2"))
    assert min(first) < max(second)
    assert min(second) < max(first)
    engine.dispose()


def test_two_experimenters_cannot_run_one_session(fresh: str, identify: Study) -> None:
    engine, other = database(fresh), database(fresh)
    with StoredSession(engine, identify, "P01") as first:
        first.answer(Answer(1, (0.0, 0.0, 0.05)))
        with pytest.raises(RecordingError, match="another experimenter"):
            StoredSession(other, identify, "P01")
    with StoredSession(other, identify, "P01") as second:
        assert second.number == 1
    engine.dispose()
    other.dispose()


def test_an_older_schema_is_brought_forward(fresh: str, identify: Study) -> None:
    engine = database(fresh)
    with StoredSession(engine, identify, "P01") as session:
        session.answer(Answer(1, (0.0, 0.0, 0.05)))
    with engine.begin() as connection:
        connection.execute(text("DROP TABLE replies, contents, withdrawn, copies"))
        connection.execute(text("ALTER TABLE trials DROP COLUMN driver"))
        connection.execute(text("ALTER TABLE trials ALTER COLUMN answer TYPE INTEGER"))
        connection.execute(text("UPDATE haptorb_schema SET version = 1"))
    engine.dispose()
    engine = database(fresh)
    with engine.connect() as connection:
        assert connection.execute(text("SELECT version FROM haptorb_schema")).scalar_one() == SCHEMA
        assert connection.execute(text("SELECT count(*) FROM replies")).scalar_one() == 0
    with StoredSession(engine, identify, "P01") as session:
        assert session.number == 1
    loud = study_of('name = "m"\nprocedure = "magnitude"\n[levels]\nreference = 1.0\nvalues = [1.0, 2.0]\n')
    with StoredSession(engine, loud, "P01") as session:
        session.answer(Answer(2.5))
    assert tidy(engine, loud)["answer"].tolist() == [2.5]
    assert tidy(engine, identify)["answer"].dtype.kind == "i"  # whole numbers stay whole
    engine.dispose()


def test_a_database_on_a_server_is_merged_and_who_withdraws_is_gone_from_both(
    fresh: str, identify: Study, tmp_path: Path
) -> None:
    here, merged = tmp_path / "here.db", tmp_path / "merged.db"
    for place, code in ((fresh, "P01"), (here, "P02")):
        engine = database(place)
        with StoredSession(engine, identify, code) as session:
            session.answer(Answer(1, (0.0, 0.0, 0.05)))
        engine.dispose()
    assert merge_databases([fresh, here], merged).trials == 2

    def codes(place: str | Path) -> list[str]:
        engine = database(place, make=False)
        with engine.connect() as connection:
            found = connection.execute(text("SELECT code FROM participants ORDER BY code")).scalars().all()
        engine.dispose()
        return list(found)

    assert codes(merged) == ["P01", "P02"]
    withdraw(fresh, "P01")
    assert "P01" not in codes(fresh)
    assert codes(merged) == ["P02"]
    engine = database(fresh)
    with pytest.raises(RecordingError, match="withdr"):
        StoredSession(engine, identify, "P01")
    engine.dispose()


def test_a_newer_schema_is_refused(fresh: str) -> None:
    engine = database(fresh)
    with engine.begin() as connection:
        connection.execute(text("UPDATE haptorb_schema SET version = 99"))
    engine.dispose()
    with pytest.raises(RecordingError, match="update haptorb"):
        database(fresh)


def test_a_password_is_not_shown_in_a_message() -> None:
    with pytest.raises(RecordingError, match="nothing was started") as told:
        database("postgresql://study:very-secret@127.0.0.1:9/nowhere")
    assert "very-secret" not in str(told.value)
