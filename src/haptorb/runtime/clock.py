"""Waiting for an absolute deadline: the kernel's sleep to shortly before it, then a short spin.

`time.sleep` comes back 80 µs late; a sleep to an absolute time that ends early, and a spin over what is left, is a
few microseconds late. The spin is a small part of the period at any rate: whoever spins a whole period under a
real-time scheduler is throttled by the kernel for 50 ms and more.
"""

from __future__ import annotations

import ctypes
import errno
from time import monotonic_ns
from typing import final

from haptorb.runtime.schedule import Schedule

__all__ = ["Clock"]

_CLOCK_MONOTONIC = 1
_TIMER_ABSTIME = 1
_SPIN = 60_000  #: longest spin [ns]


class _Timespec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


_sleep = ctypes.CDLL(None, use_errno=False).clock_nanosleep
_sleep.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
_sleep.restype = ctypes.c_int


@final
class Clock:
    """Deadlines at a fixed rate on the computer's monotonic clock; the first is one period from now."""

    def __init__(self, rate: float) -> None:
        self.schedule = Schedule(rate, 0)
        self.schedule.origin = monotonic_ns() + self.schedule.period
        self._spin = min(_SPIN, self.schedule.period // 8)
        self._until = _Timespec()  # one for the life of the loop: nothing is allocated per tick
        self._at = ctypes.addressof(self._until)

    def wait(self) -> tuple[int, int, int]:
        """Wait for the next deadline, signals or not; returns (now [ns], lateness [ns], deadlines skipped)."""
        deadline = self.schedule.next(monotonic_ns())
        until = self._until
        until.seconds, until.nanoseconds = divmod(deadline - self._spin, 1_000_000_000)
        while _sleep(_CLOCK_MONOTONIC, _TIMER_ABSTIME, self._at, None) == errno.EINTR:
            pass
        now = monotonic_ns()
        while now < deadline:
            now = monotonic_ns()
        lateness, skipped = self.schedule.begin(now)
        return now, lateness, skipped
