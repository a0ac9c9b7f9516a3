"""A session at the terminal: what to do, what is felt, the answer typed; pause, repeat, leave, abort at any time."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic
from typing import final

from haptorb.apps.study.keys import END, Keys
from haptorb.apps.study.prompt import Answer, Prompt
from haptorb.apps.study.sitting import Sitting
from haptorb.apps.study.stage import Stage
from haptorb.errors import InputError

__all__ = ["Runner", "View"]

_TICK = 0.02  #: the pen's place is said anew so often [s]; a device forgets it after some 50 ms
_STEP = 3.0  #: an arrow key moves the pen by so much [deg]
_STEER = {"up": (0.0, _STEP), "down": (0.0, -_STEP), "left": (-_STEP, 0.0), "right": (_STEP, 0.0)}


@final
class View:
    """What the participant sees now."""

    def __init__(self, sitting: Sitting, prompt: Prompt) -> None:
        self.number, self.left = sitting.number + 1, sitting.procedure.expected
        self.prompt = prompt
        self.typed = ""
        self.which = 1  #: interval that is felt
        self.state = "running"  #: running, paused, break, time is up, off, abort?
        self.message = ""


@final
class Runner:
    """Runs `sitting` to its end, or until somebody leaves; `show` draws a view, some ten times a second."""

    def __init__(
        self, sitting: Sitting, stage: Stage, keys: Keys, show: Callable[[View], None], recording: str | None = None
    ) -> None:
        self._sitting, self._stage, self._keys, self._show = sitting, stage, keys, show
        self._recording = recording

    def run(self) -> str:
        """'done', 'left' (the session can be resumed) or 'aborted'."""
        while (prompt := self._sitting.prompt) is not None:
            view = View(self._sitting, prompt)
            ended = self._between(view) or self._trial(view)
            if ended:
                return ended
        self._stage.rest()
        return "done"

    def _between(self, view: View) -> str:
        """Rest before a trial; Enter cuts a break short, though not a pause of the study file's."""
        trials = self._sitting.study.trials
        wait = view.prompt.pause or (trials.pause_seconds if self._sitting.number else 0.0)
        self._stage.rest()
        end = monotonic() + wait
        while (left := end - monotonic()) > 0:
            view.state = "break" if view.prompt.pause else "pause"
            view.message = f"{left:.0f} s"
            key = self._tick(view)
            if key in ("q", END):
                return self._leave()
            if key == "enter" and view.prompt.pause:
                break
        view.state, view.message = "running", ""
        return ""

    def _trial(self, view: View) -> str:
        """One trial, until its answer is on the disk ('') or the session ends."""
        stage, prompt = self._stage, view.prompt
        stage.begin(prompt)
        limit = self._sitting.study.trials.time_limit
        felt = 0.0  # time in the trial without pauses [s]
        last = monotonic()
        while True:
            key = self._tick(view)
            now = monotonic()
            felt += now - last if view.state != "paused" else 0.0
            last = now
            if limit is not None and felt > limit and view.state == "running":
                stage.rest()
                view.state, view.message = "time is up", "time is up: please answer now"
            if view.state == "running" and stage.off:
                view.message = "the device is off: press e to switch it on again"
            if key is None:
                continue
            if view.state == "abort?":
                if key == "y":
                    stage.rest()
                    self._sitting.abort("by the experimenter, at the terminal")
                    return "aborted"
                view.state, view.message = "running", ""
            elif key in ("q", END):
                return self._leave()
            elif key == "enter":
                if self._answered(view, felt):
                    return ""
            else:
                self._pressed(view, key)

    def _pressed(self, view: View, key: str) -> None:
        stage, prompt = self._stage, view.prompt
        if key == "space":
            if view.state == "paused":
                stage.servo.engage()
                view.state, view.message = "running", ""
                self._sitting.note("resume")
            else:
                stage.servo.stop()
                view.state, view.message = "paused", "paused: coils are off; space goes on"
                self._sitting.note("pause")
        elif view.state == "paused":
            return
        elif key in _STEER and stage.steered:
            stage.steer(*_STEER[key])
        elif key == "tab" and prompt.interval:
            view.which = 3 - view.which
            stage.interval(prompt, view.which)
        elif key == "e":
            stage.servo.engage()
            view.message = ""
        elif key == "r":
            self._sitting.note("repeat")
            view.typed, view.which, view.state, view.message = "", 1, "running", "from the beginning"
            stage.interval(prompt, 1)
        elif key == "A":
            view.state, view.message = "abort?", "abort for good? y aborts, any other key goes on"
        elif key == "back":
            view.typed = view.typed[:-1]
        elif key.isdigit() and key.isascii() and len(view.typed) < 4:
            view.typed += key
            view.message = ""

    def _answered(self, view: View, seconds: float) -> bool:
        """Whether the answer was kept; else the view says what was wrong with it."""
        if view.state == "paused":
            return False
        value = int(view.typed) if view.typed else None
        try:
            if value is None and view.prompt.wants_number:
                raise InputError("type the number first, then press Enter")
            stage = self._stage
            # Pauses switch the coils off by hand, which is no safety event.
            trips = [trip for trip in stage.safety() if trip.get("code") != "STOPPED"]
            answer = Answer(value, stage.position, seconds)
            self._sitting.answer(answer, safety=trips, recording=stage.course(self._recording))
        except InputError as mistake:
            view.typed, view.message = "", str(mistake)
            return False
        return True

    def _leave(self) -> str:
        self._sitting.note("leave")
        self._stage.rest()
        return "left"

    def _tick(self, view: View) -> str | None:
        self._stage.refresh()
        self._show(view)
        return self._keys.pressed(_TICK)
