"""Absolute deadlines as whole nanoseconds: which deadline is next, and how many went by. No clock in here."""

from __future__ import annotations

import math
from typing import final

from haptorb.errors import InputError

__all__ = ["FASTEST", "SLOWEST", "Schedule", "check_rate"]

SLOWEST = 50.0  #: [Hz]
FASTEST = 4000.0  #: [Hz]


def check_rate(rate: float) -> float:
    """`rate` [Hz] itself, or InputError.

    >>> check_rate(1000)
    1000.0
    """
    if isinstance(rate, bool) or not isinstance(rate, int | float) or not math.isfinite(rate):
        raise InputError(f"rate must be a finite number of hertz; got {rate!r}")
    if not SLOWEST <= rate <= FASTEST:
        raise InputError(f"rate must lie between {SLOWEST:g} and {FASTEST:g} Hz; got {rate:g}")
    return float(rate)


@final
class Schedule:
    """Deadlines at origin + n / rate, independent of what happens between them: the phase never changes.

    A deadline that passes while a tick still runs is skipped and counted. It is never made up for: a burst of late
    ticks would hit the coils with old commands.
    """

    def __init__(self, rate: float, origin: int) -> None:
        self.period = round(1e9 / check_rate(rate))  #: [ns]
        self.origin = origin  #: monotonic time of deadline 0 [ns]
        self.number = -1  #: the deadline whose tick ran last, or runs
        self.missed = 0  #: deadlines missed since the start

    def deadline(self, number: int) -> int:
        """Monotonic time of a deadline [ns]."""
        return self.origin + number * self.period

    def next(self, now: int) -> int:
        """The first deadline that is neither used nor past at `now` [ns], as a monotonic time [ns].

        >>> schedule = Schedule(1000.0, origin=0)
        >>> schedule.next(-1), schedule.next(2_500_000)
        (0, 3000000)
        """
        return self.deadline(max(self.number + 1, -((self.origin - now) // self.period)))

    def time(self, deadline: int) -> float:
        """A deadline on the loop's clock, which shows zero at deadline 0 [s]; the same number for the same deadline.

        >>> Schedule(1000.0, origin=5_000_000).time(8_000_000)
        0.003
        """
        return (deadline - self.origin) * 1e-9

    def begin(self, now: int) -> tuple[int, int]:
        """Begin a tick at `now` [ns]: (lateness [ns], deadlines missed since the last tick).

        The tick belongs to the latest deadline that has come; sleeping through several skips all but that one.
        """
        number = max((now - self.origin) // self.period, self.number + 1)
        skipped = number - self.number - 1
        self.number = number
        self.missed += skipped
        return now - self.deadline(number), skipped
