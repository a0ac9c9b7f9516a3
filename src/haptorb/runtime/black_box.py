"""The ticks before a trip: the last hundred up to each trip, in memory and, if requested, in a file.

The heartbeat's thread detects trips; it must never wait for a disk, so another thread writes the files.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from time import monotonic_ns, time_ns
from typing import Final, final

import numpy as np

from haptorb.arrays import Array, record
from haptorb.control.trips import Trip
from haptorb.files import replace_file
from haptorb.recording.mcap import Recorder
from haptorb.recording.state_notes import LAYOUT_NOTE, STATE_NOTE, describe_arrays, pack_arrays
from haptorb.runtime.shared_memory import SLOTS, TRIPS, SharedMemory, StateSlots, Word, split_snapshot
from haptorb.runtime.tick_state import TickState

__all__ = ["EVERY", "TICKS", "BlackBox", "StateKeeper", "TripRecord"]


TICKS = 100  #: kept up to each trip
_START = 400  #: ticks after the start, within which the file has them all
_MAX_FILES = 50  #: files of earlier trips that stay in the folder


@record
class TripRecord:
    """One trip and the ticks before it.

    t      of the trip, on the loop's clock [s]
    trip   its reason
    rows   (n, width) the last ticks up to and including the one that tripped, oldest first; n is at most 100
    """

    t: float
    trip: Trip
    rows: Array

    def __repr__(self) -> str:
        return f"<TripRecord at {self.t:.3f} s: {self.trip.name.lower().replace('_', ' ')}, {len(self.rows)} ticks>"


@final
class BlackBox:
    """Watches `shared` of a loop of `rate` [Hz]; files go into `folder` (created when needed), None: no files.

    `named` is the prefix of the file names; `notes` are the metadata of their recordings. A file begins some ticks
    earlier than the rows in `trips`, at a stored state of the loop, so that it can be replayed.
    """

    def __init__(
        self,
        shared: SharedMemory,
        named: str,
        rate: float,
        folder: Path | None,
        notes: Mapping[str, Mapping[str, str]] | None = None,
    ) -> None:
        self.trips: list[TripRecord] = []  #: the first 64, in order
        self.files: list[Path | None] = []  #: where each of them is; None: nowhere yet, or it could not be written
        self._shared, self._named, self._rate, self._folder = shared, named, rate, folder
        self._notes = notes or {}
        self._writers: list[threading.Thread] = []
        self._looking = threading.Lock()

    def look(self) -> None:
        """Collect the trips since the last call."""
        with self._looking:
            while len(self.trips) < min(self._shared.words[Word.TRIPS], TRIPS):
                self._take(*self._shared.trips[len(self.trips)].tolist())

    def finish(self) -> None:
        """Collect the last trips; returns when all files are written."""
        self.look()
        for writer in self._writers:
            writer.join()

    def _take(self, t: float, code: float) -> None:
        ring, at = self._shared.ring, self._shared.layout["t"].start
        _, rows = ring.read_since(0)
        until = rows[rows[:, at] <= t + 1e-9] if len(rows) else rows
        tripped = TripRecord(t, Trip(int(code)), until[-TICKS:].copy())
        self.trips.append(tripped)
        self.files.append(None)
        if self._folder is not None:
            first, state = self._find_beginning(t, until)
            notes = {"error": self._shared.error.read()[1], **state}
            work = (len(self.trips) - 1, self._folder, until[first:].copy(), notes, self._shared.worlds_since(0))
            writer = threading.Thread(target=self._write, args=work, daemon=True)
            writer.start()
            self._writers.append(writer)

    def _find_beginning(self, t: float, rows: Array) -> tuple[int, dict[str, str]]:
        """Index [1] of the row with which the file of the trip at `t` [s] begins, and what the chain remembered
        then."""
        ticks = rows[:, self._shared.layout["tick"].start]
        kept = self._shared.states.read_trip(t)
        if kept is not None and len(found := np.flatnonzero(ticks == kept[0])):
            arrays = split_snapshot(self._shared.states.layout.read()[1], kept[1])
            return int(found[0]), {
                "tick": str(kept[0]), "layout": describe_arrays(arrays), "arrays": pack_arrays(arrays)
            }  # fmt: skip
        whole = len(rows) <= _START and len(rows) > 0 and ticks[0] == 0
        return (0 if whole else max(len(rows) - TICKS, 0)), {}

    def _write(
        self, number: int, folder: Path, rows: Array, known: dict[str, str], worlds: list[tuple[int, str]]
    ) -> None:
        tripped = self.trips[number]
        stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
        name = f"{self._named}-{stamp}-{number + 1}-{tripped.trip.name.lower()}.mcap"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with replace_file(folder / name) as part, part.open("wb") as file:
                recorder = Recorder(file, self._shared.layout, self._rate, time_ns() - monotonic_ns())
                trip = tripped.trip
                for note, values in self._notes.items():
                    recorder.note(note, values)
                for change, text in worlds:
                    recorder.note("world", {"change": str(change), "tick": "", "world": text})
                reason = {"t": repr(tripped.t), "code": trip.name, "reason": trip.text, "error": known["error"]}
                recorder.note("trip", reason)
                if "arrays" in known:
                    recorder.note(LAYOUT_NOTE, {"arrays": known["layout"]})
                    recorder.note(STATE_NOTE, {"tick": known["tick"], "arrays": known["arrays"]})
                recorder.append(rows)
                recorder.finish()
            self.files[number] = folder / name
            for old in sorted(folder.glob("*.mcap"), key=lambda path: path.stat().st_mtime)[:-_MAX_FILES]:
                old.unlink(missing_ok=True)
        except OSError:
            return  # a full disk is no reason to disturb a run; the rows are in `trips` all the same


# --------------------------------------------------------------------------------------------------
# Snapshots of the chain every so many ticks: from there a recording, or a trip's black box, can be run again.


EVERY: Final = 256  #: ticks from one snapshot to the next


@final
class StateKeeper:
    """Copies `state` every 256 ticks into the next of `slots`, where the recorder finds it: memory that is there.

    A snapshot that is too long for the slots is not taken: then recordings of a device with very many sensors replay
    from their beginning only.
    """

    def __init__(self, state: TickState, slots: StateSlots) -> None:
        self._state, self._slots = state, slots
        self._due, self._count = EVERY, 0
        self._fits = state.size <= slots.room and len(state.layout) <= slots.layout.room
        if self._fits:
            slots.layout.write(state.layout)
            self._places = [state.find_places(body) for body in slots.bodies]
            for places in self._places:  # what it loads, it loads now
                state.copy_to(places)

    def look(self, tick: int) -> None:
        """`tick` is over, and there is time before the next."""
        if tick >= self._due and self._fits:
            self._due = tick + EVERY
            self._count += 1
            self._slots.begin(self._count)
            self._state.copy_to(self._places[self._count % SLOTS])
            self._slots.end(self._count, tick)

    def tell(self, tick: int, t: float) -> None:
        """`tick` at `t` [s] has tripped: the newest snapshot from before its black box is the one to begin with."""
        self._slots.mark_trip(self._count, tick - TICKS, t)
