"""How far another clock of this computer is ahead of its monotonic clock, and how well that is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import monotonic
from typing import final

__all__ = ["ClockOffset", "measure_offset"]


@final
@dataclass(frozen=True)
class ClockOffset:
    """`seconds` to add to the monotonic clock [s]; the true offset is within ± `uncertainty` [s]."""

    seconds: float
    uncertainty: float


def measure_offset(clock: Callable[[], float], repetitions: int = 16) -> ClockOffset:
    """The offset of `clock` [s]: of several readings between two of the monotonic clock, the one in the least time.

    >>> from time import monotonic
    >>> measure_offset(lambda: monotonic() + 5.0).seconds > 4.9
    True
    """
    best = ClockOffset(0.0, float("inf"))
    for _ in range(repetitions):
        before = monotonic()
        there = clock()
        after = monotonic()
        if (after - before) / 2 < best.uncertainty:
            best = ClockOffset(there - (before + after) / 2, (after - before) / 2)
    return best
