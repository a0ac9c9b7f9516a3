"""Waiting for an absolute deadline: the kernel's sleep to shortly before it, then a short spin.

`time.sleep` comes back 80 µs late; a sleep to an absolute time that ends early, and a spin over what is left, is a
few microseconds late. What can be done before the deadline is done between the two. The spin is a small part of the
period at any rate: a thread that spins a whole period under a real-time scheduler is throttled by the kernel for 50 ms
and more.
"""

from __future__ import annotations

import ctypes
import errno
from time import monotonic_ns
from typing import final

from haptorb.runtime.realtime.schedule import Schedule

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
    """Deadlines at a fixed rate on the computer's monotonic clock; the first is one period from now.

    `lead` [s]: how long before each deadline the sleep ends, if a quarter of the period is not shorter.
    """

    def __init__(self, rate: float, lead: float = 0.0) -> None:
        self.schedule = Schedule(rate, 0)
        self.schedule.origin = monotonic_ns() + self.schedule.period
        self._early = max(min(_SPIN, self.schedule.period // 8), min(int(lead * 1e9), self.schedule.period // 4))
        self._deadline = self.schedule.origin
        self._until = _Timespec()  # one for the life of the loop: nothing is allocated per tick
        self._at = ctypes.addressof(self._until)

    def sleep(self) -> float:
        """Sleep until shortly before the next deadline, signals or not; returns it on the loop's clock [s]."""
        schedule, until = self.schedule, self._until
        self._deadline = deadline = schedule.next(monotonic_ns())
        until.seconds, until.nanoseconds = divmod(deadline - self._early, 1_000_000_000)
        while _sleep(_CLOCK_MONOTONIC, _TIMER_ABSTIME, self._at, None) == errno.EINTR:
            pass
        return schedule.time(deadline)

    def wait(self) -> tuple[int, int, int]:
        """Wait for the deadline that `sleep` returned; returns (now [ns], lateness [ns], deadlines missed)."""
        deadline = self._deadline
        now = monotonic_ns()
        while now < deadline:
            now = monotonic_ns()
        lateness, skipped = self.schedule.begin(now)
        return now, lateness, skipped
