"""Time from a page's Stop to coils off, in every state of a study, while another process locks the database.

    python benchmarks/safety/study_stop.py [--repetitions 6] [--lock 30] [--json]

Runs the study's server on the simulated device, with three pages: the participant's, a second participant's (it may
only watch) and the experimenter's. In every state another process takes an exclusive lock on the database; where the
state has something to be kept, the thread of the sessions is sent into that lock first. Then every page stops, each
being the first in its turn. told: from just before the message is sent until the servo's `stop` has returned. off: from
the same moment until the loop has published a row with the guard off and every duty zero, and one row more. The first
repetition in each state holds the lock for all of `--lock` seconds. The coils must stay off until somebody resumes, and
every Stop must be on record once the database is free. Exit code 1 if anything took longer than 20 ms or came on.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from sqlalchemy import text
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from haptorb.control.trip_reasons import GuardState
from haptorb.runtime.servo import Servo
from haptorb_study.database import database
from haptorb_study.pages.session_manager import SessionManager
from haptorb_study.pages.study_server import StudyServer
from haptorb_study.study_file import Study, study_of

LIMIT = 20.0  #: [ms]
STATES = ("starting", "consent", "question", "running", "time is up", "pause", "break", "paused")
OFF = (GuardState.OFF, GuardState.TRIPPED)
#: takes and gives back an exclusive lock on the database in argv[1], a line of input each
LOCKER = """
import sqlite3, sys
raw = sqlite3.connect(sys.argv[1], isolation_level=None, timeout=60)
for line in sys.stdin:
    raw.execute("BEGIN EXCLUSIVE" if line == "lock\\n" else "ROLLBACK")
    print("done", flush=True)
"""


class Locker:
    """The other process."""

    def __init__(self, place: Path) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", LOCKER, str(place)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def do(self, what: str) -> None:
        """ "lock" or "free"; returns when it is done."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"{what}\n")
        self._process.stdin.flush()
        assert self._process.stdout.readline() == "done\n"

    def close(self) -> None:
        """End it."""
        self._process.kill()
        self._process.communicate()


class Client:
    """A page, as far as this needs one: it sends, and knows the newest view."""

    def __init__(self, url: str, token: str = "") -> None:
        self._stack = ExitStack()
        self._socket = self._stack.enter_context(connect(url, open_timeout=60))
        if token:
            self._socket.send(token)
        self.view: dict[str, Any] = {}
        self.mistakes: list[str] = []
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        try:
            for message in self._socket:
                event = json.loads(message)
                if event["event"] == "view":
                    self.view = event["is"]
                elif event["event"] == "mistake":
                    self.mistakes.append(event["text"])
        except ConnectionClosed:
            return

    def do(self, command: str, **more: Any) -> float:
        """Send it; the time just before [s]."""
        message, before = json.dumps({"do": command, **more}), time.monotonic()
        self._socket.send(message)
        return before

    def until(self, *states: str) -> None:
        """Wait for one of `states`."""
        wait_for(lambda: self.view.get("state") in states, lambda: f"{states}, not {self.view}; {self.mistakes}")

    def close(self) -> None:
        """Go away."""
        self._stack.close()


def wait_for(holds: Callable[[], object], what: Callable[[], str] | str) -> None:
    """Return when `holds`."""
    end = time.monotonic() + 300
    while not holds():
        if time.monotonic() > end:
            raise SystemExit(f"did not come to pass: {what if isinstance(what, str) else what()}")
        time.sleep(0.002)


def make_study(state: str, repetitions: int) -> Study:
    """A study that comes into `state` at least `repetitions` times."""
    rest = {"pause": "pause_seconds = 600", "break": "break_every = 1\nbreak_seconds = 600"}.get(
        state, "pause_seconds = 0.0"
    )
    limit = "time_limit = 0.1" if state == "time is up" else ""
    questions = "".join(
        f'[[questions]]\nname = "q{n}"\ntext = "How tired?"\nwhen = "before"\nlow = 0\nhigh = 10\n'
        for n in range(repetitions + 1 if state == "question" else 0)
    )
    return study_of(
        f'name = "stop"\n[set_points]\npoints = [{{ number = 1, theta_deg = 0 }}, {{ number = 2, theta_deg = 36 }}]\n'
        f"[trials]\nrepetitions = {max(repetitions, 2)}\n{rest}\n{limit}\n{questions}"
    )


class Scene:
    """A served study in one state, its pages, its servo, and the moments at which that was told to stop."""

    def __init__(self, state: str, folder: Path, repetitions: int) -> None:
        self.state, self.place = state, folder / f"{state.replace(' ', '-')}.db"
        self.engine = database(self.place)
        self.servo: Servo | None = None
        self.stops: list[float] = []
        self._codes = 0
        self.manager = SessionManager(self.engine, make_study(state, repetitions), self._start)
        self.host = StudyServer(self.manager, 0)
        self._serving = threading.Thread(target=self.host.serve)
        self._serving.start()
        url, token = self.host.participant.replace("http", "ws").split("#")
        self.first = Client(url + "ws/participant", token)
        self.first.until("waiting")
        self.second = Client(url + "ws/participant", token)
        self.experimenter = Client(url + "ws/experimenter", self.host.experimenter.split("#")[1])
        self.experimenter.until("waiting")

    def _start(self, recording: Path | None) -> Servo:
        servo = Servo("omni", "nothing", record=False)
        stop = servo.stop

        def stop_and_note() -> None:
            stop()
            self.stops.append(time.monotonic())

        servo.stop = stop_and_note  # type: ignore[method-assign]
        self.servo = servo
        return servo

    def reach(self) -> None:
        """Come into the state, from wherever the last repetition ended."""
        if self.state in ("starting", "consent") and self._codes:
            self.experimenter.do("leave")
            self.experimenter.until("left")
        if self.state in ("starting", "consent") or not self._codes:
            self._codes += 1
            self.experimenter.do("begin", code=f"P{self._codes:02d}")
            if self.state == "starting":
                self.experimenter.until("starting")
                return
            self.experimenter.until("consent")
            if self.state == "consent":
                return
            self.first.do("agree", agreed=True)
            if self.state in ("pause", "break"):
                self.experimenter.until("running")
                self.first.do("answer", trial=0, value=1)
        if self.experimenter.view["state"] == "paused" and self.state != "paused":
            self.experimenter.do("resume")
        self.experimenter.until("running" if self.state == "paused" else self.state, self.state)
        if self.state == "paused" and self.experimenter.view["state"] != "paused":
            self.experimenter.do("stop")
            self.experimenter.until("paused")

    def block(self) -> None:
        """Send the thread of the sessions into the lock, if this state has something to be kept."""
        view = self.experimenter.view
        if self.state == "consent":
            self.first.do("agree", agreed=True)
        elif self.state == "question":
            self.first.do("reply", question=view["question"]["name"], reply="3")
        elif self.state in ("running", "time is up"):
            self.first.do("answer", trial=view["trial"], value=1)
        time.sleep(0.05)

    def on(self) -> bool:
        """Whether the newest row has the guard engaged."""
        servo = self.servo
        row = servo.latest() if servo is not None and servo.alive else None
        return row is not None and row[servo.layout["guard"]][0] not in OFF  # type: ignore[union-attr]

    def close(self) -> None:
        """End everything."""
        for page in (self.first, self.second, self.experimenter):
            page.close()
        self.host.close()
        self._serving.join()
        self.host.__exit__(None, None, None)
        self.engine.dispose()


def off_at(servo: Servo, cursor: int) -> tuple[float, int]:
    """When the loop had published a row with everything off after `cursor`, and one more; the cursor there."""
    layout = servo.layout
    while True:
        _, rows = servo.rows(cursor)
        off = [
            n
            for n in range(len(rows))
            if rows[n, layout["guard"]][0] in OFF and not rows[n, layout["duty_applied"]].any()
        ]
        if off and off[0] + 1 < len(rows):
            return float(rows[off[0] + 1, layout["wall"]][0]), cursor + off[0]
        time.sleep(0.001)


def measure(state: str, folder: Path, repetitions: int, lock: float) -> dict[str, Any]:
    """Times of all Stops in `state` [ms], and what went wrong."""
    scene, delays, off, wrong = Scene(state, folder, repetitions), [], [], []
    locker = Locker(scene.place)
    try:
        for repetition in range(repetitions):
            scene.reach()
            if state not in ("starting", "paused"):
                wait_for(scene.on, "the device is on")
            locker.do("lock")
            since = time.monotonic()
            scene.block()
            pages = [scene.first, scene.second, scene.experimenter]
            servo = scene.servo
            cursor = servo.rows(0)[0] if servo is not None and state != "starting" else 0  # a paused one was on before
            for n in range(3):
                scene.stops.clear()
                sent = pages[(repetition + n) % 3].do("stop")
                wait_for(lambda: scene.stops, "the servo's stop")
                delays.append(1e3 * (scene.stops[0] - sent))
                if n == 0 and servo is not None and state not in ("starting", "paused"):
                    at, cursor = off_at(servo, cursor)
                    off.append(1e3 * (at - sent))
            if repetition == 0:
                time.sleep(max(lock - (time.monotonic() - since), 0.0))
                if scene.on():
                    wrong.append(f"{state}: on again while the database was locked")
            locker.do("free")
            scene.experimenter.until("paused")
            wanted = 1 if state == "paused" else repetition + 1
            wait_for(lambda wanted=wanted: count_pauses(scene) >= wanted, "the record of the Stop")  # type: ignore[misc]
            servo = scene.servo
            assert servo is not None
            _, rows = servo.rows(0 if state == "starting" else cursor)
            if not all(guard in OFF for guard in rows[:, servo.layout["guard"]][:, 0]):
                wrong.append(f"{state}: on again without anybody's Resume")
    finally:
        locker.close()
        scene.close()
    return {"state": state, "told_ms": delays, "off_ms": off, "wrong": wrong}


def count_pauses(scene: Scene) -> int:
    """How many pauses are on record."""
    with scene.engine.connect() as connection:
        return int(connection.execute(text("SELECT count(*) FROM events WHERE kind = 'pause'")).scalar_one())


def main() -> int:
    """Measure, and print for people or machines; 1 if a Stop was late."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repetitions", type=int, default=6)
    parser.add_argument("--lock", type=float, default=30.0, help="of the first repetition in every state [s]")
    parser.add_argument("--states", nargs="*", default=STATES, choices=STATES)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for state in options.states:
            found.append(measure(state, Path(folder), options.repetitions, options.lock))
            if not options.json:
                times = ", ".join(
                    f"{name} {statistics.median(one):.1f} ms (at most {max(one):.1f})"
                    for name in ("told", "off")
                    if (one := found[-1][f"{name}_ms"])
                )
                print(f"{state:>10}: {times}; {len(found[-1]['told_ms'])} Stops", flush=True)
    wrong = [text for one in found for text in one["wrong"]]
    every = [value for one in found for value in one["told_ms"] + one["off_ms"]]
    good = not wrong and max(every) <= LIMIT
    if options.json:
        print(json.dumps({"good": good, "worst_ms": max(every), "states": found}))
    else:
        count = sum(len(one["told_ms"]) for one in found)
        print(
            "\n".join(
                [
                    *wrong,
                    f"{count} Stops with the database locked: at most {max(every):.1f} ms (limit {LIMIT:g}): "
                    + ("yes" if good else "NO"),
                ]
            )
        )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
