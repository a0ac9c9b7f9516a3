"""The columns of the console's frames, taken from the fields of a recording by name, in any order."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

import numpy as np

from haptorb.apps.console.wire import COLUMNS, MODED, rows_frame
from haptorb.numerics.arrays import Array
from haptorb.runtime.recording.data_frames import column_heads
from haptorb.runtime.recording.recording import Recording
from haptorb.runtime.row import Field, RowLayout

__all__ = ["RowColumns"]


@final
class RowColumns:
    """What the page shows of a recording's rows; a column that the recording has not is NaN."""

    def __init__(self, recording: Recording, layout: RowLayout, *, moded: bool) -> None:
        """`layout`: of the device as this version of haptorb has it; `moded`: whether that has modes."""
        self._recording = recording
        found = {field.name: field for field in recording.fields}
        usual = {field.name: field for field in layout.fields}
        free = ("memory", "contacts")  #: as wide as the recording has them
        self._fields: list[tuple[Field, bool]] = []
        for name in COLUMNS + (MODED if moded else ()):
            field = found.get(name, usual[name])
            fits = name in found and (name in free or field.width == usual[name].width)
            self._fields.append((field if fits else usual[name], fits))
        self.missing = [field.name for field, fits in self._fields if not fits and field.width]
        self.width = sum(field.width for field, _ in self._fields)
        self._names = [field.name for field, fits in self._fields if fits]
        self._all: Any = np.arange(self.width)
        self._places = np.concatenate(
            [np.arange(at, at + field.width) for (field, fits), at in zip(self._fields, self._offsets(), strict=True)
             if fits] or [np.empty(0, dtype=np.int64)]
        )  # fmt: skip

    def _offsets(self) -> Sequence[int]:
        widths = [field.width for field, _ in self._fields]
        return [0, *np.cumsum(widths).tolist()][:-1]

    def describe(self) -> list[dict[str, Any]]:
        """Name, offset, width, unit, meaning and headings of each column, as the page reads them."""
        return [
            {
                "name": field.name,
                "offset": offset,
                "width": field.width,
                "unit": field.unit,
                "about": field.about,
                "heads": list(column_heads(field)),
            }
            for (field, _), offset in zip(self._fields, self._offsets(), strict=True)
        ]

    def read(self, first: int, last: int) -> Array:
        """(last − first, width) of these rows, each number in the unit of its column; NaN where there is none."""
        read = self._recording.read(first, last, self._names)
        if len(self._places) == self.width:
            return read
        rows = np.full((len(read), self.width), np.nan)
        rows[:, self._places] = read
        return rows

    def frame(self, first: int, last: int, question: float) -> bytes:
        """Rows `first` up to `last` as a frame of the console, at least one.

        Its `echo` is the page's number of the `question`, its `dropped` the number of the first row.
        """
        with np.errstate(over="ignore", invalid="ignore"):  # a foreign number may be too large for float32
            return rows_frame(self.read(first, last), self._all, 0, 1, question, first)
