"""Missed deadlines of the loop: elapsed time between ticks, and the overrun check. A tick is not a unit of time.

A delayed loop must use the elapsed time, not its period: windings heat, poses age and the hand moves meanwhile.
"""

from __future__ import annotations

import numpy as np

from haptorb.arrays import Record, Records, fields
from haptorb.compiled import kernel

__all__ = ["CLOCK", "WATCHDOG_TIMEOUT_S", "advance_clock", "make_clock", "silence_of"]


WATCHDOG_TIMEOUT_S = 0.020  #: of the loop, after which the device's watchdog switches its coils off [s]
_DEADLINE_WINDOW_S = 0.2  #: window of the deadline count [s]
_MIN_MET_DEADLINES = 0.8  #: share of the deadlines that must be met within the window
_MAX_COUNTED_GAP_S = 0.025  #: missed time counted for one gap at most [s]: a single pause is not an overrun
_BUCKETS = 8  #: of the window

#: period and elapsed [s]; time of the last tick [s], NaN before the first; silence [s] that restarts the ramp; bucket:
#: number of the one that is filled now; overrun and restart: results of the last tick; excused: the next tick's
#: lateness does not count as missed time; missed: time in each bucket [s]
CLOCK = fields(
    ("period", "f8"), ("elapsed", "f8"), ("time", "f8"), ("silence", "f8"), ("bucket", "f8"), ("overrun", "?"),
    ("restart", "?"), ("excused", "?"), ("missed", "f8", (_BUCKETS,)),
)  # fmt: skip


def silence_of(period: float) -> float:
    """Time without a tick, for a loop of `period` [s], after which the device's watchdog switches its coils off [s].

    >>> silence_of(1e-3), silence_of(0.02)
    (0.02, 0.04)
    """
    return max(WATCHDOG_TIMEOUT_S, 2.0 * period)


def make_clock(period: float) -> Records:
    """(1,) CLOCK for a loop of `period` [s], before its first tick."""
    clock = np.zeros(1, dtype=CLOCK)
    clock["period"] = clock["elapsed"] = period
    clock["time"] = np.nan
    clock["silence"] = silence_of(period)
    return clock


@kernel
def advance_clock(c: Record, now: float) -> float:
    """Start a tick at `now` [s] on the loop's clock; returns the time elapsed since the last one [s].

    c is one CLOCK: `restart` means that the loop was silent for longer than the timeout of a device's watchdog,
    `overrun` that fewer than 80 % of the deadlines within the last 0.2 s were met, except those that are `excused`.
    """
    elapsed = now - c.time
    if not np.isfinite(elapsed):
        elapsed = c.period
    elapsed = max(elapsed, 0.0)
    width = _DEADLINE_WINDOW_S / _BUCKETS
    bucket = np.floor(now / width)
    if np.isfinite(bucket) and bucket != c.bucket:
        for i in range(min(max(int(bucket - c.bucket), 0), _BUCKETS)):
            c.missed[int(bucket - i) % _BUCKETS] = 0.0
        c.bucket = bucket
    late = elapsed - c.period
    if late > 0.5 * c.period and np.isfinite(bucket) and not c.excused:
        c.missed[int(bucket) % _BUCKETS] += min(late, _MAX_COUNTED_GAP_S)
    total = 0.0
    for i in range(_BUCKETS):
        total += c.missed[i]
    c.overrun = total > (1.0 - _MIN_MET_DEADLINES) * _DEADLINE_WINDOW_S + 0.5 * c.period
    c.excused = False
    c.restart = elapsed > c.silence
    c.elapsed = elapsed
    c.time = now
    return float(elapsed)
