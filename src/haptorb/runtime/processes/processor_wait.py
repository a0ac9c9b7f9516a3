"""Whether a process that shows no life waits for its turn on a busy computer: what the kernel says of its threads."""

from __future__ import annotations

import os
import time
from typing import final

__all__ = ["ProcessorWait"]

_SHARE = 0.5  #: of a processor; a process that gets more computes [1]


@final
class ProcessorWait:
    """Watches the process `pid`, of the same user.

    One of its threads is ready to run ("R" in /proc/PID/task/TID/stat), and yet the whole process got less than half of
    a processor: it waits. One look takes 20 to 50 µs a thread up to the first that is ready.
    """

    def __init__(self, pid: int) -> None:
        self._threads = f"/proc/{pid}/task"
        self._clock = (~pid << 3) | 2  # as clock_getcpuclockid(3) makes it: time on a processor, of all threads
        self._last, self._used = 0, 0
        self._ready = ""  # the thread that was ready in the last look

    def look(self, now: int) -> bool:
        """Whether it has waited since the last look; `now` on the monotonic clock [ns]. False for the first."""
        try:
            used = time.clock_gettime_ns(self._clock)
        except OSError:
            return False
        passed, computed = now - self._last, used - self._used
        known, self._last, self._used = self._last > 0, now, used
        return known and computed < _SHARE * passed and self._is_ready()

    def _is_ready(self) -> bool:
        """Whether a thread has, or waits for, a processor."""
        try:
            names = os.listdir(self._threads)
        except OSError:
            return False
        if self._ready in names:
            names.insert(0, self._ready)
        self._ready = next((name for name in names if self._state(name) == b"R"), "")
        return bool(self._ready)

    def _state(self, name: str) -> bytes:
        try:
            file = os.open(f"{self._threads}/{name}/stat", os.O_RDONLY | os.O_CLOEXEC)
        except OSError:
            return b""
        try:
            return os.read(file, 512).rpartition(b")")[2][1:2]
        except OSError:
            return b""
        finally:
            os.close(file)
