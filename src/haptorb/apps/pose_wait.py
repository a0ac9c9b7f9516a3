"""Say at the terminal what a running servo waits for while its tracker sends no pose, and at the end how they came."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import TYPE_CHECKING, Any

from haptorb.apps.terminal import say

if TYPE_CHECKING:
    from haptorb.runtime.servo.servo import Servo

__all__ = ["describe_tracking", "tell_missing_pose"]

_FIRST = 2.0  #: from the start to the first look [s]
_AGAIN = 10.0  #: between two lines while counts change [s]


@contextmanager
def tell_missing_pose(servo: Servo) -> Iterator[None]:
    """For as long as the block lasts: a line 2 s after the start if no pose is valid, another whenever its counts have
    changed, at most every 10 s."""
    ended = Event()

    def look() -> None:
        last_text, patience = "", _FIRST
        while not ended.wait(patience):
            patience = _FIRST
            text = servo.missing_pose if servo.alive else ""
            if text and text != last_text:
                say(f"{text[0].upper()}{text[1:]}")
                patience = _AGAIN
            last_text = text

    looking = Thread(target=look, name="missing pose", daemon=True)
    looking.start()
    try:
        yield
    finally:
        ended.set()
        looking.join()


def describe_tracking(name: str, poses: dict[str, Any]) -> str:
    """One line on how the poses of the tracker `name` came, from `tracking` of the run's report [Hz, ms]."""
    if not poses["accepted"]:
        text = "no pose accepted"
    else:
        text = f"{poses['accepted']} poses, {poses['rate_hz'] or 0:.0f} Hz"
        if poses["age_ms"]:
            text += f", age in use {poses['age_ms']['p50']:.1f} ms (99 %: {poses['age_ms']['p99']:.1f} ms)"
    refused = ", ".join(f"{count} {why.replace('_', ' ')}" for why, count in poses["refused"].items())
    return f"tracker {name}: {text}, lost {poses['lost']} times" + (f"; refused: {refused}" if refused else "")
