"""What is wrong with a world's code, read off the rows: it failed, or it takes too long for a tick."""

from __future__ import annotations

import numpy as np

from haptorb.control.protection.trip import GuardState, Trip
from haptorb.runtime.exchange.shared_memory import SharedMemory, Word
from haptorb.runtime.row import STAGES

__all__ = ["describe_slow_world", "is_tripped", "world_failure"]

_ROWS = 64  #: the last ones, of which the median counts
_SHARE = 0.5  #: of a period that a world may take; the rest of the tick needs about 0.2 ms
_STAGE = STAGES.index("world")


def is_tripped(shared: SharedMemory, reason: Trip) -> bool:
    """Whether the coils are off by `reason` now."""
    row = shared.ring.latest()
    if row is None:
        return False
    guard, trip = row[shared.layout["guard"].start], row[shared.layout["trip"].start]
    return bool(guard == GuardState.TRIPPED and trip == reason)


def world_failure(shared: SharedMemory) -> str:
    """What the world's code raised, and where, or what of its memory is not finite, if that has switched the coils off;
    else empty."""
    failed = is_tripped(shared, Trip.WORLD_FAILED) or is_tripped(shared, Trip.MEMORY_NOT_FINITE)
    if not failed or not (error := shared.error.read()[1]):
        return ""  # the row comes a moment before the error
    return f"world '{shared.world_now()}' failed: {error}"


def describe_slow_world(shared: SharedMemory, rate: float) -> str:
    """That the world takes more than half of a tick at `rate` [Hz], with both times; else empty."""
    _, rows = shared.ring.read_since(max(shared.words[Word.ROWS] - _ROWS, 0))
    times = rows[:, shared.layout["stages"].start + _STAGE]
    times = times[np.isfinite(times)]
    if len(times) < _ROWS // 4 or not (took := float(np.median(times))) > _SHARE / rate:
        return ""
    return (
        f"world '{shared.world_now()}' takes {1e3 * took:.2g} ms in each tick, and a tick at {rate:g} Hz has "
        f"{1e3 / rate:.2g} ms for everything: make its code faster, or lower the loop's rate."
    )
