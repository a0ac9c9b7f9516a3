"""A simulated study killed with SIGKILL at random moments: lost and duplicated data, and time to resume.

    python benchmarks/safety/study_kill.py [--kills 200] [--json]

Exit code 1 if anything is lost, doubled or asked twice.

Every time another process goes on with the rehearsal where the database says it stood: staircases in three conditions
side by side, with practice and breaks, so that it must come to the same difference of the same track. It also answers a
question in words before the trials and one after them, and stops every fifth trial. It tells every answer only
after it was kept; whatever was told must be there afterwards, once. Here every process starts from nothing, so that
resuming is timed whole; tests let one that has imported everything fork instead (`forked`), which is killed just as
well.
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
import os, sys
from sqlalchemy import select, func
from haptorb_study.database import database, sessions
from haptorb_study.simulated.participant import Participant
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import study_of
study = study_of('name = "killed"\\nprocedure = "staircase"\\n'
    '[levels]\\nreference = 1.2\\nleast = 0.02\\nmost = 1.0\\nstart = 0.5\\ntrials = 40\\n'
    '[trials]\\npractice = 3\\nbreak_every = 7\\n[[conditions]]\\nname = "a"\\n[[conditions]]\\nname = "b"\\n'
    '[[conditions]]\\nname = "c"\\n[[questions]]\\nname = "hand"\\ntext = "Hand?"\\nwhen = "before"\\n'
    '[[questions]]\\nname = "remarks"\\ntext = "Remarks?"\\n')
def work(told):
    engine = database(sys.argv[1])
    with engine.connect() as connection:
        ended = connection.execute(select(func.count()).select_from(sessions).where(sessions.c.ended.is_not(None)))
        person = 1 + ended.scalar_one()
    while True:
        with StoredSession(engine, study, f"P{person:03d}", pilot=True) as sitting:
            somebody = Participant(study, (0, person))
            if sitting.prompt is not None:
                somebody.answer(sitting.prompt, sitting.number)  # loads the kernels; the same answer comes again below
                print("asked", sitting.id, sitting.number, file=told, flush=True)
            while not sitting.over:
                if (question := sitting.question) is not None:
                    print("asked", sitting.id, question.name, file=told, flush=True)
                    sitting.reply(question, f"words of {sitting.code}")
                    print("kept", sitting.id, question.name, file=told, flush=True)
                    continue
                if sitting.number % 5 == 4:
                    sitting.record_event("pause", "by the participant")
                    print("kept", sitting.id, f"stop-{len(sitting.history)}", file=told, flush=True)
                sitting.answer(somebody.answer(sitting.prompt, sitting.number), driver="sim")
                print("kept", sitting.id, sitting.number - 1, file=told, flush=True)
        person += 1
if len(sys.argv) == 2:
    work(sys.stdout)
engine = database(sys.argv[2])
with StoredSession(engine, study, "P001", pilot=True) as sitting:
    Participant(study, (0, 1)).answer(sitting.prompt, 0)
engine.dispose()
for place in map(str.strip, sys.stdin):  # a pipe of its own for each: no line of another's end is in it
    if not (child := os.fork()):
        work(open(place, "w"))
    print(child, flush=True)
    os.waitpid(child, 0)
"""


class StartedWorker:
    """A worker of its own: `kill` ends it and gives what it had told since its first line."""

    def __init__(self, worker: Path, database: Path) -> None:
        self._process = subprocess.Popen([sys.executable, str(worker), str(database)], stdout=subprocess.PIPE)
        assert self._process.stdout is not None
        self._output = self._process.stdout
        self.first = self._output.readline()

    def kill(self) -> bytes:
        """SIGKILL, and the rest."""
        os.kill(self._process.pid, signal.SIGKILL)
        rest = self._output.read()
        self._process.wait()
        self._output.close()
        return rest


class ForkedWorker:
    """The same, forked by a process that has imported everything."""

    def __init__(self, parent: subprocess.Popen[bytes], pipe: Path) -> None:
        assert parent.stdin is not None
        assert parent.stdout is not None
        os.mkfifo(pipe)
        parent.stdin.write(f"{pipe}\n".encode())
        parent.stdin.flush()
        self._pid = int(parent.stdout.readline())
        self._output = pipe.open("rb")
        self.first = self._output.readline()

    def kill(self) -> bytes:
        """SIGKILL, and the rest."""
        os.kill(self._pid, signal.SIGKILL)
        with self._output:
            return self._output.read()


def kill_workers(folder: Path, kills: int, seed: int = 4, *, forked: bool = False) -> dict[str, Any]:
    """Kill `kills` times; counts over all answers that were told as kept, and seconds from start to the next trial."""
    worker, draw = folder / "worker.py", random.Random(seed)
    worker.write_text(WORKER, encoding="utf-8")
    acknowledged: set[tuple[int, str]] = set()
    resumed: list[float] = []
    middle = repeated = 0
    parent = None
    if forked:
        command = [sys.executable, str(worker), str(folder / "s.db"), str(folder / "warm.db")]
        parent = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        for number in range(kills):
            start = time.perf_counter()
            if parent is None:
                one: StartedWorker | ForkedWorker = StartedWorker(worker, folder / "s.db")
            else:
                one = ForkedWorker(parent, folder / f"told-{number}")
            resumed.append(time.perf_counter() - start)
            time.sleep(draw.uniform(0.0, 0.5))
            # A line that the kill cut short tells nothing.
            for line in (one.first + one.kill()).decode().split("\n")[:-1]:
                kind, session, trial = line.split()
                what = (int(session), trial)
                if kind == "kept":
                    repeated += what in acknowledged
                    acknowledged.add(what)
                else:
                    repeated += what in acknowledged  # asked again although it was answered
                    middle += trial.isdecimal() and int(trial) > 0
    finally:
        if parent is not None:
            parent.kill()
            parent.communicate()
    with sqlite3.connect(folder / "s.db") as raw:
        rows = raw.execute("SELECT session, number FROM trials ORDER BY session, number").fetchall()
        words = raw.execute("SELECT session, question FROM replies").fetchall()
        stops = raw.execute("SELECT session, count(*) FROM events WHERE kind = 'pause' GROUP BY session").fetchall()
        whole = raw.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    raw.close()
    sessions: dict[int, list[int]] = {}
    for session, number in rows:
        sessions.setdefault(session, []).append(number)
    kept = [(session, str(what)) for session, what in (*rows, *words)]
    told = {what for what in acknowledged if not what[1].startswith("stop-")}
    stopped = acknowledged - told
    fewer = sum(max(0, sum(one == session for one, _ in stopped) - dict(stops).get(session, 0)) for session in sessions)
    gaps = sum(numbers != list(range(len(numbers))) for numbers in sessions.values())
    resumed.sort()
    return {
        "kills": kills, "answers_told": len(told), "answers_kept": len(kept), "stops_told": len(stopped),
        "sessions": len(sessions), "lost": len(told - set(kept)) + gaps + fewer + (not whole),
        "doubled": repeated + len(kept) - len(set(kept)),
        "in_the_middle": middle, "resume_s_median": resumed[len(resumed) // 2], "resume_s_max": resumed[-1],
    }  # fmt: skip


def main() -> None:
    """Kill, and print for people or machines."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = kill_workers(Path(folder), options.kills)
    if options.json:
        print(json.dumps(found))
    else:
        print(
            f"{found['kills']} kills, {found['answers_kept']} answers in {found['sessions']} sessions: {found['lost']} "
            f"lost, {found['doubled']} doubled; next trial asked after {found['resume_s_median']:.2f} s (at most "
            f"{found['resume_s_max']:.2f} s)"
        )
    if found["lost"] or found["doubled"]:
        sys.exit(1)


if __name__ == "__main__":
    main()
