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

    def __init__(self, conduct: TrialRunner, typed: str, message: str, abort: bool) -> None:
        sitting = conduct.sitting
        self.number, self.left = sitting.number + 1, sitting.procedure.expected
        self.prompt = conduct.prompt or Prompt()
        self.question = conduct.question
        self.typed = typed
        self.which = conduct.which  #: interval that is felt
        self.state = "abort?" if abort else conduct.state
        self.message = message


@final
class TerminalSession:
    """Runs `sitting` to its end, or until the person leaves; `show` draws a view, some ten times a second.

    `halt` knows the stage's servo, and which Stop is active; None: only the keys stop.
    """

    def __init__(
        self, sitting: StoredSession, stage: TrialDevice, keys: Keys, show: Callable[[View], None],
        recording: str | None = None, halt: StopSwitch | None = None,
    ) -> None:  # fmt: skip
        self._stage, self._keys, self._show = stage, keys, show
        self._conduct = TrialRunner(sitting, stage, recording, halt=halt)
        self._typed, self._message, self._abort = "", "", False

    @property
    def writing(self) -> bool:
        """Whether words are being typed, in which a space is a space."""
        return self._conduct.state == "question"

    def run(self) -> str:
        """'done', 'left' (the session can be resumed) or 'aborted'."""
        conduct = self._conduct
        while conduct.state not in OVER:
            self._stage.refresh()
            conduct.tick()
            self._show(View(conduct, self._typed, self._message or self._describe_state(), self._abort))
            key = self._keys.next_key(_TICK)
            if key is not None:
                try:
                    self._handle_key(key)
                except InputError as mistake:
                    self._typed, self._message = "", str(mistake)
        return conduct.state

    def _describe_state(self) -> str:
        """What there is to say of the present state."""
        match self._conduct.state:
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
        conduct = self._conduct
        if self._abort:
            self._abort = False
            if key == "y":
                conduct.abort("by the experimenter, at the terminal")
        elif key == "escape":
            conduct.pause("at the terminal")
        elif conduct.state == "question" and key != END:
            self._handle_text_key(key)
        elif key in ("q", END):
            conduct.leave()
        elif key == "A":
            self._abort = True
        elif key == "space":
            conduct.pause("at the terminal")
        elif key == "e" and conduct.state == "paused":
            conduct.resume(self._keys.asked)
            self._message = ""
        elif conduct.state == "break" and key == "enter":
            conduct.skip()
        elif conduct.state in ("running", "time is up", "device off"):
            self._handle_trial_key(key)

    def _handle_trial_key(self, key: str) -> None:
        conduct, stage = self._conduct, self._stage
        if key == "enter":
            conduct.answer(_read_number(self._typed) if self._typed else None)
            self._typed = self._message = ""
        elif key in _STEER and stage.steered:
            stage.steer(*_STEER[key])
        elif key == "tab" and conduct.prompt is not None and conduct.prompt.interval:
            conduct.interval(3 - conduct.which)
        elif key == "e":
            conduct.engage(self._keys.asked)
            self._message = ""
        elif key == "r":
            conduct.repeat()
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
            question = self._conduct.question
            text = self._typed
            if question is not None and question.choices and text.isdecimal() and 1 <= int(text) <= len(
                question.choices
            ):  # fmt: skip
                text = question.choices[int(text) - 1]
            self._conduct.reply(text)
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
