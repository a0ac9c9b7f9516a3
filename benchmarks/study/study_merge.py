"""Time of `haptorb study merge` for two databases of 30 people each, 120 trials and a recording per person.

    python benchmarks/study/study_merge.py [--people 30] [--trials 120] [--megabytes 1] [--limit 5] [--json]

The whole command is timed, as a process of its own that starts Python. Nothing may be lost: the merged database is read
with plain SQL, and the recordings are compared byte for byte. Exit code 1 if something is lost or the limit [s] is
exceeded. The answers are made up; only their number matters.
"""

from __future__ import annotations

import argparse
import json
import os
import sqlite3
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path
from typing import Any

from haptorb_study.database import database, trials
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import study_of

STUDY = 'name = "merged"\n[trials]\nrepetitions = {}\n[[questions]]\nname = "hand"\ntext = "Hand?"\nwhen = "before"\n'
ROWS = "SELECT p.code, t.number, t.prompt, t.answer, t.x, t.seconds FROM trials t JOIN sessions s ON t.session = s.id "
ROWS += "JOIN participants p ON s.participant = p.id ORDER BY p.code, t.number"


def fill_database(place: Path, letter: str, people: int, each: int, size: int) -> None:
    """A database of `people` with `each` answered trials, a reply and a recording of `size` bytes."""
    study = study_of(STUDY.format(-(-each // 25)))
    engine = database(place)
    place.parent.mkdir(exist_ok=True)
    for person in range(people):
        with StoredSession(engine, study, f"{letter}{person + 1:02d}") as session:
            assert session.question is not None
            session.reply(session.question, f"right, {letter}{person}")
            recording = f"merged-session-{session.id}-trial-1.mcap"
            (place.parent / recording).write_bytes(os.urandom(size))
            listed = [prompt for part in session.procedure.parts for prompt in part.prompts][:each]  # type: ignore[attr-defined]
            with engine.begin() as connection:
                connection.execute(trials.insert(), [{
                    "session": session.id, "number": number, "prompt": json.dumps(prompt.row()),
                    "answer": 1 + number % 25, "x": 0.001 * number, "y": 0.0, "z": 0.05, "seconds": 1.5 + person,
                    "safety": "[]", "recording": f"{recording}#t={number},{number + 1}", "driver": "serial:X",
                    "answered": "2026-01-01T00:00:00+00:00",
                } for number, prompt in enumerate(listed)])  # fmt: skip
    engine.dispose()


def read_rows(place: Path, query: str = ROWS) -> list[tuple[Any, ...]]:
    """What plain SQL finds."""
    with closing(sqlite3.connect(place)) as raw:
        return raw.execute(query).fetchall()


def measure(people: int, each: int, size: int) -> dict[str, Any]:
    """Seconds of the command, and what it lost."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        places = [folder / letter / "study.db" for letter in "AB"]
        for place in places:
            place.parent.mkdir()
            fill_database(place, place.parent.name, people, each, size)
        merged = folder / "C" / "merged.db"
        merged.parent.mkdir()
        command = [sys.executable, "-c", "import sys; from haptorb.cli import main; sys.exit(main())"]
        start, before = time.perf_counter(), os.times()
        subprocess.run(
            [*command, "study", "merge", *map(str, places), "--into", str(merged)], check=True, capture_output=True
        )
        seconds, after = time.perf_counter() - start, os.times()
        wanted = sorted(row for place in places for row in read_rows(place))
        replies = "SELECT reply FROM replies ORDER BY reply"
        words = sorted(row for place in places for row in read_rows(place, replies))
        copies = sorted(path.read_bytes() for path in merged.parent.glob("*.mcap"))
        originals = sorted(path.read_bytes() for place in places for path in place.parent.glob("*.mcap"))
        used = [now.children_user + now.children_system for now in (before, after)]
        return {
            "databases": 2, "people_each": people, "trials": len(wanted),
            "recordings_mb": sum(map(len, originals)) / 1e6, "seconds": seconds, "processor_seconds": used[1] - used[0],
            "lost": sorted(read_rows(merged)) != wanted or read_rows(merged, replies) != words or copies != originals,
        }  # fmt: skip


def main() -> None:
    """Measure, and print for people or machines."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--people", type=int, default=30)
    parser.add_argument("--trials", type=int, default=120, help="of each person")
    parser.add_argument("--megabytes", type=float, default=1.0, help="recording of each person [MB]")
    parser.add_argument("--limit", type=float, default=5.0, help="[s]")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = measure(options.people, options.trials, int(1e6 * options.megabytes))
    found["limit_s"] = options.limit
    if options.json:
        print(json.dumps(found, indent=1))
    else:
        print(
            f"two databases of {options.people} people, {found['trials']} trials, {found['recordings_mb']:.0f} MB of "
            f"recordings: {found['seconds']:.2f} s ({found['processor_seconds']:.2f} s of processor time), "
            f"{found['seconds'] / options.limit:.2f} of the limit; {'ROWS LOST' if found['lost'] else 'nothing lost'}"
        )
    if found["lost"] or found["seconds"] > options.limit:
        sys.exit(1)


if __name__ == "__main__":
    main()
