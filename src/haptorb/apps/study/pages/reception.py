"""Runs sessions one after another in a thread of its own: commands of the pages in, one state out.

The thread may wait for the disk, a database far away, or a device that starts; the pages and the pen do not.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, final

from sqlalchemy.engine import Engine

from haptorb.apps.study.conduct import OVER, Conduct
from haptorb.apps.study.sitting import Sitting
from haptorb.apps.study.stage import Stage
from haptorb.apps.study.streams import Streams
from haptorb.apps.study.study_file import Study
from haptorb.errors import HaptorbError, InputError, ServoError
from haptorb.runtime.servo import Servo

__all__ = ["Reception"]

_TICK = 0.02  #: between two looks at the device [s]

#: asked of the reception by a page: tells the page what was wrong, or nothing
Told = Callable[[str], None]


@final
class Reception:
    """One study, one participant at a time.

    state   waiting (for a participant), starting (the device), consent, ready, then those of `Conduct`, or failed
    start   makes the servo of a session, recording to the given file; not yet open
    beside  file for the recording of session number so-and-so; None: no recording
    """

    def __init__(
        self, engine: Engine, study: Study, start: Callable[[Path | None], Servo],
        beside: Callable[[int], Path | None] = lambda session: None, streams: Streams | None = None,
    ) -> None:  # fmt: skip
        self.engine, self.study = engine, study
        self._start, self._beside, self._streams = start, beside, streams
        self.state = "waiting"
        self.trouble = ""  #: why the last session ended as it did
        self.sitting: Sitting | None = None
        self.conduct: Conduct | None = None
        self.stage: Stage | None = None
        self.log: list[dict[str, Any]] = []  #: answered trials of this session, newest last
        self._recording: Path | None = None
        self._servo: Servo | None = None
        self._inbox: SimpleQueue[tuple[dict[str, Any], Told]] = SimpleQueue()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="reception", daemon=True)

    def open(self) -> None:
        """Start listening to `ask`."""
        self._thread.start()

    def close(self) -> None:
        """A session that runs is left, resumable; coils off. May be called twice."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()

    def ask(self, command: dict[str, Any], told: Told) -> None:
        """Obey `command` soon; `told` hears what was wrong with it, if anything was."""
        self._inbox.put((command, told))

    @property
    def now(self) -> str:
        """The state, in one word."""
        conduct = self.conduct  # the thread may put it away meanwhile
        return conduct.state if conduct is not None else self.state

    @property
    def number(self) -> int:
        """Of the session in the database; 0: none."""
        sitting = self.sitting  # the thread may put it away meanwhile
        return sitting.id if sitting is not None else 0

    def _run(self) -> None:
        try:
            while not self._ended.is_set():
                try:
                    command, told = self._inbox.get(timeout=_TICK)
                except Empty:
                    self._tick()
                    continue
                try:
                    self._obey(command)
                except HaptorbError as mistake:
                    told(str(mistake))
                    if isinstance(mistake, ServoError):
                        self._end(str(mistake))
        finally:
            if self.conduct is not None and self.conduct.state not in OVER:
                self._quietly(self.conduct.leave)
            self._end("")

    def _tick(self) -> None:
        if self._servo is None or self.stage is None:
            return
        try:
            self._servo.check()
            if self._streams is not None:
                self._streams.poses(self._servo)
            if self.conduct is not None:
                self.conduct.tick()
                if self.conduct.state in OVER:
                    self._end("", self.conduct.state)
        except HaptorbError as failure:
            # A session whose device or database went away can be resumed, so nothing is lost by ending it here.
            self._end(str(failure))

    def _obey(self, command: dict[str, Any]) -> None:
        do = command["do"]
        if do == "begin":
            self._begin(command["code"])
            return
        if do == "agree":
            self._agree(bool(command.get("agreed", True)))
            return
        conduct = self.conduct
        if do == "leave" and conduct is None and self.sitting is not None:
            self._end("", "left")
            return
        if conduct is None:
            raise InputError("no session is running")
        match do:
            case "answer":
                # Of the trial that the page showed: a second click must not answer the next one.
                if command.get("trial") == conduct.sitting.number:
                    self._answer(conduct, command.get("value"))
            case "reply":
                if conduct.question is not None and command.get("question") == conduct.question.name:
                    conduct.reply(str(command.get("reply", "")))
            case "skip":
                conduct.skip()
            case "interval":
                conduct.interval(command.get("which"))
            case "pause":
                conduct.pause(str(command.get("why", "")))
            case "resume":
                conduct.resume()
            case "repeat":
                conduct.repeat()
            case "engage":
                conduct.engage()
            case "leave":
                conduct.leave()
            case "abort":
                conduct.abort("by the experimenter")
        if conduct.state in OVER:
            self._end("", conduct.state)

    def _begin(self, code: str) -> None:
        """Take a participant in: session claimed, device started, nothing felt yet."""
        if self.sitting is not None:
            raise InputError(f"participant {self.sitting.code} is here: end that session first")
        sitting = Sitting(self.engine, self.study, code.strip())
        if sitting.over:
            sitting.close()
            raise InputError(f"participant '{code}' has answered everything already")
        self.sitting, self.state, self.trouble, self.log = sitting, "starting", "", []
        try:
            self._recording = self._beside(sitting.id)
            servo = self._start(self._recording)
            servo.open()
            stage = Stage(self.study, servo)
            stage.hold()  # the first time loads kernels; afterwards the pen must never be silent that long
            self._servo, self.stage = servo, stage
            self._mark("session", {"session": sitting.id, "participant": sitting.code})
        except HaptorbError as failure:
            self._end(str(failure))
            raise
        self.state = "consent"

    def _agree(self, agreed: bool) -> None:
        if self.state != "consent" or self.sitting is None or self.stage is None or self.conduct is not None:
            raise InputError("nobody is asked for consent now")
        if not agreed:
            self.sitting.note("declined")
            self._end("the participant did not agree", "left")
            return
        self.sitting.note("consent")
        recording = self._recording.name if self._recording is not None else None
        self.conduct = Conduct(self.sitting, self.stage, recording, self._mark)

    def _answer(self, conduct: Conduct, value: Any) -> None:
        prompt, number, seconds = conduct.prompt, conduct.sitting.number, conduct.seconds
        if value is not None and (isinstance(value, bool) or not isinstance(value, int)):
            raise InputError(f"an answer is a whole number; got {value!r}")
        conduct.answer(value)
        trips = [str(trip.get("code")) for trip in conduct.trips if trip["trial"] == number]
        assert prompt is not None
        row = {
            "trial": number, "answer": value, "seconds": round(seconds, 1), "safety": trips, "phase": prompt.phase,
            "set_point": prompt.set_point, "condition": prompt.condition, "level": prompt.level,
            "interval": prompt.interval,
        }  # fmt: skip
        self.log = [*self.log, row]

    def _mark(self, kind: str, facts: dict[str, Any]) -> None:
        if self._streams is not None:
            self._streams.mark(kind, facts)

    def _end(self, trouble: str, state: str = "failed") -> None:
        """Coils off, session given back; what was answered is on the disk already."""
        servo, sitting = self._servo, self.sitting
        self._servo = None
        if servo is not None:
            self._quietly(servo.close)
        if sitting is not None:
            if trouble and state == "failed":
                self._quietly(lambda: sitting.note("failed", trouble))
            self._mark("end", {"state": state})
            self._quietly(sitting.close)
            self.state, self.trouble = state, trouble
        self.sitting = self.conduct = self.stage = None

    @staticmethod
    def _quietly(do: Callable[[], object]) -> None:
        """On the way out one failure must not keep the next step from being taken."""
        try:
            do()
        except HaptorbError:
            return
