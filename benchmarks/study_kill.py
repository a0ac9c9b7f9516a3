"""A simulated study killed with SIGKILL at random moments: what is lost, what is doubled, and how long resuming takes.

    python benchmarks/study_kill.py [--kills 200] [--json]

Every time a fresh process goes on with the rehearsal where the database says it stood. It tells every answer only after
it was kept; whatever was told must be there afterwards, once.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

#: goes on with the simulated study in argv[1] until it is killed; every line is written after the answer was kept
WORKER = """
import sys
from sqlalchemy import select, func
from haptorb.apps.study.database import database, sessions
from haptorb.apps.study.participant import Participant
from haptorb.apps.study.sitting import Sitting
from haptorb.apps.study.study_file import study_of
points = ", ".join(f"{{ number = {n}, theta_deg = {9 * n} }}" for n in range(1, 6))
study = study_of(f'name = "killed"\\n[set_points]\\npoints = [{points}]\\n[trials]\\nrepetitions = 10')
engine = database(sys.argv[1])
with engine.connect() as connection:
    ended = connection.execute(select(func.count()).select_from(sessions).where(sessions.c.ended.is_not(None)))
    person = 1 + ended.scalar_one()
while True:
    with Sitting(engine, study, f"SIM{person:03d}", simulated=True) as sitting:
        somebody = Participant(study, (0, person))
        somebody.answer(sitting.prompt, sitting.number)  # loads the kernels; the same answer comes again below
        print("asked", sitting.id, sitting.number, flush=True)
        while (prompt := sitting.prompt) is not None:
            sitting.answer(somebody.answer(prompt, sitting.number))
            print("kept", sitting.id, sitting.number - 1, flush=True)
    person += 1
"""


def killed(folder: Path, kills: int, seed: int = 4) -> dict[str, Any]:
    """Kill `kills` times; counts over all answers that were told as kept, and seconds from start to the next trial."""
    worker, draw = folder / "worker.py", random.Random(seed)
    worker.write_text(WORKER, encoding="utf-8")
    told: set[tuple[int, int]] = set()
    resumed: list[float] = []
    middle = repeated = 0
    for _ in range(kills):
        start = time.perf_counter()
        process = subprocess.Popen([sys.executable, str(worker), str(folder / "s.db")], stdout=subprocess.PIPE)
        assert process.stdout is not None
        first = process.stdout.readline().decode()
        resumed.append(time.perf_counter() - start)
        time.sleep(draw.uniform(0.0, 0.5))
        os.kill(process.pid, signal.SIGKILL)
        rest = process.stdout.read().decode()
        process.wait()
        process.stdout.close()
        # A line that the kill cut short tells nothing.
        for line in (first + rest).split("\n")[:-1]:
            kind, session, number = line.split()
            what = (int(session), int(number))
            if kind == "kept":
                repeated += what in told
                told.add(what)
            else:
                repeated += what in told  # asked again although it was answered
                middle += int(number) > 0
    with sqlite3.connect(folder / "s.db") as raw:
        rows = raw.execute("SELECT session, number FROM trials ORDER BY session, number").fetchall()
        whole = raw.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    raw.close()
    sessions: dict[int, list[int]] = {}
    for session, number in rows:
        sessions.setdefault(session, []).append(number)
    gaps = sum(numbers != list(range(len(numbers))) for numbers in sessions.values())
    resumed.sort()
    return {
        "kills": kills, "answers_told": len(told), "answers_kept": len(rows), "sessions": len(sessions),
        "lost": len(told - set(rows)) + gaps + (not whole), "doubled": repeated + len(rows) - len(set(rows)),
        "in_the_middle": middle, "resume_s_median": resumed[len(resumed) // 2], "resume_s_max": resumed[-1],
    }  # fmt: skip


def main() -> None:
    """Kill, and print for people or machines."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = killed(Path(folder), options.kills)
    if options.json:
        print(json.dumps(found))
    else:
        print(
            f"{found['kills']} kills, {found['answers_kept']} answers in {found['sessions']} sessions: {found['lost']} "
            f"lost, {found['doubled']} doubled; next trial asked after {found['resume_s_median']:.2f} s (at most "
            f"{found['resume_s_max']:.2f} s)"
        )


if __name__ == "__main__":
    main()
