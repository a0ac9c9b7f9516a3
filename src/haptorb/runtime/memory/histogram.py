"""Durations counted into 1 µs bins: what a loop can afford per tick, and what percentiles need."""

from __future__ import annotations

from typing import TypeAlias, final

import numpy as np
from numpy.typing import NDArray

__all__ = ["BINS", "Counts", "Histogram"]

Counts: TypeAlias = NDArray[np.int64]

BINS = 20_001  #: 1 µs each, the last one for everything from 20 ms on


@final
class Histogram:
    """Counts of durations, kept in an array that another object may own (shared memory).

    >>> histogram = Histogram()
    >>> for duration in (1_500, 2_500, 90_000_000):
    ...     histogram.add(duration)
    >>> histogram.count, histogram.percentile(50.0)
    (3, 3.0)
    """

    def __init__(self, counts: Counts | None = None) -> None:
        self.counts = np.zeros(BINS, dtype=np.int64) if counts is None else counts  #: (20001,)
        self._cells = self.counts.data  # single numbers go through it faster than through the array

    def add(self, duration: int) -> None:
        """Count one duration [ns]."""
        self._cells[min(max(duration, 0) // 1000, BINS - 1)] += 1

    @property
    def count(self) -> int:
        """Durations counted."""
        return int(self.counts.sum())

    def percentile(self, percent: float) -> float:
        """The duration [µs] that `percent` of all are below or at: the upper edge of its bin. NaN when empty.

        From 20 ms on nothing is resolved; 20001 stands for "20 ms or more".
        """
        below = np.cumsum(self.counts)
        if below[-1] == 0:
            return float("nan")
        return float(np.searchsorted(below, percent / 100 * below[-1], side="left") + 1)
