"""All rows of a recording in memory, unpacked by a process beside this one, which loads its code meanwhile."""

from __future__ import annotations

import mmap
from typing import final

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.runtime.recording.recording import Recording
from haptorb.runtime.replay.child_process import start_child

__all__ = ["UnpackedRows", "count_bytes"]

_PIECE = 1024  #: rows that are read at once


def count_bytes(recording: Recording) -> int:
    """Bytes of all rows of `recording`, unpacked."""
    return 8 * len(recording) * sum(field.width for field in recording.fields)


@final
class UnpackedRows:
    """The rows of `recording`, which a process of its own unpacks from now on."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._names = [field.name for field in recording.fields]
        shared = mmap.mmap(-1, count_bytes(recording))
        self._rows: Array = np.frombuffer(shared, np.float64).reshape(len(recording), -1)
        self._process = start_child(self._unpack)

    def _unpack(self) -> None:
        for first in range(0, len(self._rows), _PIECE):
            last = min(first + _PIECE, len(self._rows))
            self._rows[first:last] = self._recording.read(first, last, self._names)

    def take(self) -> Array:
        """(n, width) the rows when they are all there, each number in the unit [SI] of its field.

        Raises RecordingError where the file is damaged.
        """
        self._process.join()
        if self._process.exitcode:
            self._unpack()
        return self._rows
