"""What the board has told so far: every answer brings a part, and a sample is made of the parts."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray

from haptorb.physics.arrays import Array
from haptorb.physics.compiled import kernel
from haptorb.runtime.board_reading import BLOCKS, At, reading_row
from haptorb.runtime.hall_sensor import HallSensors, placed
from haptorb.runtime.protocol import CHANNELS
from haptorb.sensing.sample import Pose, Sample

__all__ = ["BoardSample"]

_CURRENTS, _AXIS, _FIRST, _COUNT, _HALL, _NEWS, _THERMOMETER, _TEMPERATURE = (
    int(one) for one in (At.CURRENTS, At.AXIS, At.FIRST, At.COUNT, At.HALL, At.NEWS, At.THERMOMETER, At.TEMPERATURE)
)


@kernel
def _taken(
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
    placed(field, radial, axes, span, axis, first, row[_HALL : _HALL + int(row[_COUNT])])
    heard[axis, 0 if first == 0 else 1] = True


@final
class BoardSample:
    """Currents, temperatures and the field of `hall`, as they come in.

    age  of the last sample's currents when the firmware sent them [s]
    """

    def __init__(self, hall: HallSensors) -> None:
        self.hall = hall
        self.age = 0.0
        self._nothing = hall.nothing()
        self._currents, self._temperatures = np.zeros(CHANNELS), np.full(CHANNELS, np.nan)
        self._field = self._nothing.copy()
        self._heard = np.zeros((3, len(BLOCKS)), np.bool_)
        self.take(reading_row())  # compiled before anybody waits; it tells nothing, as a row's news are 0
        self._temperatures[:] = np.nan

    def take(self, row: Array) -> None:
        """A reading's row (24,), in SI."""
        hall = self.hall
        _taken(
            row, hall.radial, hall.axes, hall.span, self._currents, self._temperatures, self._field, self._heard
        )  # fmt: skip
        self.age = float(row[At.AGE])

    @property
    def whole(self) -> bool:
        """Every sensor has been read once."""
        return bool(self._heard[: self.hall.axes].all() and np.isfinite(self._temperatures).all())

    def sample(self, now: float, pose: Pose) -> Sample:
        """The sample at `now` [s]; field that was not told since the last one is NaN."""
        field, self._field = self._field, self._nothing.copy()
        return Sample(now, self._currents.copy(), self._temperatures.copy(), field, pose)
