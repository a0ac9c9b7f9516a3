"""Waits for an absolute deadline: a kernel sleep until shortly before it, then a short spin.

`time.sleep` returns 80 µs late; a sleep to an absolute time that ends early, and a spin over the remaining time, is a
few microseconds late. Work that needs no deadline is done between the two. The spin is always a small part of the
period: a thread that spins a whole period under a real-time scheduler is throttled by the kernel for 50 ms
and more. Systems other than Linux have no such sleep: there a relative one ends half a period early, at most a
millisecond, and the spin over the rest costs processor time.
"""

from __future__ import annotations

import math
from time import monotonic_ns, sleep
from typing import final

from haptorb.errors import InputError
from haptorb.runtime.linux import AbsoluteSleep, is_linux

__all__ = ["MAX_RATE_HZ", "MIN_RATE_HZ", "Clock", "Schedule", "check_rate"]


# --------------------------------------------------------------------------------------------------
# Schedule of absolute deadlines in integer nanoseconds; it reads no clock.


MIN_RATE_HZ = 50.0  #: [Hz]
MAX_RATE_HZ = 4000.0  #: [Hz]


def check_rate(rate: float) -> float:
    """Return `rate` [Hz]; raise InputError if it is outside the valid range.

    >>> check_rate(1000)
    1000.0
    """
    if isinstance(rate, bool) or not isinstance(rate, int | float) or not math.isfinite(rate):
        raise InputError(f"rate must be a finite number of hertz; got {rate!r}")
    if not MIN_RATE_HZ <= rate <= MAX_RATE_HZ:
        raise InputError(f"rate must lie between {MIN_RATE_HZ:g} and {MAX_RATE_HZ:g} Hz; got {rate:g}")
    return float(rate)


@final
class Schedule:
    """Deadlines at origin + n / rate, without drift: the phase is independent of the duration of ticks.

    A deadline that passes while a tick still runs is skipped and counted, without catch-up: a burst of late ticks
    would apply outdated commands to the coils.
    """

    def __init__(self, rate: float, origin: int) -> None:
        self.period = round(1e9 / check_rate(rate))  #: [ns]
        self.origin = origin  #: monotonic time of deadline 0 [ns]
        self.number = -1  #: deadline of the last or current tick
        self.missed = 0  #: deadlines missed since the start

    def deadline(self, number: int) -> int:
        """Monotonic time of a deadline [ns]."""
        return self.origin + number * self.period

    def next(self, now: int) -> int:
        """The first unused deadline that is not past at `now` [ns], as a monotonic time [ns].

        >>> schedule = Schedule(1000.0, origin=0)
        >>> schedule.next(-1), schedule.next(2_500_000)
        (0, 3000000)
        """
        return self.deadline(max(self.number + 1, -((self.origin - now) // self.period)))

    def time(self, deadline: int) -> float:
        """Time of a deadline on the loop's clock, which is zero at deadline 0 [s]; reproducible to the bit.

        >>> Schedule(1000.0, origin=5_000_000).time(8_000_000)
        0.003
        """
        return (deadline - self.origin) * 1e-9

    def begin(self, now: int) -> tuple[int, int]:
        """Begin a tick at `now` [ns]; return (lateness [ns], deadlines missed since the last tick).

        The tick is that of the latest deadline reached; earlier ones that were slept through are skipped.
        """
        number = max((now - self.origin) // self.period, self.number + 1)
        skipped = number - self.number - 1
        self.number = number
        self.missed += skipped
        return now - self.deadline(number), skipped


_MAX_SPIN_NS = 60_000  #: longest spin [ns]
_MAX_OVERSLEEP_NS = 1_000_000  #: on other systems than Linux a sleep may end this late [ns]


@final
class Clock:
    """Periodic deadlines on the computer's monotonic clock; the first is one period from now.

    `lead` [s]: time before each deadline at which the sleep ends, at most a quarter of the period.
    """

    def __init__(self, rate: float, lead: float = 0.0) -> None:
        self.schedule = Schedule(rate, 0)
        self.schedule.origin = monotonic_ns() + self.schedule.period
        self._early = max(min(_MAX_SPIN_NS, self.schedule.period // 8), min(int(lead * 1e9), self.schedule.period // 4))
        self._deadline = self.schedule.origin
        self._exact = AbsoluteSleep() if is_linux() else None

    def sleep(self) -> float:
        """Sleep until shortly before the next deadline, despite signals; return it on the loop's clock [s]."""
        schedule = self.schedule
        self._deadline = deadline = schedule.next(monotonic_ns())
        if self._exact is None:
            sleep(max(deadline - min(_MAX_OVERSLEEP_NS, schedule.period // 2) - monotonic_ns(), 0) * 1e-9)
            return schedule.time(deadline)
        self._exact.sleep(deadline - self._early)
        return schedule.time(deadline)

    def wait(self) -> tuple[int, int, int]:
        """Spin until the deadline that `sleep` returned; return (now [ns], lateness [ns], deadlines missed)."""
        deadline = self._deadline
        now = monotonic_ns()
        while now < deadline:
            now = monotonic_ns()
        lateness, skipped = self.schedule.begin(now)
        return now, lateness, skipped
