"""Session at the terminal: key input and screen; stop, repeat, leave and abort at any time."""

from __future__ import annotations

import codecs
import os
import re
import select
import signal
import sys
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from math import atan2, cos, degrees, hypot, pi, radians, sin
from pathlib import Path
from queue import Empty, SimpleQueue
from time import monotonic
from types import TracebackType
from typing import Any, Self, final

import numpy as np
from rich.console import Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.text import Text

from haptorb.errors import InputError, quote
from haptorb.files import foreign_text, visible
from haptorb.runtime.linux import END_SIGNALS
from haptorb.runtime.servo import Servo
from haptorb.terminal import make_console, notify, queue_output
from haptorb_study.prompts import Prompt
from haptorb_study.stop_switch import StopCount, StopSwitch
from haptorb_study.stored_session import StoredSession
from haptorb_study.trial_device import TrialDevice
from haptorb_study.trial_lists import numeric_prompt
from haptorb_study.trial_runner import OVER, TrialRunner

__all__ = ["END", "Keyboard", "Keys", "Screen", "TerminalSession", "View", "name_keys", "run_session"]


# --------------------------------------------------------------------------------------------------
# Keyboard: single keys from a terminal, or the same characters from a pipe. A thread reads it, so that a stop key works
# while the session waits for its database.


END = "end"  #: no more keys: the pipe or the terminal is closed

_NAMES = {
    "\x1b[A": "up", "\x1b[B": "down", "\x1b[C": "right", "\x1b[D": "left", "\x1bOA": "up", "\x1bOB": "down",
    "\x1bOC": "right", "\x1bOD": "left", "\n": "enter", "\r": "enter", "\x7f": "back", "\x08": "back", " ": "space",
    "\t": "tab", "\x04": END, "\x1b": "escape",
}  # fmt: skip
_KEY = re.compile(r"\x1b\[[0-?]*[ -/]*[@-~]|\x1bO.|.", re.DOTALL)


def name_keys(typed: str) -> list[str]:
    """Parse the keys in terminal input; unused keys are left out.

    >>> name_keys("1\\x1b[A \\x1b[3~")
    ['1', 'up', 'space']
    """
    found = (_NAMES.get(key, key) for key in _KEY.findall(typed))
    return [key for key in found if not key.startswith("\x1b")]


class Keys(ABC):
    """Source of keys. `asked`: Stop count at the last key; None: read it now."""

    asked: StopCount | None = None

    @abstractmethod
    def next_key(self, wait: float) -> str | None:
        """Next key, None if none arrived within `wait` [s]; special keys by name: up, enter, tab, END ..."""


@final
class Keyboard(Keys):
    """Keyboard on standard input; terminal settings are restored on exit.

    halt     is stopped by Esc, Ctrl-C and, unless `writing()` is true, by space and q, before the key is processed
             otherwise
    """

    def __init__(self, halt: StopSwitch, writing: Callable[[], bool] = lambda: False) -> None:
        self.writing = writing
        self._halt = halt
        self._descriptor = sys.stdin.fileno()
        self._terminal = os.isatty(self._descriptor)
        self._before: list[Any] | None = None
        self._keys: SimpleQueue[tuple[str, StopCount]] = SimpleQueue()
        self._thread = threading.Thread(target=self._read, name="keys", daemon=True)
        self._end, self._ends = -1, -1
        self._signalled, self._signal, self._signal_before = -1, -1, -1

    def __enter__(self) -> Self:
        if self._terminal:
            import termios
            import tty

            self._before = termios.tcgetattr(self._descriptor)
            tty.setcbreak(self._descriptor)
        self._end, self._ends = os.pipe()
        self._signalled, self._signal = os.pipe()
        os.set_blocking(self._signal, False)
        if threading.current_thread() is threading.main_thread():
            # Python's handler of Ctrl-C waits until a database call releases the main thread; this one does not.
            self._signal_before = signal.set_wakeup_fd(self._signal, warn_on_full_buffer=False)
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if threading.current_thread() is threading.main_thread():
            signal.set_wakeup_fd(self._signal_before)
        os.write(self._ends, b".")
        self._thread.join()
        for descriptor in (self._end, self._ends, self._signalled, self._signal):
            os.close(descriptor)
        if self._before is not None:
            import termios

            termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)

    def next_key(self, wait: float) -> str | None:
        """See `Keys.next_key`."""
        try:
            key, self.asked = self._keys.get(timeout=wait)
        except Empty:
            return None
        return key

    def _read(self) -> None:
        decoder = codecs.getincrementaldecoder("utf-8")("replace")  # invalid bytes remain visible
        sources = [self._end, self._signalled, self._descriptor]
        while True:
            ready = select.select(sources, [], [])[0]
            if self._signalled in ready and set(END_SIGNALS) & set(os.read(self._signalled, 64)):
                self._halt.stop(None)
            if self._end in ready:
                return
            if self._descriptor in ready:
                data = os.read(self._descriptor, 64)
                for key in name_keys(decoder.decode(data)) if data else [END]:
                    if self._is_stop(key):
                        self._halt.stop("at the terminal")  # safety: terminal-stop
                    self._keys.put((key, self._halt.read_count()))
                if not data:
                    sources.remove(self._descriptor)

    def _is_stop(self, key: str) -> bool:
        """Whether `key` switches the coils off. The end of a pipe does not: its earlier keys are still executed."""
        return key == "escape" or (key in ("space", "q") and not self.writing()) or (key == END and self._terminal)


# --------------------------------------------------------------------------------------------------
# Screen: task, set-points from above, and the answer so far. Pen and force are shown only for the simulated device,
# which renders no force to a participant.


@final
class View:
    """State shown to the participant."""

    def __init__(self, runner: TrialRunner, typed: str, message: str, abort: bool) -> None:
        session = runner.session
        self.number, self.left = session.number + 1, session.procedure.expected
        self.prompt = runner.prompt or Prompt()
        self.question = runner.question
        self.typed = typed
        self.which = runner.which  #: interval being rendered
        self.state = "abort?" if abort else runner.state
        self.message = message


_MAP_COLUMNS, _MAP_LINES = 62, 23
_ARROWS = "→↗↑↖←↙↓↘"
_KEY_HELP = "space or Esc STOP · Enter answer · r repeat · e switch on · q leave, to continue later · A abort"


@final
class Screen:
    """Draws into `live`, at most ten times per second."""

    def __init__(self, trial_device: TrialDevice, live: Live) -> None:
        self._trial_device, self._live = trial_device, live
        self._next = 0.0

    def __call__(self, view: View) -> None:
        """Draw `view`, if it is due."""
        if monotonic() >= self._next:
            self._next = monotonic() + 0.1
            self._live.update(self.draw(view))

    def draw(self, view: View) -> RenderableType:
        """Draw the whole screen."""
        prompt, trial_device = view.prompt, self._trial_device
        head = f"trial {view.number}{', practice' if prompt.phase == 'practice' else ''} · {view.left} left"
        if trial_device.simulated:
            head += " · SIMULATED DEVICE"
        parts: list[RenderableType] = []
        if view.question is not None:
            choices = [
                choice if view.question.choice_of(str(n)) != choice else f"{n}: {choice}"
                for n, choice in enumerate(view.question.choices, 1)
            ]
            answer = Text.assemble("answer: ", (view.typed or "_", "bold reverse"))
            parts += [Text(view.question.text, style="bold"), *map(Text, choices), answer]
            if view.message:
                parts.append(Text(view.message, style="bold yellow"))
            return Panel(
                Group(*parts, Text("Enter answers · Esc STOP", style="dim")), title=Text(head), width=_MAP_COLUMNS + 6
            )
        if view.state in ("break", "pause", "device off"):
            early = "; Enter continues" if prompt.pause and view.state == "break" else ""
            word = "" if view.state == "device off" else f"{view.state}: "
            parts.append(Text(f"\n  {word}{view.message}{early}\n", style="bold"))
        else:
            if prompt.interval:
                task = f"interval {view.which} (Tab: the other). In which did it push harder? 1 or 2"
                if prompt.other:
                    task = f"interval {view.which} (Tab: the other). Which do you prefer? 1 or 2"
            elif prompt.high:
                span = f"any number above {prompt.low}" if prompt.decimal else f"{prompt.low} to {prompt.high}"
                task = f"{numeric_prompt(trial_device.study)} {span}"
            elif prompt.wants_number:
                task = "Find the place that pushes; answer with its number"
            else:
                task = "Find the place that pushes; stay there and press Enter"
            parts += [Text(task, style="bold"), self._map()]
            if prompt.wants_number:
                parts.append(Text.assemble("answer: ", (view.typed or "_", "bold reverse")))
            notice = "abort the session permanently? y aborts, n continues" if view.state == "abort?" else view.message
            if notice:
                parts.append(Text(notice, style="bold yellow"))
        steer = "arrow keys move the pen · " if trial_device.steered else ""
        return Panel(Group(*parts, Text(steer + _KEY_HELP, style="dim")), title=Text(head), width=_MAP_COLUMNS + 6)

    def _map(self) -> RenderableType:
        """Dome seen from above, +x to the right; the rim is the limit of the workspace."""
        trial_device = self._trial_device
        field = [[" "] * _MAP_COLUMNS for _ in range(_MAP_LINES)]

        def put(theta: float, phi: float, text: str) -> None:
            r = theta / trial_device.limit
            column = round((_MAP_COLUMNS - 3) / 2 * (1 + r * cos(phi) * 0.95))
            line = round((_MAP_LINES - 1) / 2 * (1 - r * sin(phi)))
            for n, letter in enumerate(text):
                if 0 <= line < _MAP_LINES and 0 <= column + n < _MAP_COLUMNS:
                    field[line][column + n] = letter

        for n in range(72):
            put(trial_device.limit, n * pi / 36, "·")
        for point in trial_device.study.points:
            put(point.theta_deg, radians(point.phi_deg), str(point.number))
        text = ""
        position, force = trial_device.position, trial_device.force
        if trial_device.simulated and position is not None:
            x, y, z = position
            put(degrees(atan2(hypot(x, y), z)), atan2(y, x), "◆")
            if force is not None:
                way = np.array(position) / np.linalg.norm(position)
                out = float(force @ way)
                aside = force - out * way
                size = float(np.linalg.norm(aside))
                arrow = _ARROWS[round(4 * atan2(aside[1], aside[0]) / pi) % 8] if size > 0.02 else "·"
                text = f"\noutward {out:+.2f} N {'█' * max(0, round(20 * out)):<14} sideways {size:.2f} N {arrow}"
        return Text("\n".join("".join(line) for line in field) + text)


# --------------------------------------------------------------------------------------------------
# The session, one tick after another.


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
