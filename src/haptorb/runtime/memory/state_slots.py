"""Snapshots of the chain in shared memory: the last ones, and the one from before the last trip. One writer."""

from __future__ import annotations

import json
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from haptorb.numerics.state_arrays import StateArray
from haptorb.runtime.memory.text_slot import TextSlot

__all__ = ["REGULAR", "SLOTS", "StateSlots", "slots_size", "split_snapshot", "state_room"]

SLOTS: Final = 12  #: of the last snapshots
REGULAR: Final = 8  #: snapshots from one that is recorded to the next
_LAYOUT: Final = 48 * 1024  #: bytes of the layout of a snapshot, which is text
_HEAD: Final = 4  #: words of a slot: version, number, tick; in nanoseconds: time of the trip
_TRIES: Final = 100


def state_room(channels: int, sensors: int) -> int:
    """Bytes for a snapshot of a device with so many of them."""
    return 36 * 1024 + 1024 * channels + 1024 * sensors


def slots_size(channels: int, sensors: int) -> int:
    """Bytes of all of it, layout included."""
    return _LAYOUT + (SLOTS + 1) * (8 * _HEAD + state_room(channels, sensors))


@final
class StateSlots:
    """In `memory`, which begins as zeros. A slot's version is odd while it is being written.

    layout  of the snapshots, as `TickState` says; empty: none are taken
    """

    def __init__(self, memory: memoryview, channels: int, sensors: int) -> None:
        self.room = state_room(channels, sensors)
        self.layout = TextSlot(memory[:_LAYOUT])
        slots = np.frombuffer(memory[_LAYOUT:], np.uint8).reshape(SLOTS + 1, 8 * _HEAD + self.room)
        self._heads = slots[:, : 8 * _HEAD].view(np.int64)
        #: (SLOTS, room) [1]
        self.bodies: NDArray[np.uint8] = slots[:SLOTS, 8 * _HEAD :]
        self._trip: NDArray[np.uint8] = slots[SLOTS, 8 * _HEAD :]
        self._cells = [head.data for head in self._heads]

    def begin(self, number: int) -> None:
        """The snapshot of this `number`, from 1 on, is about to be written into `bodies[number % SLOTS]`."""
        cells = self._cells[number % SLOTS]
        cells[0] |= 1
        cells[1] = number

    def end(self, number: int, tick: int) -> None:
        """It is there: of the chain after `tick`."""
        cells = self._cells[number % SLOTS]
        cells[2] = tick
        cells[0] += 1

    def mark_trip(self, last: int, tick: int, t: float) -> None:
        """At `t` [s] there was a trip, and snapshot `last` is the newest: keep the newest one up to `tick`."""
        for number in range(last, max(last - SLOTS, 0), -1):
            cells = self._cells[number % SLOTS]
            if cells[1] == number and cells[2] <= tick:
                trip = self._cells[SLOTS]
                trip[0] |= 1
                trip[1], trip[2], trip[3] = number, cells[2], round(1e9 * t)
                self._trip[:] = self.bodies[number % SLOTS]
                trip[0] += 1
                return

    def read_since(self, number: int, every: int) -> list[tuple[int, int, NDArray[np.uint8]]]:
        """(number, tick, snapshot (room,)) of those after snapshot `number` whose numbers are multiples of `every` [1],
        oldest first, as copies."""
        found = []
        for slot in range(SLOTS):
            there = int(self._cells[slot][1])
            if there > number and there % every == 0:
                copy = self._read(slot, self.bodies[slot])
                if copy is not None and copy[0] == there:
                    found.append((there, copy[1], copy[3]))
        return sorted(found, key=lambda one: one[0])

    def read_trip(self, t: float) -> tuple[int, NDArray[np.uint8]] | None:
        """(tick, snapshot) from before the trip at `t` [s]; None if there is none."""
        copy = self._read(SLOTS, self._trip)
        return None if copy is None or copy[2] != round(1e9 * t) else (copy[1], copy[3])

    def _read(self, slot: int, body: NDArray[np.uint8]) -> tuple[int, int, int, NDArray[np.uint8]] | None:
        cells = self._cells[slot]
        for _ in range(_TRIES):
            before = cells[0]
            if not before or before & 1:
                continue
            number, tick, time, copy = int(cells[1]), int(cells[2]), int(cells[3]), body.copy()
            if cells[0] == before:
                return number, tick, time, copy
        return None


def split_snapshot(layout: str, snapshot: NDArray[np.uint8]) -> dict[str, StateArray]:
    """Name → a copy of each array of a `snapshot` (size,) [1], which lies there as `layout` says."""
    found: dict[str, StateArray] = {}
    for name, kind, shape, first, stride in json.loads(layout):
        dtype = np.dtype(kind)
        inner = [dtype.itemsize]
        for length in reversed(shape[2:]):
            inner.insert(0, inner[0] * length)
        strides = ([stride, *inner] if len(shape) > 1 else [stride]) if shape else []
        found[name] = np.ndarray(shape, dtype, snapshot, first, strides).copy()
    return found
