"""What the firmware has read: the answer to SET and READ, a thousand of them a second."""

from __future__ import annotations

from struct import Struct
from typing import NamedTuple

from haptorb.errors import DriverError
from haptorb.runtime.board_answers import reason, standing, unpacked
from haptorb.runtime.board_words import Reason, Standing
from haptorb.runtime.protocol import DUTY_STEPS, HALL_SENSORS, THERMOMETERS

__all__ = ["BLOCKS", "READING_BYTES", "Reading"]

#: first sensors and one past the last of what is read together: an axis of these
BLOCKS = ((0, 5), (5, HALL_SENSORS))

_LAYOUT = Struct("<BBH3h3hB5HBhHHBB")
READING_BYTES = _LAYOUT.size

_NAN = float("nan")
_NO_TEMPERATURE = 0x7FFF
_NO_HALL = 0xFFFF
_TOLD = 0x80  #: in the group's number: it has been told before
_AXES = 3


class Reading(NamedTuple):
    """In SI, as plain tuples: to make arrays of them takes longer than all the rest.

    applied       (3,) duties that the coils have [1]
    currents      (3,) [A]
    hall_axis     of the Hall readings: 0, 1, 2 for x, y, z; 0 for radial sensors
    hall_first    number of the first Hall sensor in `hall`
    hall          (4 or 5,) of the converter's range, 0…1; NaN before the first reading
    hall_news     not told before
    hall_age      of `hall` when this was sent [s]
    thermometer   which one `temperature` [K] is of; NaN while it has none
    age           of the oldest of the currents when this was sent [s]
    line_errors   damaged frames since the last restart, wraps at 256
    rounds        of the I²C bus, wraps at 256
    """

    standing: Standing
    reason: Reason
    missing: int
    applied: tuple[float, float, float]
    currents: tuple[float, float, float]
    hall_axis: int
    hall_first: int
    hall: tuple[float, ...]
    hall_news: bool
    hall_age: float
    thermometer: int
    temperature: float
    age: float
    line_errors: int
    rounds: int

    @classmethod
    def parse(cls, payload: bytes) -> Reading:
        """From its payload. Raises DriverError if that has another length, or names a Hall group or a thermometer that
        there is not."""
        (
            state, why, missing, d0, d1, d2, i0, i1, i2, group, h0, h1, h2, h3, h4, thermometer, heat, age, hall_age,
            errors, rounds,
        ) = unpacked(_LAYOUT, payload, "reading")  # fmt: skip
        axis, block = divmod(group & ~_TOLD, len(BLOCKS))
        if axis >= _AXES or thermometer >= THERMOMETERS:
            raise DriverError(f"the firmware's reading names Hall group {group} and thermometer {thermometer}")
        codes = (h0, h1, h2, h3, h4) if block == 0 else (h0, h1, h2, h3)
        return cls(
            standing(state),
            reason(why),
            missing,
            (d0 / DUTY_STEPS, d1 / DUTY_STEPS, d2 / DUTY_STEPS),
            (i0 * 1e-3, i1 * 1e-3, i2 * 1e-3),
            axis,
            BLOCKS[block][0],
            tuple([_NAN if code == _NO_HALL else code / 4095.0 for code in codes]),
            group < _TOLD,
            hall_age * 1e-6,
            thermometer,
            _NAN if heat == _NO_TEMPERATURE else heat / 16 + 273.15,
            age * 1e-6,
            errors,
            rounds,
        )
