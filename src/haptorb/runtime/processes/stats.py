"""What the loop does with every tick, in two compiled passes: publish its row, and count what a report states."""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Array, Records
from haptorb.numerics.compiled import kernel
from haptorb.runtime.memory.histogram import BINS

__all__ = ["count_tick", "publish_row"]

_LAST = BINS - 1


@kernel
def _size(row: Array, at: int) -> float:
    return float(np.sqrt(row[at] * row[at] + row[at + 1] * row[at + 1] + row[at + 2] * row[at + 2]))


@kernel
def publish_row(
    row: Array, slot: Array, places: Records, counts: Records, tick: int, now: int, lateness: int, skipped: int
) -> None:  # fmt: skip
    """Complete `row` with what the clock knows, all in [ns], and copy it to `slot`; both (width,), in SI.

    places is that of the `RowLayout`; counts (1,) COUNTS, where the greatest force [N] and torque [N·m] so far are.
    """
    at, most = places[0], counts[0]
    row[at.tick], row[at.wall], row[at.lateness], row[at.missed] = tick, now * 1e-9, lateness * 1e-9, skipped
    for i in range(row.shape[0]):
        slot[i] = row[i]
    given = at.given
    force = _size(row, given)
    if force != force:  # what is really there is unknown
        given = at.modelled
        force = _size(row, given)
    if force > most.peak:
        most.peak = force
    torque = _size(row, given + 3)
    if torque > most.peak_torque:
        most.peak_torque = torque


@kernel
def count_tick(counts: Records, ticks: int, missed: int, lateness: int, took: int, period: int) -> None:
    """Count one tick's lateness and computing time [ns], and whether both fitted into its period; counts (1,) COUNTS.

    The bins are those of a `Histogram`.
    """
    c = counts[0]
    c.lateness[min(max(lateness, 0) // 1000, _LAST)] += 1
    c.compute[min(max(took, 0) // 1000, _LAST)] += 1
    c.ticks, c.missed = ticks, missed
    if lateness + took <= period:
        c.on_time += 1
