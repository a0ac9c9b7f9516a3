"""Keyboard input: single keys from a terminal, or the same characters from a pipe.

A thread reads it, so that a stop key works while the session waits for its database.
"""

from __future__ import annotations

import codecs
import os
import re
import select
import signal
import sys
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from queue import Empty, SimpleQueue
from types import TracebackType
from typing import Any, Self, final

from haptorb.runtime.linux import END_SIGNALS
from haptorb_study.stop_switch import StopCount, StopSwitch

__all__ = ["END", "Keyboard", "Keys", "name_keys"]


END = "end"  #: no more keys: the pipe or the terminal is closed

_NAMES = {
    "\x1b[A": "up", "\x1b[B": "down", "\x1b[C": "right", "\x1b[D": "left", "\x1bOA": "up", "\x1bOB": "down",
    "\x1bOC": "right", "\x1bOD": "left", "\n": "enter", "\r": "enter", "\x7f": "back", "\x08": "back", " ": "space",
    "\t": "tab", "\x04": END, "\x1b": "escape",
}  # fmt: skip
_KEY = re.compile(r"\x1b\[[0-?]*[ -/]*[@-~]|\x1bO.|.", re.DOTALL)


def name_keys(typed: str) -> list[str]:
    """Parse the keys in terminal input; unused keys are left out.

    >>> name_keys("1\\x1b[A \\x1b[3~")
    ['1', 'up', 'space']
    """
    found = (_NAMES.get(key, key) for key in _KEY.findall(typed))
    return [key for key in found if not key.startswith("\x1b")]


class Keys(ABC):
    """Source of keys. `asked`: Stop count at the last key; None: read it now."""

    asked: StopCount | None = None

    @abstractmethod
    def next_key(self, wait: float) -> str | None:
        """Next key, None if none arrived within `wait` [s]; special keys by name: up, enter, tab, END ..."""


@final
class Keyboard(Keys):
    """Keyboard on standard input; terminal settings are restored on exit.

    halt     is stopped by Esc, Ctrl-C and, unless `writing()` is true, by space and q, before the key is processed
             otherwise
    """

    def __init__(self, halt: StopSwitch, writing: Callable[[], bool] = lambda: False) -> None:
        self.writing = writing
        self._halt = halt
        self._descriptor = sys.stdin.fileno()
        self._terminal = os.isatty(self._descriptor)
        self._before: list[Any] | None = None
        self._keys: SimpleQueue[tuple[str, StopCount]] = SimpleQueue()
        self._thread = threading.Thread(target=self._read, name="keys", daemon=True)
        self._end, self._ends = -1, -1
        self._signalled, self._signal, self._signal_before = -1, -1, -1

    def __enter__(self) -> Self:
        if self._terminal:
            import termios
            import tty

            self._before = termios.tcgetattr(self._descriptor)
            tty.setcbreak(self._descriptor)
        self._end, self._ends = os.pipe()
        self._signalled, self._signal = os.pipe()
        os.set_blocking(self._signal, False)
        if threading.current_thread() is threading.main_thread():
            # Python's handler of Ctrl-C waits until a database call releases the main thread; this one does not.
            self._signal_before = signal.set_wakeup_fd(self._signal, warn_on_full_buffer=False)
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if threading.current_thread() is threading.main_thread():
            signal.set_wakeup_fd(self._signal_before)
        os.write(self._ends, b".")
        self._thread.join()
        for descriptor in (self._end, self._ends, self._signalled, self._signal):
            os.close(descriptor)
        if self._before is not None:
            import termios

            termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)

    def next_key(self, wait: float) -> str | None:
        """See `Keys.next_key`."""
        try:
            key, self.asked = self._keys.get(timeout=wait)
        except Empty:
            return None
        return key

    def _read(self) -> None:
        decoder = codecs.getincrementaldecoder("utf-8")("replace")  # invalid bytes remain visible
        sources = [self._end, self._signalled, self._descriptor]
        while True:
            ready = select.select(sources, [], [])[0]
            if self._signalled in ready and set(END_SIGNALS) & set(os.read(self._signalled, 64)):
                self._halt.stop(None)
            if self._end in ready:
                return
            if self._descriptor in ready:
                data = os.read(self._descriptor, 64)
                for key in name_keys(decoder.decode(data)) if data else [END]:
                    if self._is_stop(key):
                        self._halt.stop("at the terminal")  # safety: terminal-stop
                    self._keys.put((key, self._halt.read_count()))
                if not data:
                    sources.remove(self._descriptor)

    def _is_stop(self, key: str) -> bool:
        """Whether `key` switches the coils off. The end of a pipe does not: its earlier keys are still executed."""
        return key == "escape" or (key in ("space", "q") and not self.writing()) or (key == END and self._terminal)
