"""What ends a tick that does not end by itself."""

from __future__ import annotations

__all__ = ["TickTimeout"]


class TickTimeout(BaseException):
    """Raised by a signal's handler inside a tick that takes too long.

    No `Exception`: user code that continues after any exception would catch it, and hang again in the next tick.
    """
