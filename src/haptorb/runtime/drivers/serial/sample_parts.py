"""What the board has told so far: every answer brings a part, and a sample is made of the parts."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray

from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.runtime.drivers.hall_sensor import HallSensors, fill_field
from haptorb.runtime.drivers.serial.protocol import CHANNELS
from haptorb.runtime.drivers.serial.reading import BLOCKS, At, reading_row
from haptorb.sensing.sample import Pose, Sample

__all__ = ["BoardSample"]

_CURRENTS, _AXIS, _FIRST, _COUNT, _HALL, _NEWS, _THERMOMETER, _TEMPERATURE = (
    int(one) for one in (At.CURRENTS, At.AXIS, At.FIRST, At.COUNT, At.HALL, At.NEWS, At.THERMOMETER, At.TEMPERATURE)
)
#: A current sensor converts for 0.53 ms and tells the last whole conversion, whose middle was 0.53 ms ago on average;
#: the three are read one after the other in 0.2 ms, and the firmware tells the age of the first [s].
_CONVERTED = 0.43e-3
#: The firmware tells when it had the last of four or five Hall sensors; they take 0.3 ms [s].
_SCANNED = 0.15e-3


@kernel
def _split_reading(
    row: Array,
    radial: Array,
    axes: int,
    span: float,
    currents: Array,
    temperatures: Array,
    field: Array,
    heard: NDArray[np.bool_],
) -> None:
    """What a reading's `row` tells into currents (m,) [A], temperatures (m,) [K], field (k, 3) [T]; `heard` by axis and
    block."""
    for i in range(len(currents)):
        currents[i] = row[_CURRENTS + i]
    temperatures[int(row[_THERMOMETER])] = row[_TEMPERATURE]
    if row[_NEWS] == 0.0 or row[_HALL] != row[_HALL]:
        return
    axis, first = int(row[_AXIS]), int(row[_FIRST])
    fill_field(field, radial, axes, span, axis, first, row[_HALL : _HALL + int(row[_COUNT])])
    heard[axis, 0 if first == 0 else 1] = True


@final
class BoardSample:
    """Currents, temperatures and the field of `hall`, as they come in, and when they were so."""

    def __init__(self, hall: HallSensors) -> None:
        self.hall = hall
        self._currents_at = self._field_at = 0.0
        self._nothing = hall.nothing()
        self._currents, self._temperatures = np.zeros(CHANNELS), np.full(CHANNELS, np.nan)
        self._field = self._nothing.copy()
        self._heard = np.zeros((3, len(BLOCKS)), np.bool_)
        self.take(reading_row(), 0.0)  # compiled before anybody waits; it tells nothing, as a row's news are 0
        self._temperatures[:] = np.nan

    def take(self, row: Array, sent: float) -> None:
        """A reading's row (24,), in SI, and when the firmware sent it [s], on the clock of `sample`."""
        hall = self.hall
        _split_reading(
            row, hall.radial, hall.axes, hall.span, self._currents, self._temperatures, self._field, self._heard
        )  # fmt: skip
        self._currents_at = sent - float(row[At.AGE]) - _CONVERTED
        self._field_at = sent - float(row[At.HALL_AGE]) - _SCANNED

    @property
    def whole(self) -> bool:
        """Every sensor has been read once."""
        return bool(self._heard[: self.hall.axes].all() and np.isfinite(self._temperatures).all())

    def sample(self, now: float, pose: Pose) -> Sample:
        """The sample at `now` [s]; field that was not told since the last one is NaN."""
        field, self._field = self._field, self._nothing.copy()
        return Sample(
            now, self._currents.copy(), self._temperatures.copy(), field, pose,
            now - self._currents_at, now - self._field_at,
        )  # fmt: skip
