"""What the firmware has read: the answer to SET and READ, a thousand of them a second.

It comes out of the line in one compiled pass, into a record that is used again; `Reading` puts it in words.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from haptorb.errors import DriverError
from haptorb.numerics.arrays import Record, Records, fields
from haptorb.numerics.compiled import kernel
from haptorb.runtime.drivers.electronics import DUTY_STEPS, HALL_SENSORS, THERMOMETERS
from haptorb.runtime.drivers.serial.codes import BoardMode, Reason
from haptorb.runtime.drivers.serial.frames import HEAD, Numbers, Octets, find_frame
from haptorb.runtime.drivers.serial.protocol import PROTOCOL_VERSION, READING, STATE
from haptorb.runtime.drivers.serial.replies import board_mode, reason

__all__ = ["BLOCKS", "BOARD_READING", "READING_BYTES", "Reading", "Reply", "find_answer", "make_reading"]

#: first sensors and one past the last of what is read together: an axis of these
BLOCKS = ((0, 5), (5, HALL_SENSORS))

READING_BYTES = 36

_SECOND = BLOCKS[1][0]
_NO_TEMPERATURE = 0x7FFF
_NO_HALL = 0xFFFF
_REPEATED = 0x80  #: in the group's number: it has been reported before
_AXES = 3


#: A reading in SI.
BOARD_READING = fields(
    ("mode", "i8"),  # a BoardMode
    ("reason", "i8"),  # a Reason
    ("missing", "i8"),  # bits of the parts that do not answer
    ("applied", "f8", (3,)),  # duties that the coils have [1]
    ("currents", "f8", (3,)),  # [A]
    ("axis", "i8"),  # of the Hall readings: 0, 1, 2 for x, y, z
    ("first", "i8"),  # number of the first Hall sensor
    ("count", "i8"),  # of Hall sensors
    ("hall", "f8", (_SECOND,)),  # of the converter's range, 0…1; NaN before the first reading
    ("fresh", "?"),  # the Hall readings have not been reported before
    ("hall_age", "f8"),  # of them when this was sent [s]
    ("thermometer", "i8"),  # which one the temperature is of
    ("temperature", "f8"),  # [K]; NaN while it has none
    ("age", "f8"),  # of the oldest of the currents when this was sent [s]
    ("errors", "i8"),  # damaged frames since the last restart, wraps at 256
    ("rounds", "i8"),  # of the I²C bus, wraps at 256
)


class Reply(IntEnum):
    """What was found on the line."""

    NOTHING = 0  #: not yet
    READING = 1
    OTHER = 2  #: a state instead: the firmware did not take the command
    BENT = 3  #: a reading of another length, or of parts that there are not


def make_reading() -> Records:
    """(1,) BOARD_READING, zeros: nothing is driven, nothing is reported."""
    return np.zeros(1, BOARD_READING)


@kernel
def _read_unsigned(line: Octets, at: int) -> int:
    return int(line[at]) | int(line[at + 1]) << 8


@kernel
def _read_signed(line: Octets, at: int) -> int:
    value = _read_unsigned(line, at)
    return value - 65536 if value >= 32768 else value


@kernel
def _fill_reading(line: Octets, at: int, reading: Records) -> bool:
    """Fill `reading`, (1,) BOARD_READING, from the payload at `at`; False if it names what there is not."""
    group, thermometer = int(line[at + 16]), int(line[at + 27])
    axis, block = (group & (_REPEATED - 1)) // 2, group & 1
    if axis >= _AXES or thermometer >= THERMOMETERS:
        return False
    r = reading[0]
    r.mode, r.reason, r.missing = line[at], line[at + 1], _read_unsigned(line, at + 2)
    for i in range(3):
        r.applied[i] = _read_signed(line, at + 4 + 2 * i) / DUTY_STEPS
        r.currents[i] = _read_signed(line, at + 10 + 2 * i) * 1e-3
    r.axis, r.fresh = axis, group < _REPEATED
    r.first, r.count = (0, _SECOND) if block == 0 else (_SECOND, HALL_SENSORS - _SECOND)
    for i in range(_SECOND):
        code = _read_unsigned(line, at + 17 + 2 * i)
        r.hall[i] = np.nan if code == _NO_HALL else code / 4095.0
    heat = _read_signed(line, at + 28)
    r.thermometer, r.temperature = thermometer, np.nan if heat == _NO_TEMPERATURE else heat / 16 + 273.15
    r.age, r.hall_age = _read_unsigned(line, at + 30) * 1e-6, _read_unsigned(line, at + 32) * 1e-6
    r.errors, r.rounds = line[at + 34], line[at + 35]
    return True


@kernel
def find_answer(line: Octets, held: Records, first: int, last: int, reading: Records, at: Numbers) -> int:
    """Look on the line for the answer to a SET or READ numbered `first` to `last`; one fills `reading`. A `Reply`.

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
            return 1 if line[begin + 2] == READING_BYTES and _fill_reading(line, begin + HEAD, reading) else 3


class Reading(NamedTuple):
    """In SI.

    applied       (3,) duties that the coils have [1]
    currents      (3,) [A]
    hall_axis     of the Hall readings: 0, 1, 2 for x, y, z; 0 for radial sensors
    hall_first    number of the first Hall sensor in `hall`
    hall          (4 or 5,) of the converter's range, 0…1; NaN before the first reading
    hall_fresh    not reported before
    hall_age      of `hall` when this was sent [s]
    thermometer   which one `temperature` [K] is of; NaN while it has none
    age           of the oldest of the currents when this was sent [s]
    line_errors   damaged frames since the last restart, wraps at 256
    rounds        of the I²C bus, wraps at 256
    """

    mode: BoardMode
    reason: Reason
    missing: int
    applied: tuple[float, ...]
    currents: tuple[float, ...]
    hall_axis: int
    hall_first: int
    hall: tuple[float, ...]
    hall_fresh: bool
    hall_age: float
    thermometer: int
    temperature: float
    age: float
    line_errors: int
    rounds: int

    @classmethod
    def of(cls, reading: Records) -> Reading:
        """In words what `reading`, (1,) BOARD_READING, says in numbers."""
        r: Record = reading[0]
        count = int(r["count"])
        return cls(
            board_mode(int(r["mode"])), reason(int(r["reason"])), int(r["missing"]), tuple(r["applied"].tolist()),
            tuple(r["currents"].tolist()), int(r["axis"]), int(r["first"]), tuple(r["hall"][:count].tolist()),
            bool(r["fresh"]), float(r["hall_age"]), int(r["thermometer"]), float(r["temperature"]), float(r["age"]),
            int(r["errors"]), int(r["rounds"]),
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
        made = make_reading()
        if not _fill_reading(np.frombuffer(payload, np.uint8), 0, made):
            raise DriverError(
                f"the firmware's reading names Hall group {payload[16]} and thermometer {payload[27]}; one of them "
                "does not exist: flash the firmware that came with this version"
            )
        return cls.of(made)
