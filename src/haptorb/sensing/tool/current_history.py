"""The currents when the field was read, where a board measures the two at different times: between two measurements.

The coils' own field is ten times the tool's, and a tenth of an ampere is taken for a millimetre. Currents that change
by an ampere in ten milliseconds have to be known to the tenth of a millisecond, and a current sensor reports the mean
of half a millisecond that ended at some time in the last half. Carried on from the last two of them, such errors are
doubled; between the measurement before the field and the one after it, they are less than those of either. So a field
waits for the next currents, a tick long.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import final

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.numerics.state_arrays import StateArray, Stateful, make_block
from haptorb.sensing.sample import Sample

__all__ = ["CurrentHistory"]

_LENGTH = (
    16  #: measurements: a field waits on the board while newer ones of other sensors are reported, for 7 ms and more
)
_SAME = 0.2e-3  #: currents that are newer by less than this are no second measurement [s]
_PAUSE = 0.05  #: between two of them, after which nothing is known of the time between [s]
_BEYOND = 0.3  #: of a step between two measurements, so far outside of them a field may lie
_SCATTER = 0.15e-3  #: standard deviation of when a current was so [s]
_LATELY = 0.01  #: for so long a change of the currents spoils readings that are still in use [s]


@final
class CurrentHistory(Stateful):
    """Fields, each with the currents (m,) [A] at its own time.

    field     (k, 3) [T] that the last `take` has ended the waiting of; NaN where there is none
    taken     when that was read [s]
    currents  (m,) [A] at that time
    doubt     (m,) [A] what these, and those of the readings of the last 10 ms, may be wrong by
    """

    def __init__(self, channels: int, sensors: int) -> None:
        self._times, self._values = np.full(_LENGTH, -math.inf), np.zeros((_LENGTH, channels))
        self._nothing: Array = np.full((sensors, 3), np.nan)
        self._waiting, self._waiting_since = self._nothing, -math.inf
        self.field, self.taken = self._nothing, -math.inf
        self.currents: Array = np.zeros(channels)
        self.doubt: Array = np.zeros(channels)
        self._kept, self._cells = make_block(
            {"waiting": (sensors, 3), "field": (sensors, 3), "currents": (channels,), "doubt": (channels,)},
            moments=("waiting_since", "taken"),
        )

    def state_arrays(self) -> Mapping[str, StateArray]:
        """Measured currents [A] with their times [s]; fields [T] that wait, and that was told; and their times [s]."""
        return {"times": self._times, "values": self._values, **self._kept}

    def gather_state(self) -> None:
        """Copy what the last samples brought."""
        kept, cells = self._kept, self._cells
        kept["waiting"][:], kept["field"][:] = self._waiting, self.field
        kept["currents"][:], kept["doubt"][:] = self.currents, self.doubt
        cells[0], cells[1] = self._waiting_since, self.taken

    def apply_state(self) -> None:
        """Take it over."""
        kept = self._kept
        self._waiting, self.field = kept["waiting"].copy(), kept["field"].copy()
        self.currents, self.doubt = kept["currents"].copy(), kept["doubt"].copy()
        self._waiting_since, self.taken = self._cells

    def take(self, sample: Sample) -> None:
        """The next sample. Its field waits for the next that has newer currents, and is reported then or never."""
        at = sample.t - sample.currents_age
        newer = at - self._times[-1]
        self.field = self._nothing
        if -_PAUSE <= newer < _SAME:  # the same measurement once more, as far as is known: an answer was lost
            return
        if not 0.0 <= newer <= _PAUSE:
            self._times[:] = -math.inf
        self._times[:-1], self._values[:-1] = self._times[1:], self._values[1:]
        self._times[-1], self._values[-1] = at, sample.currents
        if np.isfinite(self._times[-2]):
            self._release(self._times[-1] - self._times[-2])
        self._waiting, self._waiting_since = sample.field, sample.t - sample.field_age

    def _release(self, newer: float) -> None:
        """Tell the field that waits, unless its time is too far from all currents."""
        when, times, values = self._waiting_since, self._times, self._values
        first = -2
        while when < times[first] and first > -_LENGTH and math.isfinite(times[first - 1]):
            first -= 1
        step, change = float(times[first + 1] - times[first]), values[first + 1] - values[first]
        share = (when - float(times[first])) / step
        self.doubt = np.maximum(_SCATTER / step * np.abs(change), math.exp(-newer / _LATELY) * self.doubt)
        if -_BEYOND <= share <= 1.0 + _BEYOND:
            self.field, self.taken = self._waiting, when
            self.currents = values[first] + share * change
