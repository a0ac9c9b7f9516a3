"""A session at the terminal: keys in, a view of it out; stop, repeat, leave, abort at any time."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

from haptorb.apps.asking.prompt import Prompt
from haptorb.apps.study.session.halt import StopSwitch
from haptorb.apps.study.session.keys import END, Keys
from haptorb.apps.study.session.stored_session import StoredSession
from haptorb.apps.study.session.trial_device import TrialDevice
from haptorb.apps.study.session.trial_runner import OVER, TrialRunner
from haptorb.errors import InputError

__all__ = ["TerminalSession", "View"]

_TICK = 0.02  #: interval at which the pen's position is repeated [s]; it expires after some 50 ms
_STEP = 3.0  #: an arrow key moves the pen by so much [deg]
_STEER = {"up": (0.0, _STEP), "down": (0.0, -_STEP), "left": (-_STEP, 0.0), "right": (_STEP, 0.0)}
_TYPED = 9  #: characters of a number at most; words may be longer


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
                try:
                    self._handle_key(key)
                except InputError as mistake:
                    self._typed, self._message = "", str(mistake)
        return runner.state

    def _describe_state(self) -> str:
        """What there is to say of the present state."""
        match self._runner.state:
            case "pause" | "break":
                return f"{self._conduct.rest_left:.0f} s"
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
            self._abort = True
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
            runner.answer(_read_number(self._typed) if self._typed else None)
            self._typed = self._message = ""
        elif key in _STEER and trial_device.steered:
            trial_device.steer(*_STEER[key])
        elif key == "tab" and runner.prompt is not None and runner.prompt.interval:
            runner.interval(3 - runner.which)
        elif key == "e":
            runner.engage(self._keys.asked)
            self._message = ""
        elif key == "r":
            runner.repeat()
            self._typed, self._message = "", "trial restarted"
        elif key == "back":
            self._typed = self._typed[:-1]
        elif ((key.isdigit() and key.isascii()) or key in self._points) and len(self._typed) < _TYPED:
            self._typed += key
            self._message = ""

    @property
    def _points(self) -> str:
        """Keys of a decimal point, where there may be one."""
        prompt = self._conduct.prompt
        return ".," if prompt is not None and prompt.decimal and not set(".,") & set(self._typed) else ""

    def _handle_text_key(self, key: str) -> None:
        """A key while a question is answered in words; choices may be given by their number."""
        if key == "enter":
            question = self._runner.question
            text = self._typed
            if question is not None and question.choices and text.isdecimal() and 1 <= int(text) <= len(
                question.choices
            ):  # fmt: skip
                text = question.choices[int(text) - 1]
            self._runner.reply(text)
            self._typed = self._message = ""
        elif key == "back":
            self._typed = self._typed[:-1]
        elif key == "space" or len(key) == 1:
            self._typed += " " if key == "space" else key
            self._message = ""


def _read_number(typed: str) -> int | float:
    """The number that was typed; InputError for a point alone."""
    if typed.isdecimal():
        return int(typed)
    try:
        return float(typed.replace(",", "."))
    except ValueError as cause:
        raise InputError(f"answer must be a number; got '{typed}'") from cause
