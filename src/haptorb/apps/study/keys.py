"""Keys from the terminal one by one, without waiting for Enter; from a pipe the same characters in order."""

from __future__ import annotations

import os
import select
import sys
from abc import ABC, abstractmethod
from types import TracebackType
from typing import Any, Self, final

__all__ = ["END", "Keyboard", "Keys"]

END = "end"  #: nobody will press a key any more: the pipe or the terminal is closed

_NAMES = {
    "\x1b[A": "up", "\x1b[B": "down", "\x1b[C": "right", "\x1b[D": "left", "\x1bOA": "up", "\x1bOB": "down",
    "\x1bOC": "right", "\x1bOD": "left", "\n": "enter", "\r": "enter", "\x7f": "back", "\x08": "back", " ": "space",
    "\t": "tab", "\x04": END,
}  # fmt: skip


class Keys(ABC):
    """Where keys come from."""

    @abstractmethod
    def pressed(self, wait: float) -> str | None:
        """The next key, or None if there was none within `wait` [s]; special ones by name: up, enter, tab, END ..."""


@final
class Keyboard(Keys):
    """Standard input; a terminal is put back as it was on leaving."""

    def __init__(self) -> None:
        self._descriptor = sys.stdin.fileno()
        self._before: list[Any] | None = None
        self._waiting = ""

    def __enter__(self) -> Self:
        if os.isatty(self._descriptor):
            import termios
            import tty

            self._before = termios.tcgetattr(self._descriptor)
            tty.setcbreak(self._descriptor)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._before is not None:
            import termios

            termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)

    def pressed(self, wait: float) -> str | None:
        """See `Keys.pressed`."""
        if not self._waiting:
            if not select.select([self._descriptor], [], [], wait)[0]:
                return None
            data = os.read(self._descriptor, 64)
            if not data:
                return END
            self._waiting = data.decode("utf-8", "ignore")
        for length in (3, 1):
            head = self._waiting[:length]
            if head in _NAMES or length == 1:
                self._waiting = self._waiting[length:]
                return _NAMES.get(head, head)
        return None
