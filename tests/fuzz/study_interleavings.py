"""Random interleavings of pages, session thread, device and servo loop in a study.

    python tests/fuzz/study_interleavings.py [--interleavings 20000] [--seed 1]

No thread and no clock: the real hub, session manager, runner and halt of a study, on a servo that keeps the servo's
rules (a count of Stops, an engage that carries the count under which it was asked for, obeyed when the loop ticks)
and a session on paper. Wherever the session's thread waits for the database or the servo, other things may happen in
between: Stops of every page, Resume, Begin, trips, pages that go away, failures of the device. After every single
step three things must hold: the coils are not on if the last Stop came after the last request to switch on (Begin,
Resume, Switch on), whoever came on began with the gain at zero, and nothing failed that nobody foresaw (such a
session is over, so nothing could be switched on in it). Exit code 1 if that was ever broken.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from haptorb.control.trip_reasons import CoilState, GuardState, Trip
from haptorb.devices.loader import load
from haptorb.errors import RecordingError, ServoError
from haptorb.recording.row import RowLayout
from haptorb_study.order import plan, procedure_of
from haptorb_study.pages.session_manager import SessionManager
from haptorb_study.pages.socket_hub import StudyPage, StudySocketHub
from haptorb_study.prompts import Answer
from haptorb_study.study_file import Study, study_of

STEPS = 40  #: of one interleaving
STUDY = """
name = "interleaved"
[set_points]
points = [{ number = 1, theta_deg = 0 }, { number = 2, theta_deg = 36 }]
[trials]
repetitions = 4
pause_seconds = 0.0
break_every = 3
break_seconds = 600
[[questions]]
name = "before"
text = "Well?"
when = "before"
choices = ["yes", "no"]
"""


class World:
    """One interleaving: what happens is drawn by `draw`, and `check` looks after every step."""

    def __init__(self, draw: random.Random, study: Study, device: Any, procedure: Any) -> None:
        self.draw, self.study, self.device, self.procedure = draw, study, device, procedure
        self.layout = RowLayout.of(device)
        self.servo: Servo | None = None
        self.depth = 0  # of things that happen within others
        self.broken: list[str] = []
        self.switched_on, self.resumed = 0, 0
        self.messages: list[str] = []
        self.stopped_last = False  #: whether the last Stop came after the last request to switch on
        self.manager = SessionManager(None, study, self._start, open_session=lambda *_: Paper(self))  # type: ignore[arg-type]
        self.hub = StudySocketHub(self.manager, "token", "token", {}, {})
        self.first, self.second = self._page(True), self._page(True)
        self.experimenter = self._page(False)

    def _start(self, recording: Path | None) -> Any:
        self.interrupt()
        self.servo = Servo(self)
        return self.servo

    def _page(self, participant: bool) -> StudyPage:
        page = StudyPage(None, participant)  # type: ignore[arg-type]
        self.hub.register(page)
        return page

    def interrupt(self) -> None:
        """Something else, while the session's thread waits."""
        while self.depth < 3 and self.draw.random() < 0.35:
            self.depth += 1
            self.do_anything(inside=True)
            self.depth -= 1

    def do_anything(self, inside: bool = False) -> None:
        """One thing, whatever; inside the session's thread itself that thread does nothing else."""
        draw = self.draw
        things = [self.tick, self.tick, self.stop, self.ask, self.ask, self.ask, self.trip, self.close_page]
        if not inside:
            things += [self.step] * 4
        what = draw.choice(things)
        what()
        self.messages.append(what.__name__)
        self.check(what.__name__)

    def step(self) -> None:
        """The session's thread."""
        self.manager._next_poll = 0.0  # it looks at the device as well
        self.manager.step()

    def tick(self) -> None:
        """The servo's loop."""
        if self.servo is not None:
            self.servo.tick()

    def stop(self) -> None:
        """Any page, with more or less of a message around it."""
        self.stopped_last = True  # the page was told to before anything of it has happened
        page = self.draw.choice([self.first, self.second, self.experimenter])
        self.hub.handle_message(
            page, self.draw.choice(['{"do":"stop"}', '{"do": "stop", "why": "\\ud800', '{"do":"stop","x":[]}'])
        )

    def ask(self) -> None:
        """Any page, for anything but Stop."""
        view = self.manager
        number = view.session.number if view.session is not None else 0
        switches = [{"do": "resume"}, {"do": "resume"}, {"do": "engage"}, {"do": "begin", "code": "P01"}]
        others = [{"do": "repeat"}, {"do": "skip"}, {"do": "nothing"}, {"do": []}]
        mine = [
            {"do": "agree"}, {"do": "answer", "trial": number, "value": 1}, {"do": "skip"}, {"do": "draft", "value": 2},
            {"do": "reply", "question": "before", "reply": "yes"}, {"do": "interval", "which": 1}, {"do": "steer"},
        ]  # fmt: skip
        if self.draw.random() < 0.5:
            command = self.draw.choice(switches if self.draw.random() < 0.7 else others)
            if command in switches:
                self.stopped_last = False
            self.hub.handle_message(self.experimenter, json.dumps(command))
        else:
            self.hub.handle_message(self.draw.choice([self.first, self.second]), json.dumps(self.draw.choice(mine)))

    def trip(self) -> None:
        """The guard trips, or, seldom, the device fails."""
        if self.servo is not None:
            self.servo.trip(self.draw.choice([Trip.POSE_LOST, Trip.OVERHEATED]))
            if self.draw.random() < 0.1:
                self.servo.alive = False
                self.servo.switch_off()

    def close_page(self) -> None:
        """A participant's page is closed and another one opened, or the experimenter ends the session."""
        if self.draw.random() < 0.2:
            self.stopped_last = True
            self.hub.handle_message(self.experimenter, json.dumps({"do": self.draw.choice(["leave", "abort"])}))
            return
        self.stopped_last = True
        self.hub.unregister(self.first)
        self.first, self.second = self.second, self._page(True)

    def check(self, after: str) -> None:
        """The three rules."""
        servo = self.servo
        if self.manager.trouble.startswith("a fault in haptorb"):
            self.broken.append(f"{self.manager.trouble}, after {after}")
        if servo is None:
            return
        servo.tick()
        if servo.gain > 0 and self.stopped_last:
            self.broken.append(f"on after a Stop, after {after}: {' '.join(self.messages[-12:])}")
        if servo.jumped:
            self.broken.append(f"came on without a ramp, after {after}")


class Servo:
    """The servo's rules without a servo: Stops are counted, and an engage is void if its count is not the newest."""

    tracker, driver = "pointer", "sim"

    def __init__(self, world: World) -> None:
        self._world, self.device, self.layout = world, world.device, world.layout
        self.alive, self.open_, self.stops = True, False, 0
        self.guard, self.reason, self.gain, self.jumped = GuardState.OFF, Trip.NONE, 0.0, False
        self._stops_seen = 0
        self._engage: int | None = None

    def open(self) -> None:
        """Other things happen while it starts."""
        self._world.interrupt()
        self.open_ = True
        self.tick()

    def close(self) -> None:
        """Coils off for good."""
        self._world.interrupt()
        self.open_ = False
        self.switch_off()

    def end_loop(self) -> None:
        """Coils off; the loop ends."""
        self.switch_off()

    def pause_recording(self, paused: bool) -> None:
        """Nothing is recorded."""

    def switch_off(self) -> None:
        """Coils off, without a reason that could be cleared."""
        self.guard, self.gain = GuardState.TRIPPED, 0.0
        self.reason = self.reason or Trip.CLOSING

    def stop(self) -> None:
        """As the servo's own."""
        self.stops += 1

    def engage(self, stops: int | None = None) -> None:
        """As the servo's own; a Stop may come while it is on its way."""
        self._world.interrupt()
        self._world.resumed += 1
        wanted = self.stops if stops is None else stops
        self._world.interrupt()
        self._engage = wanted

    def trip(self, reason: Trip) -> None:
        """Coils off for a reason."""
        if self.guard is not GuardState.TRIPPED:
            self.guard, self.reason, self.gain = GuardState.TRIPPED, reason, 0.0

    def tick(self) -> None:
        """As the loop obeys: Stop first, then an engage that is not older; the ramp begins at zero."""
        if not (self.open_ and self.alive):
            self.gain = 0.0
            return
        if self.stops != self._stops_seen:
            self._stops_seen = self.stops
            self.trip(Trip.STOPPED)
        before, engaged = self.gain, self._engage == self.stops and self._engage is not None
        self._engage = None
        if self.guard is GuardState.OFF or (engaged and self.guard is GuardState.TRIPPED):
            self.guard, self.reason, self.gain = GuardState.RAMPING, Trip.NONE, 0.0
            self._world.switched_on += 1
        if self.guard in (GuardState.RAMPING, GuardState.RUNNING):
            self.gain, self.guard = min(self.gain + 0.5, 1.0), GuardState.RUNNING
        self.jumped = before == 0.0 and self.gain > 0.5

    def check(self) -> None:
        """ServoError once it failed."""
        if not self.alive:
            raise ServoError("the servo ended: it was drawn so")

    def set_world(self, name: str, values: Any = None) -> None:
        """It takes a tick or two, in which anything may happen."""
        self._world.interrupt()
        self.tick()
        self.check()

    @property
    def hand(self) -> Any:
        """It takes the commands to the hand itself."""
        return self

    def point(self, p: Any, *, keep_alive: float = 0.0) -> None:
        """The hand."""

    def rows(self, cursor: int = 0) -> tuple[int, np.ndarray]:
        """The newest one."""
        return cursor + 1, self.latest()[None, :]

    def latest(self) -> np.ndarray:
        """The row of now."""
        row = np.zeros(self.layout.width)
        row[self.layout["valid"]] = 1.0
        row[self.layout["p"]] = (0.0, 0.0, 0.05)
        row[self.layout["guard"]], row[self.layout["trip"]] = self.guard, self.reason
        row[self.layout["coil_state"]] = CoilState.ON if self.gain > 0 else CoilState.OFF
        return row


class Paper:
    """A session whose answers are nowhere; keeping one takes its time, and sometimes fails."""

    id, code, simulated, resumed, over = 1, "P01", False, False, False

    def __init__(self, world: World) -> None:
        world.interrupt()
        self._world, self.study = world, world.study
        self.procedure = world.procedure
        self.number = self.stored = 0
        self.history: list[dict[str, Any]] = []
        self._asked = bool(world.study.questions)

    @property
    def prompt(self) -> Any:
        """What is asked now."""
        return self.procedure.prompt

    @property
    def question(self) -> Any:
        """What is asked in words."""
        return self.study.questions[0] if self._asked else None

    def check_kept(self) -> None:
        self._world.interrupt()
        if self._world.draw.random() < 0.05:
            raise RecordingError("the database is locked")

    def reply(self, question: Any, text: str) -> None:
        """Keep it."""
        question.check_reply(text)
        self.check_kept()
        self._asked = False

    def answer(self, answer: Answer, **more: Any) -> None:
        """Keep it."""
        after = self.procedure.record_answer(answer)
        self.check_kept()
        self.procedure, self.number = after, self.number + 1

    def record_event(self, kind: str, text: str = "", *, at: str | None = None, later: bool = False) -> None:
        """Keep that something happened."""
        if later:
            self._world.interrupt()
        else:
            self.check_kept()

    def store_late_events(self) -> None:
        """What could not be kept is kept."""
        self._world.interrupt()

    def abort(self, reason: str = "") -> None:
        """End for good."""
        self.check_kept()

    def close(self) -> None:
        """Somebody else's."""
        self._world.interrupt()


def study_interleavings(interleavings: int, seed: int = 1) -> SimpleNamespace:
    """Run so many: steps, switched_on and resumed (how often the coils came on, and were asked to after the beginning),
    broken (texts; must be empty)."""
    draw, study, device = random.Random(seed), study_of(STUDY), load("omni")
    procedure, steps, switched_on, resumed = procedure_of(study, plan(study, 0)), 0, 0, 0
    broken: list[str] = []
    for _ in range(interleavings):
        world = World(draw, study, device, procedure)
        if draw.random() < 0.8:  # most begin in the middle of things
            for line in (
                '{"do":"begin","code":"P01"}',
                '{"do":"agree"}',
                '{"do":"reply","question":"before","reply":"yes"}',
            ):
                world.hub.handle_message(world.experimenter if "begin" in line else world.first, line)
                world.stopped_last = False if "begin" in line else world.stopped_last
                world.step()
                world.check("the beginning")
        for _ in range(STEPS):
            world.do_anything()
            steps += 1
        switched_on += world.switched_on
        resumed += world.resumed
        broken += world.broken
    return SimpleNamespace(
        interleavings=interleavings, steps=steps, switched_on=switched_on, resumed=resumed, broken=broken
    )


def main() -> int:
    """Run, and print for people."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--interleavings", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    found = study_interleavings(options.interleavings, options.seed)
    print("\n".join(found.broken[:10]), end="\n" if found.broken else "")
    print(
        f"{found.interleavings} interleavings, {found.steps} steps, the coils came on {found.switched_on} times, "
        f"{found.resumed} switches were asked for behind a beginning: broken {len(found.broken)} times: "
        f"{'NO' if found.broken else 'yes'}"
    )
    return 1 if found.broken else 0


if __name__ == "__main__":
    sys.exit(main())
