"""A signal that ends the host is a Stop of the servo, whatever the host is doing at that moment.

Python runs the handler of a signal in the main thread, between two of its own instructions. A host that is inside C
code (a matrix, a database, an import) reacts when that returns. But the first thing that Python's own handler in C does
is to write the signal's number to a file descriptor, `signal.set_wakeup_fd`. Here this is the file of the shared
memory: the loop finds the number there in its next tick, without a thread, a lock or the interpreter's lock in between.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import final

from haptorb.runtime.exchange.shared_memory import SharedMemory, has_end_signal
from haptorb.runtime.realtime.end_signals import END_SIGNALS

__all__ = ["SignalStop"]


@final
class SignalStop:
    """From its creation in the main thread until `close`. Elsewhere, and where the program uses the descriptor for
    another purpose (an event loop with handlers of its own), a Stop waits for the program's own handler.

    stop  is called after the loop has stopped: it makes engage requests from before void
    """

    def __init__(self, shared: SharedMemory, stop: Callable[[], None]) -> None:
        self._shared, self._stop = shared, stop
        self._descriptor = -1
        if threading.current_thread() is not threading.main_thread():
            return
        descriptor = os.open(shared.path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        os.lseek(descriptor, shared.signals_at, os.SEEK_SET)
        before = signal.set_wakeup_fd(descriptor, warn_on_full_buffer=False)  # safety: signal-stop
        if before == -1:
            self._descriptor = descriptor
            for number in END_SIGNALS:
                if signal.getsignal(number) is signal.SIG_DFL:  # else Python's handler in C does not run either
                    signal.signal(number, _end_as_ever)
        else:
            signal.set_wakeup_fd(before, warn_on_full_buffer=False)
            os.close(descriptor)

    def look(self) -> None:
        """Make room for the next signals; to be called some times a second, from any thread."""
        if self._descriptor < 0 or not self._shared.signals[0]:
            return
        if has_end_signal(self._shared.signals):
            self._stop()  # first: the loop must not find neither
        self._shared.signals[0] = 0
        os.lseek(self._descriptor, self._shared.signals_at, os.SEEK_SET)

    def close(self) -> None:
        """Signals are the program's alone again. May be called twice, from any thread."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor < 0:
            return
        if threading.current_thread() is threading.main_thread():
            for number in END_SIGNALS:
                if signal.getsignal(number) is _end_as_ever:
                    signal.signal(number, signal.SIG_DFL)
            now = signal.set_wakeup_fd(-1)
            if now not in (descriptor, -1):  # another part of the program took it meanwhile
                signal.set_wakeup_fd(now, warn_on_full_buffer=False)
            os.close(descriptor)
        else:  # only the main thread may take it back: until then what is written is lost
            nowhere = os.open(os.devnull, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
            os.dup2(nowhere, descriptor, inheritable=False)
            os.close(nowhere)


def _end_as_ever(number: int, frame: FrameType | None) -> None:
    """A program without a handler of its own ends by the signal."""
    signal.signal(number, signal.SIG_DFL)
    signal.raise_signal(number)
