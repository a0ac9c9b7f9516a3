"""A session at the terminal: keys in, a view of it out; stop, repeat, leave, abort at any time."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import final

from haptorb.apps.asking.prompt import Prompt
from haptorb.apps.study.session.halt import StopSwitch
from haptorb.apps.study.session.keys import END, Keys
from haptorb.apps.study.session.stored_session import StoredSession
from haptorb.apps.study.session.trial_device import TrialDevice
from haptorb.apps.study.session.trial_runner import OVER, TrialRunner
from haptorb.errors import InputError, quote

__all__ = ["TerminalSession", "View"]

_TICK = 0.02  #: interval at which the pen's position is repeated [s]; it expires after some 50 ms
_STEP = 3.0  #: an arrow key moves the pen by so much [deg]
_STEER = {"up": (0.0, _STEP), "down": (0.0, -_STEP), "left": (-_STEP, 0.0), "right": (_STEP, 0.0)}
_WHOLE = re.compile(r"0|-?[1-9][0-9]*")
_DECIMAL = re.compile(r"-?[0-9]+([.,][0-9]+)?")
_DIGITS = 15  #: significant ones, that a float holds exactly


@final
class View:
    """What the participant sees now."""

    def __init__(self, runner: TrialRunner, typed: str, message: str, abort: bool) -> None:
        session = runner.session
        self.number, self.left = session.number + 1, session.procedure.expected
        self.prompt = runner.prompt or Prompt()
        self.question = runner.question
        self.typed = typed
        self.which = runner.which  #: interval that is felt
        self.state = "abort?" if abort else runner.state
        self.message = message


@final
class TerminalSession:
    """Runs `session` to its end, or until the person leaves; `show` draws a view, some ten times a second.

    `halt` knows the servo, and which Stop is active; None: only the keys stop.
    """

    def __init__(
        self, session: StoredSession, trial_device: TrialDevice, keys: Keys, show: Callable[[View], None],
        recording: str | None = None, halt: StopSwitch | None = None,
    ) -> None:  # fmt: skip
        self._trial_device, self._keys, self._show = trial_device, keys, show
        self._runner = TrialRunner(session, trial_device, recording, halt=halt)
        self._typed, self._message, self._abort = "", "", False
        self._of: tuple[object, ...] = ()  # the trial, or the question, in which `_typed` was typed

    @property
    def writing(self) -> bool:
        """Whether words are being typed, in which a space is a space."""
        return self._runner.state == "question"

    def run(self) -> str:
        """'done', 'left' (the session can be resumed) or 'aborted'."""
        runner = self._runner
        while runner.state not in OVER:
            self._trial_device.refresh()
            runner.tick()
            self._show(View(runner, self._typed, self._message or self._describe_state(), self._abort))
            key = self._keys.next_key(_TICK)
            if key is not None:
                self._drop_old_text()
                try:
                    self._handle_key(key)
                except InputError as mistake:
                    self._typed, self._message = "", str(mistake)
        return runner.state

    def _drop_old_text(self) -> None:
        """What was typed before a Stop, a restart or another trial is no part of what is typed now."""
        runner = self._runner
        now = (runner.session.number, runner.repeats, runner.state in ("running", "time is up"), runner.question)
        if now != self._of:
            self._of, self._typed = now, ""

    def _describe_state(self) -> str:
        """What there is to say of the present state."""
        match self._runner.state:
            case "pause" | "break":
                return f"{self._runner.rest_left:.0f} s"
            case "paused":
                return "STOPPED: the coils are off. e continues, q ends for now, A aborts"
            case "time is up":
                return "time is up: please answer now"
            case "device off":
                return "the device is off: please wait. e switches it on again; the trial then starts again"
        return ""

    def _handle_key(self, key: str) -> None:
        runner = self._runner
        if self._abort:
            self._abort = False
            if key == "y":
                runner.abort("by the experimenter, at the terminal")
        elif key == "escape":
            runner.pause("at the terminal")
        elif runner.state == "question" and key != END:
            self._handle_text_key(key)
        elif key in ("q", END):
            runner.leave()
        elif key == "A":
            self._abort, self._typed = True, ""
        elif key == "space":
            runner.pause("at the terminal")
        elif key == "e" and runner.state == "paused":
            runner.resume(self._keys.asked)
            self._message = ""
        elif runner.state == "break" and key == "enter":
            runner.skip()
        elif runner.state in ("running", "time is up", "device off"):
            self._handle_trial_key(key)

    def _handle_trial_key(self, key: str) -> None:
        runner, trial_device = self._runner, self._trial_device
        if key == "enter":
            runner.answer(self._read_number())
            self._typed = self._message = ""
        elif key in _STEER and trial_device.steered:
            trial_device.steer(*_STEER[key])
        elif key == "tab" and runner.prompt is not None and runner.prompt.interval:
            runner.interval(3 - runner.which)
        elif key == "e" and (not self._typed or runner.state == "device off"):
            runner.engage(self._keys.asked)
            self._message = ""
        elif key == "r" and not self._typed:
            runner.repeat()
            self._message = "trial restarted"
        elif key == "back":
            self._typed = self._typed[:-1]
        elif (len(key) == 1 or key == "tab") and runner.state != "device off":
            self._typed += "\t" if key == "tab" else key  # whatever it is: Enter says what is no answer
            self._message = ""

    def _read_number(self) -> int | float | None:
        """The number that was typed; None: nothing was. InputError for everything else, and nothing is stored."""
        typed, prompt = self._typed, self._runner.prompt
        if not typed:
            return None
        decimal = prompt is not None and prompt.decimal
        digits = len(re.sub("[^0-9]", "", typed).lstrip("0"))
        if decimal and _DECIMAL.fullmatch(typed) and not re.search(",[0-9]{3}$", typed) and digits <= _DIGITS:
            return float(typed.replace(",", ".")) if set(",.") & set(typed) else int(typed)
        if not decimal and _WHOLE.fullmatch(typed):
            return int(typed)
        if prompt is not None and not prompt.wants_number:
            raise InputError(f"the position is the answer, with no number: press Enter alone; got {quote(typed)}")
        kind = "a number like 12.5" if decimal else "a whole number"
        raise InputError(f"answer must be {kind}; got {quote(typed)}. Nothing was stored: type it again")

    def _handle_text_key(self, key: str) -> None:
        """A key while a question is answered in words; choices may be given by their number."""
        if key == "enter":
            question = self._runner.question
            self._runner.reply(self._typed if question is None else question.choice_of(self._typed))
            self._typed = self._message = ""
        elif key == "back":
            self._typed = self._typed[:-1]
        elif key in ("space", "tab") or len(key) == 1:
            self._typed += {"space": " ", "tab": "\t"}.get(key, key)
            self._message = ""
