"""What the firmware has read: the answer to SET and READ, a thousand of them a second.

Numbers come out of the line in one compiled pass, into a row that is used again; `Reading` puts them in words.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from haptorb.errors import DriverError
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.runtime.drivers.serial.codes import BoardMode, Reason
from haptorb.runtime.drivers.serial.frames import HEAD, Numbers, Octets, find_frame
from haptorb.runtime.drivers.serial.protocol import (
    DUTY_STEPS,
    HALL_SENSORS,
    PROTOCOL_VERSION,
    READING,
    STATE,
    THERMOMETERS,
)
from haptorb.runtime.drivers.serial.replies import reason, standing

__all__ = ["BLOCKS", "READING_BYTES", "At", "Reading", "Reply", "find_answer", "reading_row"]

#: first sensors and one past the last of what is read together: an axis of these
BLOCKS = ((0, 5), (5, HALL_SENSORS))

READING_BYTES = 36

_SECOND = BLOCKS[1][0]
_NO_TEMPERATURE = 0x7FFF
_NO_HALL = 0xFFFF
_TOLD = 0x80  #: in the group's number: it has been told before
_AXES = 3


class At(IntEnum):
    """Where in a reading's row; three duties, three currents and five Hall shares follow one another."""

    STANDING = 0
    REASON = 1
    MISSING = 2
    APPLIED = 3
    CURRENTS = 6
    AXIS = 9
    FIRST = 10
    COUNT = 11
    HALL = 12
    NEWS = 17
    HALL_AGE = 18
    THERMOMETER = 19
    TEMPERATURE = 20
    AGE = 21
    ERRORS = 22
    ROUNDS = 23


_WIDTH = 24
# Plain numbers for kernels, where an enumeration's members are none.
_STANDING, _REASON, _MISSING, _APPLIED, _CURRENTS, _AXIS, _FIRST, _COUNT, _HALL, _NEWS, _HALL_AGE = (
    int(one) for one in list(At)[:11]
)
_THERMOMETER, _TEMPERATURE, _AGE, _ERRORS, _ROUNDS = (int(one) for one in list(At)[11:])


class Reply(IntEnum):
    """What was found on the line."""

    NOTHING = 0  #: not yet
    READING = 1
    OTHER = 2  #: a state instead: the firmware did not take the command
    BENT = 3  #: a reading of another length, or of parts that there are not


def reading_row() -> Array:
    """(24,) for a reading in SI [A, K, s, 1], zeros."""
    return np.zeros(_WIDTH)


@kernel
def _read_unsigned(line: Octets, at: int) -> int:
    return int(line[at]) | int(line[at + 1]) << 8


@kernel
def _read_signed(line: Octets, at: int) -> int:
    value = _read_unsigned(line, at)
    return value - 65536 if value >= 32768 else value


@kernel
def _fill_reading(line: Octets, at: int, row: Array) -> bool:
    """Fill `row` (24,) from the payload at `at`; False if it names what there is not."""
    group, thermometer = int(line[at + 16]), int(line[at + 27])
    axis, block = (group & (_TOLD - 1)) // 2, group & 1
    if axis >= _AXES or thermometer >= THERMOMETERS:
        return False
    row[_STANDING], row[_REASON], row[_MISSING] = line[at], line[at + 1], _read_unsigned(line, at + 2)
    for i in range(3):
        row[_APPLIED + i] = _read_signed(line, at + 4 + 2 * i) / DUTY_STEPS
        row[_CURRENTS + i] = _read_signed(line, at + 10 + 2 * i) * 1e-3
    row[_AXIS], row[_NEWS] = axis, group < _TOLD
    row[_FIRST], row[_COUNT] = (0, _SECOND) if block == 0 else (_SECOND, HALL_SENSORS - _SECOND)
    for i in range(_SECOND):
        code = _read_unsigned(line, at + 17 + 2 * i)
        row[_HALL + i] = np.nan if code == _NO_HALL else code / 4095.0
    heat = _read_signed(line, at + 28)
    row[_THERMOMETER], row[_TEMPERATURE] = thermometer, np.nan if heat == _NO_TEMPERATURE else heat / 16 + 273.15
    row[_AGE], row[_HALL_AGE] = _read_unsigned(line, at + 30) * 1e-6, _read_unsigned(line, at + 32) * 1e-6
    row[_ERRORS], row[_ROUNDS] = line[at + 34], line[at + 35]
    return True


@kernel
def find_answer(line: Octets, held: Numbers, first: int, last: int, row: Array, at: Numbers) -> int:
    """Look on the line for the answer to a SET or READ numbered `first` to `last`; a reading fills `row`. A `Reply`.

    Numbers begin again after 255. line, held as `frames.find_frame` takes them; at (1,): where the frame was found.
    """
    while True:
        begin = find_frame(line, held)
        at[0] = begin
        if begin < 0:
            return 0
        if (int(line[begin + 4]) - first) & 0xFF > (last - first) & 0xFF:
            continue
        if line[begin + 3] == STATE:
            return 2
        if line[begin + 3] == READING:
            return 1 if line[begin + 2] == READING_BYTES and _fill_reading(line, begin + HEAD, row) else 3


class Reading(NamedTuple):
    """In SI.

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

    standing: BoardMode
    reason: Reason
    missing: int
    applied: tuple[float, ...]
    currents: tuple[float, ...]
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
    def of(cls, row: Array) -> Reading:
        """In words what `row` (24,) says in numbers."""
        n = row.tolist()
        return cls(
            standing(int(n[At.STANDING])), reason(int(n[At.REASON])), int(n[At.MISSING]),
            tuple(n[At.APPLIED : At.APPLIED + 3]), tuple(n[At.CURRENTS : At.CURRENTS + 3]),
            int(n[At.AXIS]), int(n[At.FIRST]), tuple(n[At.HALL : At.HALL + int(n[At.COUNT])]), bool(n[At.NEWS]),
            n[At.HALL_AGE], int(n[At.THERMOMETER]), n[At.TEMPERATURE], n[At.AGE], int(n[At.ERRORS]), int(n[At.ROUNDS]),
        )  # fmt: skip

    @classmethod
    def parse(cls, payload: bytes) -> Reading:
        """From its payload. Raises DriverError if that has another length, or names a Hall group or a thermometer that
        there is not."""
        if len(payload) != READING_BYTES:
            raise DriverError(
                f"the firmware's reading has {len(payload)} bytes where protocol {PROTOCOL_VERSION} has "
                f"{READING_BYTES}; flash the firmware that came with this version"
            )
        row = reading_row()
        if not _fill_reading(np.frombuffer(payload, np.uint8), 0, row):
            raise DriverError(f"the firmware's reading names Hall group {payload[16]} and thermometer {payload[27]}")
        return cls.of(row)
