"""Both pages of a study on one port of this computer, until a signal or `close`."""

from __future__ import annotations

import asyncio
import json
import os
import re
import secrets
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from html import escape
from math import hypot
from pathlib import Path
from queue import Empty, SimpleQueue
from time import monotonic
from types import TracebackType
from typing import Any, Self, final

import numpy as np
from sqlalchemy.engine import Engine
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from haptorb.errors import HaptorbError, InputError, ServoError
from haptorb.runtime.linux import start_python
from haptorb.runtime.servo import Servo
from haptorb.terminal import say
from haptorb.web.access import AccessGate, choose_token
from haptorb.web.server import (
    HOST,
    PageAddress,
    bind_socket,
    is_stop_request,
    page_files,
    prioritize,
    respond,
    run_beside,
    server,
    signals,
)
from haptorb.web.server import command as read_command
from haptorb_study.codes import next_code
from haptorb_study.database import list_participants
from haptorb_study.halt import StopCount, StopSwitch
from haptorb_study.incidents import name_kind
from haptorb_study.order import GREATEST, ask_number
from haptorb_study.procedures import Prompt
from haptorb_study.session import OVER, StoredSession, TrialDevice, TrialRunner
from haptorb_study.streams import Streams
from haptorb_study.study_file import Study

__all__ = [
    "PORT",
    "REPORT_SERVER_PORT",
    "STATIC",
    "CodeList",
    "ReportServer",
    "SessionManager",
    "StudyServer",
    "StudySocketHub",
    "TrialViewers",
    "application",
    "check_text",
    "describe_study",
    "explain_fault",
    "for_experimenter",
    "for_participant",
    "pen",
    "places",
    "try_step",
]


# --------------------------------------------------------------------------------------------------
# The codes that are taken in a study's database, and one that is free, for the experimenter's page.


@final
class CodeList:
    """What was known when `refresh` last ran; the pages read it, the sessions' thread refreshes it."""

    def __init__(self, engine: Engine, study: Study) -> None:
        self._engine, self._study = engine, study
        self.taken: tuple[dict[str, Any], ...] = ()  #: code, state, answered; people only
        self.free = ""  #: a code that is free; empty: not known

    def refresh(self) -> None:
        """Ask the database."""
        people = list_participants(self._engine, self._study)
        self.taken = tuple(
            {"code": one.code, "state": one.state, "answered": one.answered} for one in people if not one.simulated
        )
        self.free = next_code(one.code for one in people)


# --------------------------------------------------------------------------------------------------
# What goes wrong while a session is served: said in words, or left behind on the way out.


def check_text(command: Mapping[str, Any], name: str) -> str:
    """The text `name` of a page's `command`, empty if there is none; InputError if it is no text."""
    value = command.get(name, "")
    if not isinstance(value, str):
        raise InputError(f"{name} must be a text; got {type(value).__name__}")
    return value


def explain_fault(fault: BaseException) -> str:
    """What it was, and where."""
    frames = traceback.extract_tb(fault.__traceback__)
    where = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return f"{type(fault).__name__}: {fault}{where}"


def try_step(do: Callable[[], object]) -> None:
    """A step on the way out: its failure, foreseen or not, is reported, and the next step is taken all the same."""
    try:
        do()
    except Exception as fault:
        with suppress(OSError, ValueError):  # standard error may be closed
            say(f"while a session ended: {explain_fault(fault)}")


# --------------------------------------------------------------------------------------------------
# Runs sessions one after another in a thread of its own: commands of the pages in, one state out.
#
# The thread may wait for the disk, a database far away, or a device that starts; the pages, the pen and Stop do not:
# Stop goes through `SessionManager.halt`, which waits for no other thread.


_TICK = 0.02  #: between two looks at the device [s]
_WAITING = 100  #: commands that may wait at most: who sends more is no person

#: for a request of a page to the manager: reports to the page what was wrong, or nothing
Respond = Callable[[str], None]


@final
class SessionManager:
    """One study, one participant at a time.

    state   waiting (for a participant), starting (the device), consent, ready, then those of `TrialRunner`; declined,
            failed
    start   makes the servo of a session, recording to the given file; not yet open
    beside  file for the recording of a session from its next trial on; None: no recording
    open_session  opens the session of a participant's code in the database
    """

    def __init__(
        self, engine: Engine, study: Study, start: Callable[[Path | None], Servo],
        beside: Callable[[StoredSession], Path | None] = lambda session: None, streams: Streams | None = None,
        open_session: Callable[[Engine, Study, str], StoredSession] = StoredSession,
    ) -> None:  # fmt: skip
        self.engine, self.study = engine, study
        self._start, self._beside, self._streams, self._open_session = start, beside, streams, open_session
        self.halt = StopSwitch()  #: Stop, for every page and thread
        self.state = "waiting"
        self.trouble = ""  #: why the last session ended as it did
        self.session: StoredSession | None = None
        self.runner: TrialRunner | None = None
        self.trial_device: TrialDevice | None = None
        self.log: list[dict[str, Any]] = []  #: answered trials of this session, newest last
        self.codes = CodeList(engine, study)
        self.history: list[dict[str, Any]] = []  #: what happened in this session, or in the last one
        self.stored = 0  #: answers of the last session that are stored
        self._recording: Path | None = None
        self._servo: Servo | None = None
        self._inbox: SimpleQueue[tuple[dict[str, Any], StopCount, Respond]] = SimpleQueue()
        self._ended = threading.Event()
        self._died = ""  # why the thread ended by itself
        self._next = 0.0  # look at the device
        self._thread = threading.Thread(target=self._run, name="sessions", daemon=True)

    def open(self) -> None:
        """Start listening to `ask`."""
        self._thread.start()

    def close(self) -> None:
        """Coils off; a session that runs is left, resumable. May be called twice."""
        self._ended.set()
        self.halt.stop(None)  # the thread may be waiting for a database
        if self._thread.is_alive():
            self._thread.join()

    @property
    def dead(self) -> bool:
        """Whether the thread has ended without a request: no command would be executed."""
        return bool(self._died) and not self._thread.is_alive()

    def ask(self, command: dict[str, Any], respond: Respond) -> None:
        """Execute `command` soon; `respond` receives the mistake, if there is one."""
        if self._died:
            raise InputError(f"the study program has failed and is closing: {self._died}")
        if self._inbox.qsize() >= _WAITING:
            raise InputError("too many commands are waiting (is the database locked?): try again in a moment")
        self._inbox.put((command, self.halt.ask(), respond))

    @property
    def now(self) -> str:
        """The state, in one word; "paused" from the moment of a Stop."""
        runner, session = self.runner, self.session  # the thread may put them away meanwhile
        state = runner.state if runner is not None else self.state
        if (
            self.halt.active
            and session is not None
            and state not in ("starting", "waiting", "failed", "declined", *OVER)
        ):
            return "paused"
        return state

    @property
    def number(self) -> int:
        """Of the session in the database; 0: none."""
        return session.id if (session := self.session) is not None else 0

    def step(self, wait: float = 0.0) -> None:
        """Obey the command that has waited longest, for which `wait` [s] are waited; and look at the device."""
        try:
            command, asked, respond = self._inbox.get(timeout=wait) if wait > 0 else self._inbox.get_nowait()
        except Empty:
            self._next = 0.0
        else:
            self._try(lambda: self._execute(command, asked), respond)
        if monotonic() >= self._next:
            self._next = monotonic() + _TICK
            # A session whose device or database went away can be resumed, so nothing is lost by ending it here.
            self._try(self._tick, None)

    def _run(self) -> None:
        try_step(self.codes.refresh)
        try:
            while not self._ended.is_set():
                self.step(_TICK)
        except BaseException as fault:
            self._died = f"its thread ended: {explain_fault(fault)}"
        finally:
            self.halt.stop(None)
            runner = self.runner
            if runner is not None and runner.state not in OVER:
                try_step(runner.leave)
            self._end(self._died, "failed" if self._died else "left")
            if self._died:
                self.state, self.trouble = "failed", self._died

    def _try(self, do: Callable[[], None], respond: Respond | None) -> None:
        """`do` it; an exception is reported, and this thread continues. None: without a page, so the session ends."""
        try:
            do()
        except HaptorbError as mistake:
            if respond is not None:
                respond(str(mistake))
            if respond is None or isinstance(mistake, ServoError):
                self._end(str(mistake))
        except BaseException as fault:  # safety: study-fault
            # Unexpected, so the session's state is unknown: off, and it can be resumed.
            self.halt.stop(None)
            text = (
                f"a fault in haptorb, please report it: {explain_fault(fault)}. Coils off; the session can be resumed"
            )
            if respond is not None:
                respond(text)
            self._end(text)

    def _tick(self) -> None:
        if self._servo is None or self.trial_device is None:
            return
        self._record_stops()
        self._servo.check()
        if self._streams is not None:
            self._streams.poses(self._servo)
        if self.runner is not None:
            self.runner.tick()
            if self.runner.state in OVER:
                self._end("", self.runner.state)

    def _record_stops(self) -> None:
        """Keep the Stops of the time before the first trial; `TrialRunner` keeps the later ones."""
        if self.runner is None and self.session is not None:
            for stopped in self.halt.take():
                self.session.note("pause", stopped.why, at=stopped.at, later=True)
            self.session.keep_late()

    def _execute(self, command: dict[str, Any], asked: StopCount) -> None:
        self._record_stops()
        do = command["do"]
        if do == "begin":
            self._begin(command["code"], asked)
            return
        if do == "agree":
            self._agree(bool(command.get("agreed", True)))
            return
        if (runner := self.runner) is None and self.session is not None and do in ("leave", "abort", "resume"):
            self._execute_before_trials(do, asked)
            return
        if runner is None:
            raise InputError("no session is running")
        match do:
            case "answer":
                # Of the trial that the page showed: a second click must not answer the next one.
                if command.get("trial") == runner.session.number:
                    self._answer(runner, command.get("value"))
            case "reply":
                if runner.question is not None and command.get("question") == runner.question.name:
                    runner.reply(check_text(command, "reply"))
            case "skip":
                runner.skip()
            case "interval":
                runner.interval(command.get("which"))
            case "resume":
                runner.resume(asked)
            case "repeat":
                runner.repeat()
            case "engage":
                runner.engage(asked)
            case "leave":
                runner.leave()
            case "abort":
                runner.abort("by the experimenter")
        if runner.state in OVER:
            self._end("", runner.state)

    def _begin(self, code: str, asked: StopCount) -> None:
        """Take a participant in: session claimed, device started, nothing felt yet."""
        if self.session is not None:
            raise InputError(f"participant {self.session.code} has a running session: end it first")
        session = self._open_session(self.engine, self.study, code)
        if session.over:
            session.close()
            raise InputError(f"participant '{code}' has already answered all trials")
        self.session, self.state, self.trouble, self.log = session, "starting", "", []
        self.history = session.history
        try:
            self._recording = self._beside(session)
            self._servo = servo = self._start(self._recording)
            self.halt.attach(servo, asked)  # before it is open: Stop reaches it from here on
            servo.open()
            trial_device = TrialDevice(self.study, servo)
            trial_device.hold()  # the first time loads kernels; afterwards the pen must never be without data that long
            trial_device.record(False)  # nothing is felt until the participant has agreed
            self.trial_device = trial_device
            self._mark("session", {"session": session.id, "participant": session.code})
        except HaptorbError as failure:
            self._end(str(failure))
            raise
        self.state = "consent"

    def _agree(self, agreed: bool) -> None:
        if self.state != "consent" or self.session is None or self.trial_device is None or self.runner is not None:
            raise InputError("no consent is expected now")
        if not agreed:
            self.halt.stop(None)
            self.session.note("declined", later=True)
            self._end("the participant did not agree to take part", "declined")
            return
        if self.halt.active:
            raise InputError("the session is stopped: the experimenter must resume it first")
        self.session.note("consent")
        recording = self._recording.name if self._recording is not None else None
        self.runner = TrialRunner(self.session, self.trial_device, recording, self._mark, halt=self.halt)

    def _execute_before_trials(self, do: str, asked: StopCount) -> None:
        """What may be asked for while the participant is asked for consent."""
        assert self.session is not None
        if do == "resume":
            if self.halt.active:
                self.halt.engage(asked)
                self.session.note("resume", later=True)
        elif do == "leave":
            self._end("", "left")
        else:
            self.session.abort("by the experimenter")
            self._end("", "aborted")

    def _answer(self, runner: TrialRunner, value: Any) -> None:
        prompt, number, seconds, repeats = runner.prompt, runner.session.number, runner.seconds, runner.repeats
        part = runner.trial_device.course(str(self._recording.absolute()) if self._recording is not None else None)
        runner.answer(value)
        trips = [str(trip.get("code")) for trip in runner.trips if trip["trial"] == number]
        assert prompt is not None
        row = {
            "trial": number, "answer": value, "seconds": round(seconds, 1), "safety": trips, "phase": prompt.phase,
            "set_point": prompt.set_point, "condition": prompt.condition, "level": prompt.level,
            "interval": prompt.interval, "repeats": repeats, "recording": part,
        }  # fmt: skip
        self.log = [*self.log, row]

    def _mark(self, kind: str, facts: dict[str, Any]) -> None:
        if self._streams is not None:
            self._streams.mark(kind, facts)

    def _end(self, trouble: str, state: str = "failed") -> None:
        """Coils off, session released; the answers are already on disk."""
        servo, session = self._servo, self.session
        self._servo = None
        if servo is not None:
            if state == "failed":
                try_step(servo.stop)  # `close` may itself be what fails
            try_step(servo.close)
        self.halt.detach()
        if session is not None:
            if trouble and state == "failed":
                try_step(lambda: session.note("failed", trouble, later=True))
            try_step(lambda: self._mark("end", {"state": state}))
            self.stored = session.stored
            try_step(session.close)
            try_step(self.codes.refresh)
            self.state, self.trouble = state, trouble
        self.session = self.runner = self.trial_device = None


# --------------------------------------------------------------------------------------------------
# What each page receives: the participant nothing that would reveal an answer, the experimenter everything.


_MOST_CODES = 100  #: that are shown, the newest
_MOST_INCIDENTS = 200  #: that are shown, the newest
_MOST_BUTTONS = 21  #: on a rating scale; beyond that a number is typed


def describe_study(study: Study, simulated: bool) -> dict[str, Any]:
    """What does not change: texts, places on the drawing, and the noise that is to be played.

    Places are drawn where they are the answers; where they are to be found freely they would give them away.
    """
    return {
        "study": study.name,
        "procedure": study.procedure,
        "instructions": study.instructions,
        "consent": study.consent,
        "simulated": simulated,
        "places": places(study) if study.procedure == "identification" else [],
        "limit": study.load_device().workspace_half_angle * 180 / np.pi,
        "mask": study.mask.model_dump() if study.mask is not None else None,
    }


def places(study: Study) -> list[dict[str, float]]:
    """Number and angles [deg] of every set-point."""
    return [{"number": p.number, "theta": p.theta_deg, "phi": p.phi_deg} for p in study.points]


def for_participant(manager: SessionManager) -> dict[str, Any]:
    """State, task, progress; never what is prompted, nor which interval holds what.

    stopped      who stopped, "" if none did or the session was resumed since
    unconfirmed  whether the coils were switched off, and the device has not confirmed it
    """
    runner, session, trial_device = manager.runner, manager.session, manager.trial_device
    halt = manager.halt
    view: dict[str, Any] = {
        "state": "failed" if manager.dead else manager.now, "session": manager.number, "task": None,
        "question": None, "stopped": (halt.why or "by the program") if halt.active and session is not None else "",
        "unconfirmed": trial_device is not None and trial_device.unconfirmed,
    }  # fmt: skip
    if session is not None:
        view["resumed"] = session.resumed
    else:
        view["stored"] = manager.stored
    if runner is None or session is None:
        return view
    prompt, expected = runner.prompt, session.procedure.expected
    view |= {
        "trial": session.number,
        "done": session.number,
        "total": session.number + expected,
        "left": round(runner.rest_left),
        "off": runner.trial_device.switched_off,
        "steered": runner.trial_device.steered,
        "repeats": runner.repeats,
        "which": runner.which,
    }
    if prompt is not None:
        view["practice"] = prompt.phase == "practice"
        view["task"] = _task(manager.study, prompt)
    if (question := runner.question) is not None:
        view["question"] = {
            "name": question.name, "text": question.text, "choices": list(question.choices), "low": question.low,
            "high": question.high,
        }  # fmt: skip
    return view


def for_experimenter(manager: SessionManager, pages: int, draft: Any) -> dict[str, Any]:
    """Everything: what is prompted, what is being answered, what the device did."""
    view = for_participant(manager) | {
        "trouble": manager.trouble or ("the study program has failed and is closing" if manager.dead else ""),
        "pages": pages,
        "draft": draft,
        "log": manager.log[-200:],
        "code": "",
        "taken": list(manager.codes.taken[-_MOST_CODES:]),
        "free": manager.codes.free,
        "incidents": [
            {**one, "kind": name, "trial": one["trial"] + 1}
            for one in manager.history
            if (name := name_kind(one["kind"])) is not None
        ][-_MOST_INCIDENTS:],
    }
    runner, session = manager.runner, manager.session
    if session is not None:
        view["code"] = session.code
    if runner is not None:
        view["seconds"] = round(runner.seconds)
        view["trips"] = runner.trips
        if runner.prompt is not None:
            view["prompt"] = runner.prompt.row()
    return view


def pen(trial_device: TrialDevice) -> dict[str, Any] | None:
    """Where the tool is, seen from above [deg], and the force on it [N]: outwards, and sideways towards +x and +y."""
    position, force = trial_device.position, trial_device.force
    if position is None:
        return None
    x, y, z = position
    distance = hypot(x, y, z)
    round_ = hypot(x, y)
    theta = float(np.degrees(np.arctan2(round_, z)))
    view: dict[str, Any] = {
        "x": theta * x / round_ if round_ else 0.0, "y": theta * y / round_ if round_ else 0.0,
    "off": trial_device.switched_off,
    }  # fmt: skip
    if force is not None and distance > 0:
        way = np.array(position) / distance
        out = float(force @ way)
        # Along the sphere: towards the rim, and round it.
        outward = np.array([x, y, 0.0]) / round_ if round_ else np.array([1.0, 0.0, 0.0])
        about_ = np.array([-outward[1], outward[0], 0.0])
        down = np.cos(np.radians(theta)) * outward - np.sin(np.radians(theta)) * np.array([0.0, 0.0, 1.0])
        side = float(force @ down) * outward + float(force @ about_) * about_
        view |= {"out": out, "fx": float(side[0]), "fy": float(side[1])}
    return {key: round(value, 3) if isinstance(value, float) else value for key, value in view.items()}


def _task(study: Study, prompt: Prompt) -> dict[str, Any]:
    if prompt.interval:
        ask = "Which do you prefer?" if prompt.other else "Which one pushed harder?"
        return {"kind": "compare", "ask": ask, "numbers": [1, 2]}
    if prompt.high:
        few = prompt.high - prompt.low < _MOST_BUTTONS and not prompt.decimal
        return {
            "kind": "rate", "ask": ask_number(study), "low": prompt.low, "high": prompt.high, "decimal": prompt.decimal,
            "numbers": list(range(prompt.low, prompt.high + 1)) if few else [],
        }  # fmt: skip
    if prompt.wants_number:
        return {"kind": "number", "ask": "Which place pushes?", "numbers": list(prompt.numbers)}
    return {"kind": "place", "ask": "Find the place that pushes, and stay there", "numbers": []}


# --------------------------------------------------------------------------------------------------
# Playing the recording of a trial from the experimenter's page: each in a viewer of its own, beside the study.
#
# The study's process keeps a hand on a device, so it reads no recordings: `haptorb view` does, in another process.


_MOST = 3  #: viewers at the same time; another one ends the oldest
_PATIENCE = 2.0  #: for one to end [s]


@final
class TrialViewers:
    """`urls`: trial's part of its recording → where it is played; "" while its viewer starts."""

    def __init__(self) -> None:
        self.urls: dict[str, str] = {}
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._changing = threading.Lock()
        self._closed = False

    def open(self, part: str, tell: Callable[[str], None]) -> None:
        """Begin to play `part` (FILE#t=FROM,TO), unless it is; `tell` is called with what went wrong, from a thread.

        Raises InputError if the file is gone.
        """
        path = Path(part.partition("#t=")[0])
        if not path.exists():
            raise InputError(f"the recording {path} is not there any more")
        with self._changing:
            if self._closed or (part in self._running and self._running[part].poll() is None):
                return
            while len(self._running) >= _MOST:
                self._end(next(iter(self._running)))
            process = start_python(
                "haptorb", "view", part, "--port", "0", "--json",
                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            )  # fmt: skip
            if hasattr(os, "setpriority"):
                os.setpriority(os.PRIO_PROCESS, process.pid, 10)
            self._running[part] = process
            self.urls = self.urls | {part: ""}
        threading.Thread(target=self._listen, args=(part, process, tell), daemon=True).start()

    def _listen(self, part: str, process: subprocess.Popen[bytes], tell: Callable[[str], None]) -> None:
        assert process.stdout is not None
        assert process.stderr is not None
        with process.stdout as answers, process.stderr as errors:
            line = answers.readline()
            if line.startswith(b"{"):
                with self._changing:
                    if part in self._running:
                        self.urls = self.urls | {part: str(json.loads(line)["url"])}
            answers.read()
            mistake = errors.read().decode(errors="replace")
        process.wait()
        with self._changing:
            if self._running.get(part) is process:
                del self._running[part]
                self.urls = {one: url for one, url in self.urls.items() if one != part}
                if not line:
                    tell(f"the recording cannot be played: {mistake.strip()[-400:]}")

    def _end(self, part: str) -> None:
        process = self._running.pop(part)
        self.urls = {one: url for one, url in self.urls.items() if one != part}
        process.terminate()

    def close(self) -> None:
        """End all viewers."""
        with self._changing:
            self._closed = True
            processes = list(self._running.values())
            for part in list(self._running):
                self._end(part)
        for process in processes:
            try:
                process.wait(_PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


# --------------------------------------------------------------------------------------------------
# Who is connected: participants' pages through one door, experimenters' through another that wants a token.
#
# Every page may stop. Stop is looked for in a message before anything else is, and goes straight to the servo.


REFRESH = 1 / 100  #: between two refreshes of a pen that is steered from here [s]
FRAME = 1 / 25  #: between two looks at what there is to tell [s]
PATIENCE = 5.0  #: for an experimenter's token [s]

#: what an experimenter's page sends to end with the coils off; the rest of the message may be anything
_STOPS = re.compile(r'"do"\s*:\s*"(stop|pause|leave|abort)"')
#: what a participant may ask of the session manager; everything else steers, and steering is the experimenter's
_PARTICIPANT = frozenset({"agree", "answer", "reply", "skip", "interval"})
_EXPERIMENTER = frozenset({"begin", "pause", "stop", "resume", "repeat", "engage", "leave", "abort", "skip", "view"})
_IN_TRIAL = ("running", "time is up")
_UNTOLD = 20  #: mistakes that were not yet sent to a page, at most


@final
class StudyPage:
    """One connected page. `status`: what it knows, by kind of event."""

    def __init__(self, socket: WebSocket, participant: bool) -> None:
        self.socket, self.participant = socket, participant
        self.status: dict[str, Any] = {}
        self.mistakes: list[str] = []

    def tell(self, mistake: str) -> None:
        """Have it shown what was wrong; of too much at once only the newest."""
        self.mistakes = [*self.mistakes[1 - _UNTOLD :], mistake]


@final
class StudySocketHub:
    """Joins pages to the session manager."""

    def __init__(
        self, manager: SessionManager, token: str, about: Mapping[str, Any], more: Mapping[str, Any],
        participant_token: str = "",
    ) -> None:  # fmt: skip
        self._manager, self._token, self._participant_token = manager, token, participant_token
        self._about, self._more = dict(about), dict(more)
        self._participants: list[StudyPage] = []  # the first has the pen and answers, the others only look on
        self._experimenters: list[StudyPage] = []
        self.viewers = TrialViewers()  #: of recorded trials, for the experimenter
        self._draft: Any = None
        self._draft_of = -1

    async def keep(self) -> None:
        """For as long as the server runs: the hand at rest on a pen that is steered from a page."""
        while True:
            trial_device = self._manager.trial_device
            if trial_device is not None:
                with suppress(Exception):  # the manager's thread notices by itself, and reports it
                    trial_device.hold()
            await asyncio.sleep(REFRESH)

    async def join_participant(self, socket: WebSocket) -> None:
        """Serve a participant's page until it goes away; beyond this computer, if its first message is its token."""
        await socket.accept()
        if not await self._shows(socket, self._participant_token):
            return
        page = StudyPage(socket, participant=True)
        self.enter(page)
        try:
            await self._serve(page, self._about)
        finally:
            self.part(page)

    async def join_experimenter(self, socket: WebSocket) -> None:
        """Serve an experimenter's page, if its first message is the token."""
        await socket.accept()
        if not await self._shows(socket, self._token):
            return
        page = StudyPage(socket, participant=False)
        self.enter(page)
        try:
            await self._serve(page, self._about | self._more)
        finally:
            self.part(page)

    async def _shows(self, socket: WebSocket, token: str) -> bool:
        """Whether the first message is `token`, if one is needed; else the connection is closed."""
        if not token:
            return True
        try:
            given = await asyncio.wait_for(socket.receive_text(), PATIENCE)
        except (TimeoutError, WebSocketDisconnect, KeyError, RuntimeError):
            given = ""
        # safety: experimenter-token
        if not secrets.compare_digest(given.encode("utf-8", "replace"), token.encode()):
            with suppress(RuntimeError):
                await socket.close(1008, "open this page with the address that the terminal printed")
            return False
        return True

    def enter(self, page: StudyPage) -> None:
        """`page` is there."""
        (self._participants if page.participant else self._experimenters).append(page)

    def part(self, page: StudyPage) -> None:
        """`page` went away. If it was the participant's, the coils go off until the session is resumed."""
        if page.participant and self._participants[0] is page:  # safety: participant-gone
            self._manager.halt.stop("the participant's page was closed")
        (self._participants if page.participant else self._experimenters).remove(page)

    def handle_message(self, page: StudyPage, text: str) -> None:
        """One message of `page`: Stop before anything else. A wrong message raises nothing, `page` is informed."""
        try:
            if page.participant:
                if is_stop_request(text):  # safety: study-stop-first
                    self._manager.halt.stop("by the participant")
            elif found := _STOPS.search(text):  # safety: study-end-first
                ends = found[1] in ("leave", "abort")
                self._manager.halt.stop(None if ends else "by the experimenter")
            command = read_command(text)
            do = command.get("do")
            if not isinstance(do, str):
                raise InputError("a command must state its action as text: do")
            if page.participant:
                self._receive_participant(page, do, command)
            else:
                self._receive_experimenter(page, do, command)
        except HaptorbError as mistake:
            page.tell(str(mistake))
        # safety: study-message
        except Exception as fault:  # for any content, the page's next Stop must be received
            page.tell(f"this message cannot be processed: {type(fault).__name__}")

    async def _serve(self, page: StudyPage, about: Mapping[str, Any]) -> None:
        sending = asyncio.create_task(self._send(page, about))
        try:
            while True:
                message = await page.socket.receive()
                if message["type"] == "websocket.disconnect":
                    break
                self.handle_message(
                    page, message.get("text") or (message.get("bytes") or b"").decode("utf-8", "replace")
                )
        except (WebSocketDisconnect, RuntimeError):
            pass  # the page went away while something was on its way
        finally:
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)

    def _receive_participant(self, page: StudyPage, do: str, command: dict[str, Any]) -> None:
        if do == "stop":
            return  # `handle_message` has done it
        if page is not self._participants[0]:
            raise InputError("another participant's page is open: close that one first")
        manager = self._manager
        if do == "steer":
            trial_device = manager.trial_device
            if trial_device is not None and trial_device.steered:
                trial_device.aim(_number(command, "x"), _number(command, "y"))
        elif do == "draft":
            session = manager.session
            value = command.get("value")
            if value is None or (type(value) in (int, float) and abs(value) <= GREATEST):
                self._draft, self._draft_of = value, session.number if session is not None else -1
        elif do in _PARTICIPANT:  # safety: participant-steers
            manager.ask(command, page.tell)
        else:
            raise InputError(f"a participant's page may not do {do[:40]!r}")

    def _receive_experimenter(self, page: StudyPage, do: str, command: dict[str, Any]) -> None:
        if do not in _EXPERIMENTER:
            known = ", ".join(sorted(_EXPERIMENTER))
            raise InputError(f"unknown command {do[:40]!r} (known: {known})")
        if do == "begin" and not isinstance(command.get("code"), str):
            raise InputError("a session begins with a participant's code, a text")
        if do == "view":
            self._view(page, command.get("trial"))
        elif do not in ("stop", "pause"):
            self._manager.ask(command, page.tell)

    def _view(self, page: StudyPage, trial: Any) -> None:
        """Have the recording of an answered trial of this session played."""
        if self._manager.now in _IN_TRIAL:
            raise InputError("a trial is running: stop it, or wait for the pause after it, to play a recording")
        parts = [row.get("recording") for row in self._manager.log if row["trial"] == trial]
        if not parts or parts[-1] is None:
            raise InputError("this trial has no recording: it is not answered yet, or the session is not recorded")
        self.viewers.open(parts[-1], page.tell)

    async def _send(self, page: StudyPage, about: Mapping[str, Any]) -> None:
        """Send what is new to `page`, some 25 times a second."""
        await page.socket.send_text(json.dumps({"event": "about", **about}))
        while True:
            for text in self._collect_messages(page):
                await page.socket.send_text(text)
            while page.mistakes:
                await page.socket.send_text(json.dumps({"event": "mistake", "text": page.mistakes.pop(0)}))
            await asyncio.sleep(FRAME)

    def _collect_messages(self, page: StudyPage) -> list[str]:
        """Messages with what is new to `page`; a fault in one of them does not keep it from the next ones."""
        news = []
        try:
            for event, what in self._events(page).items():
                if page.status.get(event) != what:
                    news.append(json.dumps({"event": event, "is": what}))
                    page.status[event] = what
        except Exception as fault:
            text = f"this page cannot be updated: {type(fault).__name__}: {fault}"
            if page.status.get("fault") != text:
                page.status["fault"] = text
                page.tell(text)
        return news

    def _events(self, page: StudyPage) -> dict[str, Any]:
        """What `page` is to know now, by kind of event."""
        manager = self._manager
        events: dict[str, Any] = {}
        if page.participant:
            events["view"] = for_participant(manager) | {"watching": page is not self._participants[0]}
        else:
            session = manager.session
            draft = self._draft if session is not None and self._draft_of == session.number else None
            events["view"] = for_experimenter(manager, len(self._participants), draft)
            events["viewers"] = self.viewers.urls
        trial_device = manager.trial_device
        if trial_device is not None and (not page.participant or trial_device.simulated):
            with suppress(HaptorbError):
                events["pen"] = pen(trial_device)
        return events


def _number(command: dict[str, Any], name: str) -> float:
    value = command.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{name} must be a number; got {str(value)[:40]!r}")
    try:
        return float(value)
    except OverflowError:
        raise InputError(f"{name} must be a smaller number") from None


# --------------------------------------------------------------------------------------------------
# The addresses of the study's server: two pages, their files, and a socket for each.


#: where the build hook puts the pages
STATIC = Path(__file__).parent / "static"


def application(hub: StudySocketHub, where: PageAddress = PageAddress()) -> Starlette:
    """The ASGI application; InputError if the pages have not been built."""
    files = page_files(STATIC)
    if not {"participant.html", "experimenter.html"} <= set(files):
        raise InputError(
            "the study's pages have not been built: run `cd web && npm ci && npm run build`, or use --terminal"
        )

    async def participant(request: Request) -> Response:
        return respond(files, "participant.html")

    async def experimenter(request: Request) -> Response:
        return respond(files, "experimenter.html")

    async def file(request: Request) -> Response:
        return respond(files, request.path_params["name"])

    return Starlette(
        routes=[
            Route("/", participant),
            Route("/experimenter", experimenter),
            Route("/static/{name}", file),
            WebSocketRoute("/ws/participant", hub.join_participant),
            WebSocketRoute("/ws/experimenter", hub.join_experimenter),
        ],
        middleware=[Middleware(AccessGate, exposed=where.exposed, origin=where.origin)],
        lifespan=run_beside(hub.keep),
    )


PORT = 8766  #: default; the console's is another
_LOOK = 0.05  #: between two looks whether the session manager runs [s]
_SWITCH = 0.0005  #: for which another thread of this program may compute on while a Stop has come [s]
_LAST_WORDS = 0.5  #: for the pages to show that it is not [s]


@final
class StudyServer:
    """Serves `manager` at `participant` and, to clients with the token in it, at `experimenter`.

    port   0 takes any free one
    more   what the experimenter's page shows besides: where answers are stored, and the forecast
    where  the address that it listens on, and the one at which browsers find it; beyond this computer the participant's
           page has a token, too
    Raises InputError at once if the port cannot be had or the pages have not been built.
    """

    def __init__(
        self,
        manager: SessionManager,
        port: int = PORT,
        *,
        simulated: bool = True,
        more: Mapping[str, Any] | None = None,
        where: PageAddress = PageAddress(),
    ) -> None:
        self._socket = bind_socket(port, where.host)
        self._manager = manager
        token = secrets.token_urlsafe(16)
        self.port = int(self._socket.getsockname()[1])
        participant_token = secrets.token_urlsafe(16) if where.exposed else ""
        self.participant = where.url(self.port) + (f"#{participant_token}" if participant_token else "")
        # Behind the #: browsers keep that to themselves, so it is in no request, no log and no referrer.
        self.experimenter = f"{where.url(self.port, 'experimenter')}#{token}"
        try:
            everything = {"places": places(manager.study), **(more or {})}
            about = describe_study(manager.study, simulated)
            hub = StudySocketHub(manager, token, about, everything, participant_token)
            self._viewers = hub.viewers
            self._server = server(application(hub, where))
        except BaseException:
            self._socket.close()
            raise

    def serve(self) -> int | None:
        """Serve until `close`, SIGINT or SIGTERM; the signal's number is returned.

        Raises ServoError, with the coils off, if the thread that runs the sessions ended by itself.
        """
        signals_seen: list[int] = []

        def end(number: int) -> None:
            signals_seen.append(number)
            self._manager.halt.stop(None)
            self.close()

        before = sys.getswitchinterval()
        sys.setswitchinterval(_SWITCH)
        self._manager.open()
        try:
            with signals(end), prioritize():
                dead = asyncio.run(self._serve())
        finally:
            self._manager.close()
            self._viewers.close()
            sys.setswitchinterval(before)
        if dead:
            raise ServoError(
                f"the thread that runs the sessions ended: {self._manager.trouble}; the coils are off, and all "
                "answers are stored: start again and enter the same code to continue"
            )
        return signals_seen[0] if signals_seen else None

    async def _serve(self) -> bool:
        """Serve until `close`, or until the session's thread has ended; returns whether it was that."""
        serving = asyncio.create_task(self._server.serve(sockets=[self._socket]))
        dead = False
        while not serving.done():
            if dead := self._manager.dead:
                self._manager.halt.stop(None)
                await asyncio.sleep(_LAST_WORDS)  # the pages show it
                self._server.should_exit = True
                break
            await asyncio.sleep(_LOOK)
        await serving
        return dead

    def close(self) -> None:
        """End `serve`; may be called from any thread, and twice."""
        self._server.should_exit = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()
        self._socket.close()


# --------------------------------------------------------------------------------------------------
# The report at an address of this computer: beside each recorded trial a link that plays it, as `haptorb view` does.
#
# The page is plain HTML, so the token stands in its path: who does not know it gets nothing, and plays nothing.


REPORT_SERVER_PORT = 8768  #: unless another is asked for

_HEADERS = {
    "content-security-policy": "default-src 'none'; img-src data:; style-src 'unsafe-inline'; frame-ancestors 'none'",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
    "cache-control": "no-store",
}


@final
class ReportServer:
    """Serves the page `html`; its links `play/N` play the part number N of `parts` (FILE#t=FROM,TO), counted from 0.

    url  where it is, on this computer only. Raises InputError for a `port` that cannot be had.
    """

    def __init__(self, html: str, parts: Sequence[str], port: int = REPORT_SERVER_PORT) -> None:
        self._html, self._parts = html, list(parts)
        self._token, self._troubles = choose_token(), dict[int, str]()
        self._viewers = TrialViewers()
        self._socket = bind_socket(port)
        self.url = f"http://{HOST}:{self._socket.getsockname()[1]}/{self._token}/"
        routes = [Route("/{token}/", self._report), Route("/{token}/play/{number:int}", self._play)]
        self._server = server(Starlette(routes=routes))

    def serve(self, ready: Callable[[], None] = lambda: None) -> int | None:
        """Serve until `close`, SIGINT or SIGTERM, whose number is returned; `ready` is called first."""
        numbers: list[int] = []

        def end(number: int) -> None:
            numbers.append(number)
            self.close()

        try:
            with signals(end):
                ready()
                asyncio.run(self._server.serve(sockets=[self._socket]))
        finally:
            self._viewers.close()
            self._socket.close()
        return numbers[0] if numbers else None

    def close(self) -> None:
        """End `serve`; may be called from any thread, and twice."""
        self._server.should_exit = True

    def _refuse(self, request: Request) -> Response | None:
        refusal = AccessGate.refusal(request.headers)
        known = secrets.compare_digest(request.path_params["token"].encode(), self._token.encode())
        if not known:  # safety: report-token
            refusal = "open the full address that the terminal printed"
        return None if refusal is None else Response(f"{refusal}\n", 403, _HEADERS)

    async def _report(self, request: Request) -> Response:
        return self._refuse(request) or HTMLResponse(self._html, headers=_HEADERS)

    async def _play(self, request: Request) -> Response:
        """Start a viewer, ask the page to come again until it answers, then send it there."""
        if (refusal := self._refuse(request)) is not None:
            return refusal
        number = int(request.path_params["number"])
        if not 0 <= number < len(self._parts):
            return HTMLResponse(_say("There is no such recording.", again=False), 404, _HEADERS)
        part, trouble = self._parts[number], self._troubles.pop(number, "")
        if not trouble:
            try:
                self._viewers.open(part, lambda text: self._troubles.update({number: text}))
            except InputError as cause:
                trouble = str(cause)
        if trouble:
            return HTMLResponse(_say(trouble, again=False), 404, _HEADERS)
        url = self._viewers.urls.get(part, "")
        if url:
            return RedirectResponse(url, 303, _HEADERS)
        return HTMLResponse(_say(f"Opening {Path(part).name} ...", again=True), headers=_HEADERS)


def _say(text: str, *, again: bool) -> str:
    refresh = "<meta http-equiv='refresh' content='1'>" if again else ""
    return (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'><meta name='color-scheme' content='light dark'>"
        f"<title>haptorb</title>{refresh}</head><body><p>{escape(text)}</p></body></html>"
    )
