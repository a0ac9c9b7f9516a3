"""Runs sessions one after another in a thread: commands of the pages in, state out."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from time import monotonic
from typing import Any, final

from sqlalchemy.engine import Engine

from haptorb.errors import HaptorbError, InputError, ServoError
from haptorb.runtime.servo import Servo
from haptorb.terminal import notify
from haptorb_study.database import list_participants
from haptorb_study.lsl_streams import Streams
from haptorb_study.participant_codes import next_code
from haptorb_study.stop_switch import StopCount, StopSwitch
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import Study
from haptorb_study.trial_device import TrialDevice
from haptorb_study.trial_runner import OVER, TrialRunner

__all__ = ["CodeList", "SessionManager", "check_text", "explain_fault", "try_step"]


@final
class CodeList:
    """Codes in use and a free one; read by the pages, refreshed by the session thread."""

    def __init__(self, engine: Engine, study: Study) -> None:
        self._engine, self._study = engine, study
        self.taken: tuple[dict[str, Any], ...] = ()  #: code, state, answered; real participants only
        self.free = ""  #: a free code; empty: unknown

    def refresh(self) -> None:
        """Query the database."""
        people = list_participants(self._engine, self._study)
        self.taken = tuple(
            {"code": one.code, "state": one.state, "answered": one.answered} for one in people if not one.simulated
        )
        self.free = next_code(one.code for one in people)


# --------------------------------------------------------------------------------------------------
# Faults while a session is served: reported as text, and never an obstacle to the shutdown.


def check_text(command: Mapping[str, Any], name: str) -> str:
    """Text `name` of a page's `command`, empty if missing; InputError if it is not a text."""
    value = command.get(name, "")
    if not isinstance(value, str):
        raise InputError(f"{name} must be a text; got {type(value).__name__}")
    return value


def explain_fault(fault: BaseException) -> str:
    """Type, message and place of an exception."""
    frames = traceback.extract_tb(fault.__traceback__)
    where = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return f"{type(fault).__name__}: {fault}{where}"


def try_step(do: Callable[[], object]) -> None:
    """Run a shutdown step; an exception is reported, and the shutdown continues."""
    try:
        do()
    except Exception as fault:
        with suppress(OSError, ValueError):  # standard error may be closed
            notify(f"while a session ended: {explain_fault(fault)}")


# --------------------------------------------------------------------------------------------------
# Session thread.
#
# The thread may wait for disk, database or device; the pages, the pen and Stop do not: Stop goes through
# `SessionManager.halt`, which waits for no other thread.


_POLL_INTERVAL_S = 0.02  #: polling interval of the device [s]
_MAX_QUEUED_COMMANDS = 100  #: commands queued at most; a human cannot exceed this

#: reports the mistake in a page's request to the page, if there is one
Respond = Callable[[str], None]


@final
class SessionManager:
    """One study, one participant at a time; commands are executed in a thread of its own.

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
        self.halt = StopSwitch()  #: Stop switch, for every page and thread
        self.state = "waiting"
        self.trouble = ""  #: why the last session failed
        self.session: StoredSession | None = None
        self.runner: TrialRunner | None = None
        self.trial_device: TrialDevice | None = None
        self.log: list[dict[str, Any]] = []  #: answered trials of this session, newest last
        self.codes = CodeList(engine, study)
        self.history: list[dict[str, Any]] = []  #: events of this session, or of the last one
        self.stored = 0  #: stored answers of the last session
        self._recording: Path | None = None
        self._servo: Servo | None = None
        self._queue: SimpleQueue[tuple[dict[str, Any], StopCount, Respond]] = SimpleQueue()
        self._ended = threading.Event()
        self._failure = ""  # why the thread ended unexpectedly
        self._next_poll = 0.0  # next poll of the device
        self._thread = threading.Thread(target=self._run, name="sessions", daemon=True)

    def open(self) -> None:
        """Start the session thread."""
        self._thread.start()

    def close(self) -> None:
        """Switch the coils off; a running session is left and can be resumed. May be called repeatedly."""
        self._ended.set()
        self.halt.stop(None)  # the thread may be waiting for a database
        if self._thread.is_alive():
            self._thread.join()

    @property
    def dead(self) -> bool:
        """Whether the thread has ended unexpectedly: commands would not be executed."""
        return bool(self._failure) and not self._thread.is_alive()

    def enqueue(self, command: dict[str, Any], respond: Respond) -> None:
        """Enqueue `command`; `respond` receives the mistake, if there is one."""
        if self._failure:
            raise InputError(f"the study program has failed and is closing: {self._failure}")
        if self._queue.qsize() >= _MAX_QUEUED_COMMANDS:
            raise InputError("too many commands are queued (is the database locked?): try again in a moment")
        self._queue.put((command, self.halt.read_count(), respond))

    @property
    def now(self) -> str:
        """State of the session; "paused" from the moment of a Stop."""
        runner, session = self.runner, self.session  # the thread may reset them meanwhile
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
        """Number of the session in the database; 0: none."""
        return session.id if (session := self.session) is not None else 0

    def step(self, wait: float = 0.0) -> None:
        """Execute the oldest command, waiting up to `wait` [s] for one, and poll the device."""
        try:
            command, asked, respond = self._queue.get(timeout=wait) if wait > 0 else self._queue.get_nowait()
        except Empty:
            self._next_poll = 0.0
        else:
            self._try(lambda: self._execute(command, asked), respond)
        if monotonic() >= self._next_poll:
            self._next_poll = monotonic() + _POLL_INTERVAL_S
            # A session whose device or database fails can be resumed, so it is ended here.
            self._try(self._tick, None)

    def _run(self) -> None:
        try_step(self.codes.refresh)
        try:
            while not self._ended.is_set():
                self.step(_POLL_INTERVAL_S)
        except BaseException as fault:
            self._failure = f"its thread ended: {explain_fault(fault)}"
        finally:
            self.halt.stop(None)
            runner = self.runner
            if runner is not None and runner.state not in OVER:
                try_step(runner.leave)
            self._end(self._failure, "failed" if self._failure else "left")
            if self._failure:
                self.state, self.trouble = "failed", self._failure

    def _try(self, do: Callable[[], None], respond: Respond | None) -> None:
        """Call `do`, report exceptions; faults, failures of the servo and failures without a page end the session."""
        try:
            do()
        except HaptorbError as mistake:
            if respond is not None:
                respond(str(mistake))
            if respond is None or isinstance(mistake, ServoError):
                self._end(str(mistake))
        except BaseException as fault:  # safety: study-fault
            # Unexpected exception: the session's state is unknown, so switch off; it can be resumed.
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
        """Record Stops before the first trial; later ones are recorded by `TrialRunner`."""
        if self.runner is None and self.session is not None:
            for stopped in self.halt.pop_unrecorded():
                self.session.record_event("pause", stopped.why, at=stopped.at, later=True)
            self.session.store_late_events()

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
                # Answers name their trial: a double click must not answer the next one.
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
        """Open the session, lock it, start the device; no haptic output yet."""
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
            self.halt.attach(servo, asked)  # before it opens: Stop reaches it from here on
            servo.open()
            trial_device = TrialDevice(self.study, servo)
            trial_device.repeat_goal()  # the first call loads kernels, which would take too long later
            trial_device.record(False)  # not recorded before consent
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
            self.session.record_event("declined", later=True)
            self._end("the participant did not agree to take part", "declined")
            return
        if self.halt.active:
            raise InputError("the session is stopped: the experimenter must resume it first")
        self.session.record_event("consent")
        recording = self._recording.name if self._recording is not None else None
        self.runner = TrialRunner(self.session, self.trial_device, recording, self._mark, halt=self.halt)

    def _execute_before_trials(self, do: str, asked: StopCount) -> None:
        """Commands during the request for consent."""
        assert self.session is not None
        if do == "resume":
            if self.halt.active:
                self.halt.engage(asked)
                self.session.record_event("resume", later=True)
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
        """Switch the coils off and release the session; the answers are already stored."""
        servo, session = self._servo, self.session
        self._servo = None
        if servo is not None:
            if state == "failed":
                try_step(servo.stop)  # `close` itself may fail
            try_step(servo.close)
        self.halt.detach()
        if session is not None:
            if trouble and state == "failed":
                try_step(lambda: session.record_event("failed", trouble, later=True))
            try_step(lambda: self._mark("end", {"state": state}))
            self.stored = session.stored
            try_step(session.close)
            try_step(self.codes.refresh)
            self.state, self.trouble = state, trouble
        self.session = self.runner = self.trial_device = None
