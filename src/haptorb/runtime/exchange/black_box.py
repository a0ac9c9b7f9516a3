"""What happened before a trip: the last hundred ticks up to each one, kept in memory and, where told, in a file.

The heartbeat's thread looks for trips; it must never wait for a disk, so files are written by a thread of their own.
"""

from __future__ import annotations

import os
import threading
from datetime import datetime
from pathlib import Path
from time import monotonic_ns, time_ns
from typing import final

from haptorb.control.protection.trip import Trip
from haptorb.files.replace_file import replace_file
from haptorb.numerics.arrays import Array
from haptorb.numerics.record import record
from haptorb.runtime.exchange.shared_memory import TRIPS, SharedMemory, Word
from haptorb.runtime.recording.recorder import Recorder

__all__ = ["TICKS", "BlackBox", "TripRecord", "state_folder"]

TICKS = 100  #: kept up to each trip
_MOST = 50  #: files of earlier trips that stay in the folder


def state_folder() -> Path:
    """Where programs keep what happened to them: $XDG_STATE_HOME/haptorb, else ~/.local/state/haptorb."""
    home = os.environ.get("XDG_STATE_HOME") or os.path.join(os.path.expanduser("~"), ".local", "state")
    return Path(home) / "haptorb"


@record
class TripRecord:
    """One trip and what led to it.

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
    """Watches `shared` of a loop of `rate` [Hz]; files go into `folder` (made when first needed), None: no files.

    `named` begins the files' names.
    """

    def __init__(self, shared: SharedMemory, named: str, rate: float, folder: Path | None) -> None:
        self.trips: list[TripRecord] = []  #: the first 64, in order
        self.files: list[Path | None] = []  #: where each of them is; None: nowhere yet, or it could not be written
        self._shared, self._named, self._rate, self._folder = shared, named, rate, folder
        self._writers: list[threading.Thread] = []
        self._looking = threading.Lock()

    def look(self) -> None:
        """Take hold of the trips since the last look."""
        with self._looking:
            while len(self.trips) < min(self._shared.words[Word.TRIPS], TRIPS):
                self._take(*self._shared.trips[len(self.trips)].tolist())

    def finish(self) -> None:
        """The last look; returns when all files are written."""
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
            error = self._shared.error.read()[1]
            writer = threading.Thread(target=self._write, args=(len(self.trips) - 1, self._folder, error), daemon=True)
            writer.start()
            self._writers.append(writer)

    def _write(self, number: int, folder: Path, error: str) -> None:
        tripped = self.trips[number]
        stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
        name = f"{self._named}-{stamp}-{number + 1}-{tripped.trip.name.lower()}.mcap"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with replace_file(folder / name) as part, part.open("wb") as file:
                recorder = Recorder(file, self._shared.layout, self._rate, time_ns() - monotonic_ns())
                trip = tripped.trip
                notes = {"t": repr(tripped.t), "code": trip.name, "reason": trip.text, "error": error}
                recorder.note("trip", notes)
                recorder.append(tripped.rows)
                recorder.finish()
            self.files[number] = folder / name
            for old in sorted(folder.glob("*.mcap"), key=lambda path: path.stat().st_mtime)[:-_MOST]:
                old.unlink(missing_ok=True)
        except OSError:
            return  # a full disk is no reason to disturb a run; the rows are in `trips` all the same
