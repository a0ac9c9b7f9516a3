"""Say at the terminal what a running servo waits for while its tracker sends no pose."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import TYPE_CHECKING

from haptorb.apps.terminal import say

if TYPE_CHECKING:
    from haptorb.runtime.servo.servo import Servo

__all__ = ["tell_missing_pose"]

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
