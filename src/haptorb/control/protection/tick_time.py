"""How much time really passed between two ticks, and whether too many deadlines were missed: a tick is no unit of time.

A loop that is held up must not think that less time passed: a winding heats, a pose ages and a hand moves meanwhile.
"""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Record, Records, fields
from haptorb.numerics.compiled import kernel

__all__ = ["BUCKETS", "CLOCK", "SILENCE", "advance_clock", "make_clock", "silence_of"]

SILENCE = 0.020  #: of the loop, after which a device switches its coils off by itself [s]
_WINDOW = 0.2  #: over which deadlines are counted [s]
_SHARE = 0.8  #: of the deadlines must be met within the window
_GAP = 0.025  #: missed time that one gap counts at most [s]: one pause of the computer is no overrun
BUCKETS = 8  #: of the window

#: period and elapsed [s]; time of the last tick [s], NaN before the first; silence [s] that restarts the ramp; bucket:
#: number of the one that is filled now; overrun and restart: what the last tick found; excused: the next tick's
#: lateness does not count as missed time; missed: time in each bucket [s]
CLOCK = fields(
    ("period", "f8"), ("elapsed", "f8"), ("time", "f8"), ("silence", "f8"), ("bucket", "f8"), ("overrun", "?"),
    ("restart", "?"), ("excused", "?"), ("missed", "f8", (BUCKETS,)),
)  # fmt: skip


def silence_of(period: float) -> float:
    """How long a loop of `period` [s] may be silent before its coils are switched off [s].

    >>> silence_of(1e-3), silence_of(0.02)
    (0.02, 0.04)
    """
    return max(SILENCE, 2.0 * period)


def make_clock(period: float) -> Records:
    """(1,) CLOCK for a loop of `period` [s], before its first tick."""
    clock = np.zeros(1, dtype=CLOCK)
    clock["period"] = clock["elapsed"] = period
    clock["time"] = np.nan
    clock["silence"] = silence_of(period)
    return clock


@kernel
def advance_clock(c: Record, now: float) -> float:
    """A tick begins at `now` [s] on the loop's clock; returns the time since the last one [s].

    c is one CLOCK: `restart` means that the loop was silent for longer than a device's watchdog waits, `overrun` that
    within the last 0.2 s fewer than 80 % of the deadlines were met, those aside that are `excused`.
    """
    elapsed = now - c.time
    if not np.isfinite(elapsed):
        elapsed = c.period
    elapsed = max(elapsed, 0.0)
    width = _WINDOW / BUCKETS
    bucket = np.floor(now / width)
    if np.isfinite(bucket) and bucket != c.bucket:
        for i in range(min(max(int(bucket - c.bucket), 0), BUCKETS)):
            c.missed[int(bucket - i) % BUCKETS] = 0.0
        c.bucket = bucket
    late = elapsed - c.period
    if late > 0.5 * c.period and np.isfinite(bucket) and not c.excused:
        c.missed[int(bucket) % BUCKETS] += min(late, _GAP)
    total = 0.0
    for i in range(BUCKETS):
        total += c.missed[i]
    c.overrun = total > (1.0 - _SHARE) * _WINDOW + 0.5 * c.period
    c.excused = False
    c.restart = elapsed > c.silence
    c.elapsed = elapsed
    c.time = now
    return float(elapsed)
