"""What the board has reported so far: every reply brings a part, and a sample is made of the parts."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray

from haptorb.numerics.arrays import Array, Records
from haptorb.numerics.compiled import kernel
from haptorb.runtime.drivers.electronics import CHANNELS
from haptorb.runtime.drivers.hall_sensor import HallSensors, fill_field
from haptorb.runtime.drivers.serial.reading import BLOCKS, make_reading
from haptorb.sensing.sample import Pose, Sample

__all__ = ["BoardSample"]

#: A current sensor converts for 0.53 ms and reports the last whole conversion, whose middle was 0.53 ms ago on average;
#: the three are read one after the other in 0.2 ms, and the firmware reports the age of the first [s].
_CONVERTED = 0.43e-3
#: The firmware reports when it read the last of four or five Hall sensors; they take 0.3 ms [s].
_SCANNED = 0.15e-3


@kernel
def _split_reading(
    reading: Records, radial: Array, axes: int, span: float, currents: Array, temperatures: Array, field: Array,
    present: NDArray[np.bool_],
) -> tuple[float, float]:  # fmt: skip
    """The values of a `reading` into currents (m,) [A], temperatures (m,) [K], field (k, 3) [T]; `present` by axis and
    block. Returns the ages of currents and field [s]."""
    r = reading[0]
    for i in range(len(currents)):
        currents[i] = r.currents[i]
    temperatures[r.thermometer] = r.temperature
    if r.fresh and not np.isnan(r.hall[0]):
        fill_field(field, radial, axes, span, r.axis, r.first, r.hall[: r.count])
        present[r.axis, 0 if r.first == 0 else 1] = True
    return r.age, r.hall_age


@final
class BoardSample:
    """Currents, temperatures and the field of `hall`, as they come in, and when they were so."""

    def __init__(self, hall: HallSensors) -> None:
        self.hall = hall
        self._currents_at = self._field_at = 0.0
        self._nothing = hall.empty_field()
        self._currents, self._temperatures = np.zeros(CHANNELS), np.full(CHANNELS, np.nan)
        self._field = self._nothing.copy()
        self._present = np.zeros((3, len(BLOCKS)), np.bool_)
        self.take(make_reading(), 0.0)  # compiled in advance; it changes nothing, as it has no new values
        self._temperatures[:] = np.nan

    def take(self, reading: Records, sent: float) -> None:
        """A reading, (1,) BOARD_READING, and when the firmware sent it [s], on the clock of `sample`."""
        hall = self.hall
        age, hall_age = _split_reading(
            reading, hall.radial, hall.axes, hall.span, self._currents, self._temperatures, self._field, self._present
        )  # fmt: skip
        self._currents_at = sent - age - _CONVERTED
        self._field_at = sent - hall_age - _SCANNED

    @property
    def complete(self) -> bool:
        """Every sensor has been read once."""
        return bool(self._present[: self.hall.axes].all() and np.isfinite(self._temperatures).all())

    def sample(self, now: float, pose: Pose) -> Sample:
        """The sample at `now` [s]; field that was not reported since the last one is NaN."""
        field, self._field = self._field, self._nothing.copy()
        return Sample(
            now, self._currents.copy(), self._temperatures.copy(), field, pose,
            now - self._currents_at, now - self._field_at,
        )  # fmt: skip
