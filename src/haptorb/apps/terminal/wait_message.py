"""The message while a command waits for another package's code."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Timer

from haptorb.apps.terminal.console import say

__all__ = ["announce_wait"]

_AFTER = 2.0  #: no message sooner [s]


@contextmanager
def announce_wait(message: str) -> Iterator[None]:
    """Say `message` on standard error if the block takes longer than 2 s, and that Ctrl-C ends it."""
    timer = Timer(_AFTER, say, [f"{message} for {_AFTER:g} s; still waiting. Ctrl-C ends."])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
