"""What the loop does with every tick, in two compiled passes: publish its row, and count what a report tells."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from haptorb.numerics.arrays import Array, Records
from haptorb.numerics.compiled import kernel
from haptorb.runtime.exchange.shared_memory import Word
from haptorb.runtime.memory.histogram import BINS

__all__ = ["count_tick", "publish_row"]

Words: TypeAlias = NDArray[np.int64]

_TICKS, _MISSED, _ON_TIME = int(Word.TICKS), int(Word.MISSED), int(Word.ON_TIME)
_PEAK, _PEAK_TORQUE = int(Word.PEAK), int(Word.PEAK_TORQUE)
_LAST = BINS - 1


@kernel
def _size(row: Array, at: int) -> float:
    return float(np.sqrt(row[at] * row[at] + row[at + 1] * row[at + 1] + row[at + 2] * row[at + 2]))


@kernel
def publish_row(
    row: Array, slot: Array, places: Records, page: Array, tick: int, now: int, lateness: int, skipped: int
) -> None:  # fmt: skip
    """Complete `row` with what the clock knows, all in [ns], and copy it to `slot`; both (width,), in SI.

    places is that of the `RowLayout`; page (512,) the shared words as numbers: the greatest force [N] and torque [N·m]
    so far are there.
    """
    at = places[0]
    row[at.tick], row[at.wall], row[at.lateness], row[at.missed] = tick, now * 1e-9, lateness * 1e-9, skipped
    for i in range(row.shape[0]):
        slot[i] = row[i]
    given = at.given
    force = _size(row, given)
    if force != force:  # nobody knows what is really there
        given = at.modelled
        force = _size(row, given)
    if force > page[_PEAK]:
        page[_PEAK] = force
    torque = _size(row, given + 3)
    if torque > page[_PEAK_TORQUE]:
        page[_PEAK_TORQUE] = torque


@kernel
def count_tick(
    words: Words, lateness_counts: Words, compute_counts: Words, ticks: int, missed: int, lateness: int, took: int,
    period: int,
) -> None:  # fmt: skip
    """Count one tick's lateness and computing time [ns], and whether both fitted into its period, in the shared words.

    The counts are those of a `Histogram`.
    """
    lateness_counts[min(max(lateness, 0) // 1000, _LAST)] += 1
    compute_counts[min(max(took, 0) // 1000, _LAST)] += 1
    words[_TICKS] = ticks
    words[_MISSED] = missed
    if lateness + took <= period:
        words[_ON_TIME] += 1
