"""Say at the terminal, once, which part of a wrench is rendered and what of it cannot be had."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import TYPE_CHECKING

from haptorb.apps.terminal import say

if TYPE_CHECKING:
    from haptorb.runtime.servo.servo import Servo

__all__ = ["tell_part"]

_LOOK = 0.2  #: between two looks [s]: a world that does not say what it asks is found out in its ticks


@contextmanager
def tell_part(servo: Servo) -> Iterator[None]:
    """For as long as the block lasts: a line for each part of the wrench when it is rendered first."""
    from haptorb.worlds.wrench_part import PARTS

    ended, known = Event(), set[str]()

    def look() -> None:
        while True:
            part = servo.rendered_part
            if part is not None and part not in known:
                known.add(part)
                text = servo.part_remarks[PARTS.index(part)] if part != "force" or servo.render else ""
                if text:
                    say(text)
            if ended.wait(_LOOK):
                return

    looking = Thread(target=look, name="rendered part", daemon=True)
    looking.start()
    try:
        yield
    finally:
        ended.set()
        looking.join()
