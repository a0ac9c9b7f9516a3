"""A session at the terminal from consent to thanks: servo, keys and screen together."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.live import Live
from rich.panel import Panel

from haptorb.apps.study.keys import END, Keyboard
from haptorb.apps.study.runner import Runner
from haptorb.apps.study.screen import Screen
from haptorb.apps.study.sitting import Sitting
from haptorb.apps.study.stage import Stage
from haptorb.runtime.servo import Servo

__all__ = ["hold"]


def hold(sitting: Sitting, start: Callable[[Path | None], Servo], recording: Path | None) -> str:
    """'done', 'left' or 'aborted'; coils are off afterwards. `start` makes a servo that records to that file."""
    study, console = sitting.study, Console(stderr=True)
    with Keyboard() as keys:
        console.print(Panel(f"{study.instructions}\n\n{study.consent}".strip(), title=study.name))
        console.print("Enter begins and, where something is asked above, says yes. q leaves.")
        while (key := keys.pressed(1.0)) != "enter":
            if key in ("q", END):
                sitting.note("leave")
                return "left"
        console.print("starting the device ...")
        with start(recording) as servo, Live(console=console, auto_refresh=False, screen=sys.stderr.isatty()) as live:
            stage = Stage(study, servo)
            drawn = Screen(stage, live)

            def show(view: object) -> None:
                drawn(view)  # type: ignore[arg-type]
                if sys.stderr.isatty():
                    live.refresh()

            return Runner(sitting, stage, keys, show, str(recording) if recording else None).run()
