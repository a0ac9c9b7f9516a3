"""Black box: the last hundred ticks up to each trip, in memory and, if requested, in a file.

The heartbeat's thread detects trips; it must never wait for a disk, so another thread writes the files.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from time import monotonic_ns, time_ns
from typing import Final, final

import numpy as np

from haptorb.arrays import Array, record
from haptorb.control.trip_reasons import Trip
from haptorb.files import replace_file
from haptorb.recording.state_notes import LAYOUT_NOTE, STATE_NOTE, describe_arrays, pack_arrays
from haptorb.runtime.report import find_program
from haptorb.runtime.shared_memory import SLOTS, TRIPS, SharedMemory, StateSlots, Word, split_snapshot
from haptorb.runtime.tick_state import TickState

__all__ = ["SNAPSHOT_INTERVAL_TICKS", "STORED_TICKS", "BlackBox", "StateKeeper", "TripRecord"]


STORED_TICKS = 100  #: ticks stored up to and including each trip
_START_TICKS = 400  #: a trip within this many ticks of the start: the file contains all ticks since the start
_NAME = re.compile(r".+-[0-9]{8}-[0-9]{6}-[0-9]+-([a-z_]+)\.mcap", re.DOTALL)  #: of a file that `_write` made
_MAX_FILES = 50  #: files of earlier trips that are retained in the folder


@record
class TripRecord:
    """A trip and the ticks before it.

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
    """Detects trips in `shared` of a loop at `rate` [Hz], and writes files to `folder` (created if needed), if given.

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
        self.files: list[Path | None] = []  #: file of each trip; None: not written yet, or it could not be written
        self._shared, self._named, self._rate, self._folder = shared, named, rate, folder
        self._notes = notes or {}
        self._writers: list[threading.Thread] = []
        self._collecting = threading.Lock()

    def collect(self) -> None:
        """Collect the trips since the last call."""
        with self._collecting:
            while len(self.trips) < min(self._shared.words[Word.TRIPS], TRIPS):
                self._record(*self._shared.trips[len(self.trips)].tolist())

    def finish(self) -> None:
        """Collect the last trips; return when all files are written."""
        self.collect()
        for writer in self._writers:
            writer.join()

    def _record(self, t: float, code: float) -> None:
        ring, at = self._shared.ring, self._shared.layout["t"].start
        _, rows = ring.read_since(0)
        until = rows[rows[:, at] <= t + 1e-9] if len(rows) else rows
        tripped = TripRecord(t, Trip(int(code)), until[-STORED_TICKS:].copy())
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
        """Index [1] of the first row in the file of the trip at `t` [s], and the state of the chain at that row."""
        ticks = rows[:, self._shared.layout["tick"].start]
        kept = self._shared.states.read_trip(t)
        if kept is not None and len(found := np.flatnonzero(ticks == kept[0])):
            arrays = split_snapshot(self._shared.states.layout.read()[1], kept[1])
            return int(found[0]), {
                "tick": str(kept[0]), "layout": describe_arrays(arrays), "arrays": pack_arrays(arrays)
            }  # fmt: skip
        whole = len(rows) <= _START_TICKS and len(rows) > 0 and ticks[0] == 0
        return (0 if whole else max(len(rows) - STORED_TICKS, 0)), {}

    def _write(
        self, number: int, folder: Path, rows: Array, known: dict[str, str], worlds: list[tuple[int, str]]
    ) -> None:
        tripped = self.trips[number]
        stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
        name = f"{self._named}-{stamp}-{number + 1}-{tripped.trip.name.lower()}.mcap"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with replace_file(folder / name) as part, part.open("wb") as file:
                from haptorb.recording.mcap import Recorder  # loaded by the servo's start, not by the import of haptorb

                recorder = Recorder(file, self._shared.layout, self._rate, time_ns() - monotonic_ns())
                trip = tripped.trip
                for note, values in self._notes.items():
                    recorder.add_metadata(note, values)
                for change, text in worlds:
                    recorder.add_metadata("world", {"change": str(change), "tick": "", "world": text})
                reason = {"t": repr(tripped.t), "code": trip.name, "reason": trip.text, "error": known["error"],
                          "program": find_program(self._shared, tripped.t)}  # fmt: skip
                recorder.add_metadata("trip", reason)
                if "arrays" in known:
                    recorder.add_metadata(LAYOUT_NOTE, {"arrays": known["layout"]})
                    recorder.add_metadata(STATE_NOTE, {"tick": known["tick"], "arrays": known["arrays"]})
                recorder.append(rows)
                recorder.finish()
            self.files[number] = folder / name
            for old in sorted(filter(_is_own, folder.iterdir()), key=lambda path: path.stat().st_mtime)[:-_MAX_FILES]:
                old.unlink(missing_ok=True)
        except OSError:
            return  # a full disk must not disturb a run; the rows are in `trips` regardless


def _is_own(path: Path) -> bool:
    """Whether a black box wrote this file: a person may keep recordings of their own in the same folder."""
    found = _NAME.fullmatch(path.name)
    own = found is not None and found[1].upper() in Trip.__members__
    return own and path.is_file() and not path.is_symlink()  # safety: black-box-own


# --------------------------------------------------------------------------------------------------
# Periodic snapshots of the chain's state, from which a recording or the black box of a trip can be replayed.


SNAPSHOT_INTERVAL_TICKS: Final = 256  #: ticks from one snapshot to the next


@final
class StateKeeper:
    """Copies `state` every 256 ticks into the next of `slots`, preallocated memory that the recorder reads.

    No snapshots are made if they are larger than a slot: recordings of a device with very many sensors can then be
    replayed from their beginning only.
    """

    def __init__(self, state: TickState, slots: StateSlots) -> None:
        self._state, self._slots = state, slots
        self._due, self._count = SNAPSHOT_INTERVAL_TICKS, 0
        self._fits = state.size <= slots.room and len(state.layout) <= slots.layout.room
        if self._fits:
            slots.layout.write(state.layout)
            self._places = [state.find_places(body) for body in slots.bodies]
            for places in self._places:  # loads code and pages now, not in a tick
                state.copy_to(places)

    def update(self, tick: int) -> None:
        """Copy the state if a snapshot is due; call after `tick`, while there is time before the next."""
        if tick >= self._due and self._fits:
            self._due = tick + SNAPSHOT_INTERVAL_TICKS
            self._count += 1
            self._slots.begin(self._count)
            self._state.copy_to(self._places[self._count % SLOTS])
            self._slots.end(self._count, tick)

    def mark_trip(self, tick: int, t: float) -> None:
        """Record a trip in `tick` at `t` [s]: the replay of its black box begins at the newest snapshot before it."""
        self._slots.mark_trip(self._count, tick - STORED_TICKS, t)
