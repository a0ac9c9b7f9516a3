"""What ends a tick that does not end by itself."""

from __future__ import annotations

__all__ = ["TickTimeout"]


class TickTimeout(BaseException):
    """Raised by a signal's handler inside a tick that takes too long.

    No `Exception`: user code that goes on after whatever it caught would catch it, and hang again in the next tick.
    """
