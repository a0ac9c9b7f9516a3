"""A session at the terminal from consent to thanks: servo, keys and screen together."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from rich.live import Live
from rich.panel import Panel
from rich.text import Text

from haptorb.apps.study.session.halt import StopSwitch
from haptorb.apps.study.session.keys import END, Keyboard
from haptorb.apps.study.session.screen import Screen
from haptorb.apps.study.session.stored_session import StoredSession
from haptorb.apps.study.session.terminal_session import TerminalSession
from haptorb.apps.study.session.trial_device import TrialDevice
from haptorb.apps.terminal import make_console, say
from haptorb.files.foreign_text import foreign_text, visible
from haptorb.runtime.servo.servo import Servo

__all__ = ["run_session"]


def run_session(session: StoredSession, start: Callable[[Path | None], Servo], recording: Path | None) -> str:
    """'done', 'left' or 'aborted'; coils are off afterwards. `start` makes a servo that records to that file."""
    study, console, halt = session.study, make_console(error=True), StopSwitch()
    with Keyboard(halt) as keys:
        text = Text(visible(f"{study.instructions}\n\n{study.consent}".strip()))
        console.print(Panel(text, title=Text(foreign_text(study.name))), soft_wrap=False)
        say("Press Enter to begin and, if consent is asked above, to agree. q leaves. Space or Esc stops at any time.")
        while (key := keys.next_key(1.0)) != "enter":
            if key in ("q", END):
                session.note("leave")
                return "left"
        say("starting the device ...")
        servo = start(recording)
        halt.attach(servo, keys.asked or halt.ask())  # before it is open: Stop reaches it from here on
        with servo, Live(console=console, auto_refresh=False, screen=sys.stderr.isatty()) as live:
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
