"""Session at the terminal: key input and screen; stop, repeat, leave and abort at any time."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import final

from rich.live import Live
from rich.panel import Panel
from rich.text import Text

from haptorb.errors import InputError, quote
from haptorb.files import foreign_text, visible
from haptorb.runtime.servo import Servo
from haptorb.terminal import make_console, notify, queue_output
from haptorb_study.keyboard import END, Keyboard, Keys
from haptorb_study.stop_switch import StopSwitch
from haptorb_study.stored_session import StoredSession
from haptorb_study.terminal_screen import Screen, View
from haptorb_study.trial_device import TrialDevice
from haptorb_study.trial_runner import OVER, TrialRunner

__all__ = ["TerminalSession", "run_session"]


_KEEP_ALIVE_INTERVAL_S = 0.02  #: keep-alive interval of the pen's position [s]; it expires after about 50 ms


_PEN_STEP_DEG = 3.0  #: pen motion per arrow key [deg]


_STEER_KEYS = {
    "up": (0.0, _PEN_STEP_DEG),
    "down": (0.0, -_PEN_STEP_DEG),
    "left": (-_PEN_STEP_DEG, 0.0),
    "right": (_PEN_STEP_DEG, 0.0),
}


_WHOLE_NUMBER = re.compile(r"0|-?[1-9][0-9]*")


_DECIMAL_NUMBER = re.compile(r"-?[0-9]+([.,][0-9]+)?")


_MAX_DIGITS = 15  #: significant digits that a float stores exactly


@final
class TerminalSession:
    """Runs `session` to its end, or until it is left; `show` draws a view, about ten times per second.

    `halt` is the stop switch of the servo; None: stopped by keys only.
    """

    def __init__(
        self, session: StoredSession, trial_device: TrialDevice, keys: Keys, show: Callable[[View], None],
        recording: str | None = None, halt: StopSwitch | None = None,
    ) -> None:  # fmt: skip
        self._trial_device, self._keys, self._show = trial_device, keys, show
        self._runner = TrialRunner(session, trial_device, recording, halt=halt)
        self._typed, self._message, self._abort = "", "", False
        self._typed_for: tuple[object, ...] = ()  # trial or question that `_typed` belongs to

    @property
    def writing(self) -> bool:
        """Whether text is being typed, so that a space is a character."""
        return self._runner.state == "question"

    def run(self) -> str:
        """Run the session; returns 'done', 'left' (can be resumed) or 'aborted'."""
        runner = self._runner
        while runner.state not in OVER:
            self._trial_device.refresh()
            runner.tick()
            self._show(View(runner, self._typed, self._message or self._describe_state(), self._abort))
            key = self._keys.next_key(_KEEP_ALIVE_INTERVAL_S)
            if key is not None:
                self._drop_old_text()
                try:
                    self._handle_key(key)
                except InputError as mistake:
                    self._typed, self._message = "", str(mistake)
        return runner.state

    def _drop_old_text(self) -> None:
        """Discard text typed before a Stop, a restart or another trial."""
        runner = self._runner
        now = (runner.session.number, runner.repeats, runner.state in ("running", "time is up"), runner.question)
        if now != self._typed_for:
            self._typed_for, self._typed = now, ""

    def _describe_state(self) -> str:
        """Message for the present state."""
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
        if key in ("escape", "space") and not self.writing:
            self._abort = False
            runner.pause("at the terminal")
        elif self._abort and key != END:
            self._abort = key not in ("y", "n", "enter")  # any other key belongs to a text
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
        elif key in _STEER_KEYS and trial_device.steered:
            trial_device.steer(*_STEER_KEYS[key])
        elif key == "tab" and runner.prompt is not None and runner.prompt.interval:
            runner.interval(3 - runner.which)
        elif key == "e" and runner.state == "device off":
            runner.engage(self._keys.asked)
            self._message = ""
        elif key == "r" and not self._typed:
            runner.repeat()
            self._message = "trial restarted"
        elif key == "back":
            self._typed = self._typed[:-1]
        elif (len(key) == 1 or key == "tab") and runner.state != "device off":
            self._typed += "\t" if key == "tab" else key  # validated at Enter
            self._message = ""

    def _read_number(self) -> int | float | None:
        """Number typed; None: nothing typed. InputError for everything else, and nothing is stored."""
        typed, prompt = self._typed, self._runner.prompt
        if not typed:
            return None
        decimal = prompt is not None and prompt.decimal
        digits = len(re.sub("[^0-9]", "", typed).lstrip("0"))
        if (
            decimal
            and _DECIMAL_NUMBER.fullmatch(typed)
            and not re.search(",[0-9]{3}$", typed)
            and digits <= _MAX_DIGITS
        ):
            return float(typed.replace(",", ".")) if set(",.") & set(typed) else int(typed)
        if not decimal and _WHOLE_NUMBER.fullmatch(typed):
            return int(typed)
        if prompt is not None and not prompt.wants_number:
            raise InputError(f"the position is the answer, with no number: press Enter alone; got {quote(typed)}")
        kind = "a number like 12.5" if decimal else "a whole number"
        raise InputError(f"answer must be {kind}; got {quote(typed)}. Nothing was stored: type it again")

    def _handle_text_key(self, key: str) -> None:
        """Process a key of a reply; choices may be given by number."""
        if key == "enter":
            question = self._runner.question
            self._runner.reply(self._typed if question is None else question.choice_of(self._typed))
            self._typed = self._message = ""
        elif key == "back":
            self._typed = self._typed[:-1]
        elif key in ("space", "tab") or len(key) == 1:
            self._typed += {"space": " ", "tab": "\t"}.get(key, key)
            self._message = ""


# --------------------------------------------------------------------------------------------------
# Session at the terminal from consent to end: servo, keys and screen.


def run_session(session: StoredSession, start: Callable[[Path | None], Servo], recording: Path | None) -> str:
    """Run a session; returns 'done', 'left' or 'aborted', coils off. `start` makes a servo that records to a file."""
    study, console, halt = session.study, make_console(error=True), StopSwitch()
    with Keyboard(halt) as keys:
        text = Text(visible(f"{study.instructions}\n\n{study.consent}".strip()))
        console.print(Panel(text, title=Text(foreign_text(study.name))), soft_wrap=False)
        notify(
            "Press Enter to begin and, if consent is asked above, to agree. q leaves. Space or Esc stops at any time."
        )
        while (key := keys.next_key(1.0)) != "enter":
            if key in ("q", END):
                session.record_event("leave")
                return "left"
        notify("starting the device ...")
        servo = start(recording)
        halt.attach(servo, keys.asked or halt.read_count())  # before it opens: Stop reaches it from here on
        with queue_output(), servo, Live(console=console, auto_refresh=False, screen=sys.stderr.isatty()) as live:
            trial_device = TrialDevice(study, servo)
            drawn = Screen(trial_device, live)

            def show(view: object) -> None:
                drawn(view)  # type: ignore[arg-type]
                if sys.stderr.isatty():
                    live.refresh()

            runner = TerminalSession(session, trial_device, keys, show, recording.name if recording else None, halt)
            keys.writing = lambda: runner.writing
            try:
                return runner.run()
            finally:
                servo.end_loop()
