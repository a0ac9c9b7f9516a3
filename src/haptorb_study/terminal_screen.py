"""Terminal screen of a session: task, set-points from above, and the answer so far.

Pen and force are shown only for the simulated device, which renders no force to a participant.
"""

from __future__ import annotations

from math import atan2, cos, degrees, hypot, pi, radians, sin
from time import monotonic
from typing import final

import numpy as np
from rich.console import Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.text import Text

from haptorb_study.prompts import Prompt
from haptorb_study.trial_device import TrialDevice
from haptorb_study.trial_lists import numeric_prompt
from haptorb_study.trial_runner import TrialRunner

__all__ = ["Screen", "View"]


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
