"""Serial protocol of the firmware: frames, commands and responses.

Byte layouts, states and times are in docs/reference/protocol.md; the firmware's side is `core/bridge.c`. Frames that
both sides must make and read alike are in `firmware/vectors/frames.txt`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from struct import Struct
from struct import error as StructError
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from haptorb.arrays import Record, Records, check_finite, fields
from haptorb.compiled import kernel
from haptorb.errors import DriverError, InputError
from haptorb.runtime.drivers.base import CHANNELS, DUTY_FULL, DUTY_STEPS, HALL_SENSORS, THERMOMETERS

__all__ = [
    "BLOCKS",
    "BOARD_READING",
    "ENGAGE_KEY",
    "HEAD",
    "HELD",
    "PAYLOAD_MAX",
    "PROTOCOL_VERSION",
    "READING",
    "READING_BYTES",
    "SET_BYTES",
    "STATE",
    "SYNC",
    "BoardLimits",
    "BoardMode",
    "BoardState",
    "Command",
    "Frame",
    "FrameParser",
    "Identity",
    "Numbers",
    "Octets",
    "Reading",
    "Reason",
    "Refusal",
    "Reply",
    "board_mode",
    "crc16",
    "encode",
    "engage",
    "explain_off",
    "find_answer",
    "find_frame",
    "make_reading",
    "missing_chips",
    "reason",
    "refusal",
    "seal_frame",
    "set_duties",
    "set_line",
    "unpack_payload",
]


# --------------------------------------------------------------------------------------------------
# Frames on the serial line: A5 5A, length, type, sequence, payload, CRC-16, as the firmware's `core/frame.c` has them.
#
# The check sum is CRC-16/CCITT-FALSE over length, type, sequence and payload, low byte first. Writing, finding and
# checking are compiled: code that runs once a millisecond runs with cold caches, where the interpreter takes six times
# as long as in a tight loop.


SYNC = b"\xa5\x5a"
PAYLOAD_MAX = 40  #: [bytes]
HEAD = 5  #: length before the payload [bytes]: sync, length, type, sequence

_TAIL = 2
_FRAME_MAX = HEAD + PAYLOAD_MAX + _TAIL
_CHUNK_BYTES = 512  #: read from the line at once

Octets = NDArray[np.uint8]
Numbers = NDArray[np.int64]

#: State of the receive buffer.
HELD = fields(
    ("begin", "i8"),  # the first byte that was not parsed
    ("end", "i8"),  # one past the last
    ("damaged", "i8"),  # count of damaged frames
)


class Frame(NamedTuple):
    """One message: type, sequence number and payload."""

    type: int
    sequence: int
    payload: bytes


@kernel
def _check(line: Octets, first: int, last: int) -> int:
    """CRC-16/CCITT-FALSE of the bytes `first` ≤ i < `last`; a whole byte at once, as `core/crc.c`."""
    crc = 0xFFFF
    for i in range(first, last):
        x = (crc >> 8) ^ line[i]
        x ^= x >> 4
        crc = ((crc << 8) ^ (x << 12) ^ (x << 5) ^ x) & 0xFFFF
    return crc


@kernel
def seal_frame(line: Octets, kind: int, sequence: int, length: int) -> int:
    """Add head and checksum to a payload of `length` bytes in `line` from HEAD on; return the frame's length."""
    line[0], line[1], line[2], line[3], line[4] = 0xA5, 0x5A, length, kind, sequence
    end = HEAD + length
    crc = _check(line, 2, end)
    line[end], line[end + 1] = crc & 0xFF, crc >> 8
    return end + _TAIL


@kernel
def find_frame(line: Octets, held: Records) -> int:
    """Find the next complete frame in `line`; return its index, or −1, with a partial frame moved to the front.

    held is (1,) HELD.
    """
    h = held[0]
    at, end = h.begin, h.end
    while True:
        while at < end and not (line[at] == 0xA5 and (at + 1 == end or line[at + 1] == 0x5A)):
            at += 1
        if end - at < 3:
            break
        length = line[at + 2]
        if length > PAYLOAD_MAX:
            h.damaged += 1
            at += 1
            continue
        last = at + HEAD + length
        if end < last + _TAIL:
            break
        if _check(line, at + 2, last) != line[last] | line[last + 1] << 8:  # safety: frame-damaged
            h.damaged += 1
            at += 1
            continue
        h.begin = last + _TAIL
        if h.begin == end:
            h.begin, h.end = 0, 0
        return int(at)
    for i in range(end - at):
        line[i] = line[at + i]
    h.begin, h.end = 0, end - at
    return -1


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF.

    >>> hex(crc16(b"123456789"))
    '0x29b1'
    """
    return int(_check(np.frombuffer(data, np.uint8), 0, len(data)))


def encode(frame: Frame) -> bytes:
    """Encode `frame` to bytes; InputError if its payload is too long or a number is not a byte.

    >>> encode(Frame(0x06, 6, b"")).hex(" ")
    'a5 5a 00 06 06 fc 06'
    """
    length = len(frame.payload)
    if length > PAYLOAD_MAX:
        raise InputError(f"a frame's payload has at most {PAYLOAD_MAX} bytes; got {length}")
    if not (0 <= frame.type <= 255 and 0 <= frame.sequence <= 255):
        raise InputError(f"a frame's type and sequence are bytes; got {frame.type} and {frame.sequence}")
    line = np.empty(_FRAME_MAX, np.uint8)
    line[HEAD : HEAD + length] = np.frombuffer(frame.payload, np.uint8)
    return line[: seal_frame(line, frame.type, frame.sequence, length)].tobytes()


@final
class FrameParser:
    """Finds frames in a stream of bytes. After a damaged one the search continues at the byte after its sync.

    It buffers at most one frame. Callers that read the line themselves write to `free_space` and then call `commit`;
    `line` and `held` are the arguments of `find_frame`.
    """

    def __init__(self) -> None:
        self.line = np.zeros(_FRAME_MAX + _CHUNK_BYTES, np.uint8)
        self.held = np.zeros(1, HELD)
        self._begin, self._end = self.held["begin"], self.held["end"]
        self._all = self.line.data
        find_frame(self.line, self.held)  # compiles in advance

    @property
    def bad_frames(self) -> int:
        """Number of frames with a wrong checksum or an invalid length."""
        return int(self.held["damaged"][0])

    @property
    def free_space(self) -> memoryview:
        """Buffer for the next bytes; never empty, as parsed bytes are discarded for it."""
        begin, end = int(self._begin[0]), int(self._end[0])
        if begin:
            self.line[: end - begin] = self.line[begin:end].copy()
            self._begin[0], self._end[0] = 0, end - begin
            return self._all[end - begin :]
        return self._all[end:]

    def commit(self, count: int) -> None:
        """Add `count` bytes that were written to `free_space`."""
        self._end[0] += count

    def frame(self, at: int) -> Frame:
        """Decode the frame at the index `at` of `find_frame`."""
        whole = self.line[at : at + HEAD + int(self.line[at + 2])].tobytes()
        return Frame(whole[3], whole[4], whole[HEAD:])

    def next(self) -> Frame | None:
        """Return the next complete frame of the received bytes."""
        at = find_frame(self.line, self.held)
        return None if at < 0 else self.frame(at)

    def feed(self, data: bytes) -> list[Frame]:
        """Add `data`, and return the complete frames.

        >>> parser = FrameParser()
        >>> parser.feed(b"noise" + encode(Frame(1, 2, b"x"))[:6]), parser.feed(encode(Frame(1, 2, b"x"))[6:])
        ([], [Frame(type=1, sequence=2, payload=b'x')])
        """
        frames = []
        for begin in range(0, len(data), _CHUNK_BYTES):
            part = data[begin : begin + _CHUNK_BYTES]
            self.free_space[: len(part)] = part
            self.commit(len(part))
            while (frame := self.next()) is not None:
                frames.append(frame)
        return frames


PROTOCOL_VERSION = 3
ENGAGE_KEY = 0x5AFE


class Command(IntEnum):
    """Types of frames from the host; the answer's type has bit 7 set."""

    IDENTIFY = 0x01
    LIMITS = 0x02
    SET = 0x03
    ENGAGE = 0x04
    OFF = 0x05
    READ = 0x06
    STORE = 0x07


READING = 0x83
STATE = 0x84
SET_BYTES = 13  #: length of the frame with three duties [bytes]


_ENGAGE = Struct("<3H")
_SET = int(Command.SET)


@kernel
def set_line(line: Octets, sequence: int, steps: Numbers) -> int:
    """Write the frame that sets the coils' duties, in signed steps (3,), to the front of `line`; return its length."""
    for i in range(CHANNELS):
        line[HEAD + 2 * i], line[HEAD + 2 * i + 1] = steps[i] & 0xFF, steps[i] >> 8 & 0xFF
    return seal_frame(line, _SET, sequence, 2 * CHANNELS)


def set_duties(sequence: int, steps: list[int]) -> Frame:
    """Make the frame that sets the coils' duties, in signed steps."""
    line = np.empty(SET_BYTES, np.uint8)
    set_line(line, sequence, np.array(steps, np.int64))
    return Frame(Command.SET, sequence, line[HEAD : HEAD + 2 * CHANNELS].tobytes())


def engage(sequence: int, duty_limit: float = 1.0, current_limit: float = 65.5) -> Frame:
    """Make the frame that engages the coils for a session, at most `duty_limit` [1] and `current_limit` [A].

    The firmware never exceeds its own limits, whatever the host requests.

    Raises InputError for a duty that is not above 0 and at most 1, or a current not above 0 and at most 65.5 A.
    """
    if not 0.0 < check_finite(duty_limit, "duty_limit") <= 1.0:
        raise InputError(f"duty_limit must be above 0 and at most 1; got {duty_limit}")
    if not 0.0 < check_finite(current_limit, "current_limit") <= 65.5:
        raise InputError(f"current_limit must be above 0 and at most 65.5 A; got {current_limit}")
    steps = min(round(duty_limit * DUTY_STEPS), DUTY_FULL)
    return Frame(Command.ENGAGE, sequence, _ENGAGE.pack(ENGAGE_KEY, steps, round(current_limit * 1e3)))


# --------------------------------------------------------------------------------------------------
# Codes of the firmware: state of the coils, reasons, refusals, and missing parts.


class BoardMode(IntEnum):
    """State of the coils in the firmware."""

    OFF = 0
    ENGAGED = 1
    TRIPPED = 2


class Reason(IntEnum):
    """Why the firmware switched off; `text` states what to do."""

    NONE = 0
    SILENCE = 1
    LINE = 2
    OVER_CURRENT = 3
    HEAT = 4
    HOT = 5
    CHIP = 6
    BUS = 7
    STOP_BUTTON = 8
    HOST = 9
    POWER_ON = 16
    RESET_PIN = 17
    BROWN_OUT = 18
    WATCHDOG = 19

    @property
    def text(self) -> str:
        """One clause: what happened and what to check.

        >>> Reason.SILENCE.text
        'the host was silent for 15 ms (a busy computer, or an unplugged cable)'
        """
        return _CODES_REASONS[self]


_CODES_REASONS = {
    Reason.NONE: "no reason",
    Reason.SILENCE: "the host was silent for 15 ms (a busy computer, or an unplugged cable)",
    Reason.LINE: "too many damaged frames on the serial line (check cable, ground and baud rate)",
    Reason.OVER_CURRENT: "a coil's current was above the limit (look for a short circuit before you continue)",
    Reason.HEAT: "a coil exceeded its heat limit (let it cool)",
    Reason.HOT: "a coil's boundary is above 85 °C (let it cool, check the fans)",
    Reason.CHIP: "the PWM chip or a current sensor stopped responding (check the I²C wiring)",
    Reason.BUS: "the I²C bus was held low (check the I²C wiring)",
    Reason.STOP_BUTTON: "the stop button is pressed, or its wire is open",
    Reason.HOST: "the host commanded it",
    Reason.POWER_ON: "it was powered on",
    Reason.RESET_PIN: "it was reset by its pin (opening the port does that on an Arduino)",
    Reason.BROWN_OUT: "its supply dropped below 4.3 V (check the 5 V supply)",
    Reason.WATCHDOG: "its program hung and was restarted (please report it)",
}


class Refusal(IntEnum):
    """Response of the firmware to a command that changes its state."""

    ACCEPTED = 0
    KEY = 1
    TRIPPED = 2
    CHIP = 3
    STOP_BUTTON = 4
    ENGAGED = 5
    FRAME = 6
    HOT = 7
    THERMOMETER = 8
    WRITING = 9
    EEPROM = 10


#: bit in `missing` → part and address
_PARTS = (
    "PWM driver PCA9685 at 0x60",
    "current sensor INA219 of coil x at 0x41",
    "current sensor INA219 of coil y at 0x44",
    "current sensor INA219 of coil z at 0x45",
    "Hall converter MAX11616 at 0x35",
    "thermometer DS18B20 of coil x on D5",
    "thermometer DS18B20 of coil y on D6",
    "thermometer DS18B20 of coil z on D7",
)


def missing_chips(mask: int) -> tuple[str, ...]:
    """Parts that do not respond, with their addresses.

    >>> missing_chips(0b100)
    ('current sensor INA219 of coil y at 0x44',)
    """
    return tuple(part for bit, part in enumerate(_PARTS) if mask >> bit & 1)


# --------------------------------------------------------------------------------------------------
# Responses on the firmware itself: identity, limits, state.


def unpack_payload(layout: Struct, payload: bytes, what: str) -> tuple[int, ...]:
    """Unpack the `payload` of a firmware's `what`; DriverError if it has another length."""
    try:
        return layout.unpack(payload)
    except StructError as cause:
        raise DriverError(
            f"the firmware's {what} has {len(payload)} bytes where protocol {PROTOCOL_VERSION} has {layout.size}; "
            "flash the firmware that came with this version"
        ) from cause


_REPLIES_REASONS = {int(one): one for one in Reason}
_STANDINGS = {int(one): one for one in BoardMode}
_REFUSALS = {int(one): one for one in Refusal}


def reason(value: int) -> Reason:
    """Convert `value` to a reason; NONE for an unknown one."""
    return _REPLIES_REASONS.get(value, Reason.NONE)


def board_mode(value: int) -> BoardMode:
    """Convert `value` to a state; in an unknown one, no current may be requested."""
    return _STANDINGS.get(value, BoardMode.TRIPPED)


@dataclass(frozen=True, slots=True)
class Identity:
    """Identity of the connected device."""

    protocol: int
    version: tuple[int, int]
    board: str
    channels: int
    hall_sensors: int  #: number of positions
    hall_axes: int  #: axes of each: 3, or 1, the radial one
    thermometers: int
    reset: Reason
    name: str
    calibration: bytes  #: of the calibration file that belongs to this device; zeros: none stored

    _LAYOUT = Struct("<9B8s16s")

    @classmethod
    def parse(cls, payload: bytes) -> Identity:
        """Parse the response to IDENTIFY; DriverError if it has another protocol."""
        if len(payload) < 1 or payload[0] != PROTOCOL_VERSION:
            other = payload[0] if payload else "none"
            raise DriverError(
                f"the firmware speaks protocol version {other}, this program version {PROTOCOL_VERSION}; "
                "flash the firmware that came with this version (`make firmware`)"
            )
        unpack_payload(cls._LAYOUT, payload, "identity")
        p, major, minor, board, channels, halls, axes, thermometers, reset, *texts = cls._LAYOUT.unpack(payload)
        name, calibration = texts
        boards = {1: "ATmega328P", 2: "ATmega2560"}
        return cls(
            p,
            (major, minor),
            boards.get(board, f"board {board}"),
            channels,
            halls,
            axes,
            thermometers,
            reason(reset),
            name.rstrip(b"\0").decode("ascii", "replace"),
            calibration,
        )


@dataclass(frozen=True, slots=True)
class BoardLimits:
    """Limits of the firmware, and those requested for this session."""

    duty: float  #: [1]
    current: float  #: [A]
    session_duty: float  #: [1]
    session_current: float  #: [A]
    silence: float  #: [s]
    sustained_current: float  #: [A]
    heat: float  #: heat budget above the sustained current [A²·s]
    boundary: float  #: thermometer limit [K]
    current_step: float  #: resolution of a current [A]

    _LAYOUT = Struct("<7Hh2H")

    @classmethod
    def parse(cls, payload: bytes) -> BoardLimits:
        """Parse the response to LIMITS; DriverError if it has another length."""
        duty, current, s_duty, s_current, silence, sustained, heat, hot, _, step = unpack_payload(
            cls._LAYOUT, payload, "limits"
        )
        return cls(
            duty / DUTY_STEPS,
            current * 1e-3,
            s_duty / DUTY_STEPS,
            s_current * 1e-3,
            silence * 1e-3,
            sustained * 1e-3,
            float(heat),
            hot / 16 + 273.15,
            step * 1e-6,
        )


@dataclass(frozen=True, slots=True)
class BoardState:
    """Response to ENGAGE, OFF and STORE."""

    mode: BoardMode
    reason: Reason
    missing: int
    refusal: Refusal

    _LAYOUT = Struct("<BBHB")

    @classmethod
    def parse(cls, payload: bytes) -> BoardState:
        """Parse its payload; DriverError if it has another length."""
        state, why, missing, refusal = unpack_payload(cls._LAYOUT, payload, "state")
        return cls(board_mode(state), reason(why), missing, _REFUSALS.get(refusal, Refusal.FRAME))


# --------------------------------------------------------------------------------------------------
# Readings of the firmware: the response to SET and READ, a thousand a second.
#
# Parsed in one compiled pass into a reused record; `Reading` is the readable form.


#: sensors that are read together: first and one past the last; one axis each
BLOCKS = ((0, 5), (5, HALL_SENSORS))

READING_BYTES = 36

_SECOND = BLOCKS[1][0]
_NO_TEMPERATURE = 0x7FFF
_NO_HALL = 0xFFFF
_REPEATED = 0x80  #: flag in the group's number: it has been reported before
_AXES = 3


#: A reading in SI units.
BOARD_READING = fields(
    ("mode", "i8"),  # a BoardMode
    ("reason", "i8"),  # a Reason
    ("missing", "i8"),  # bits of the parts that do not respond
    ("applied", "f8", (3,)),  # applied duties [1]
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
    """Result of `find_answer`."""

    NOTHING = 0  #: not yet
    READING = 1
    OTHER = 2  #: a state instead: the firmware did not accept the command
    BENT = 3  #: a reading of another length, or with invalid indices


def make_reading() -> Records:
    """Make a (1,) BOARD_READING of zeros: coils off, no new readings."""
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
    """Fill `reading`, (1,) BOARD_READING, from the payload at `at`; False if it contains invalid indices."""
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
    """Find the response to a SET or READ numbered `first` to `last`, and fill `reading`; return a `Reply`.

    Numbers wrap after 255. line, held as for `find_frame`; at (1,): index of the frame.
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
    """A reading in SI units.

    applied       (3,) applied duties [1]
    currents      (3,) [A]
    hall_axis     of the Hall readings: 0, 1, 2 for x, y, z; 0 for radial sensors
    hall_first    number of the first Hall sensor in `hall`
    hall          (4 or 5,) of the converter's range, 0…1; NaN before the first reading
    hall_fresh    whether `hall` was not reported before
    hall_age      age of `hall` when this was sent [s]
    thermometer   which one `temperature` [K] is of; NaN while it has none
    age           age of the oldest of the currents when this was sent [s]
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
        """Convert `reading`, (1,) BOARD_READING."""
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
        """Parse its payload. DriverError if it has another length, or contains an invalid Hall group or thermometer."""
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


# --------------------------------------------------------------------------------------------------
# Messages: why the firmware allows no current, in one clause.


_THERMOMETERS = 0xE0  #: mask of the thermometers
_NEEDED = 0x0F  #: mask of the parts without which no current is allowed


def explain_off(reading: Reading, engaged: bool) -> str:
    """Explain a trip, or an unrequested restart while `engaged`; empty if neither occurred.

    >>> from haptorb.runtime.drivers.serial_protocol import make_reading
    >>> explain_off(Reading.of(make_reading()), engaged=True)
    'the firmware is off without a command: no reason'
    """
    if reading.mode is BoardMode.TRIPPED:
        parts = missing_chips(reading.missing & _NEEDED) if reading.reason is Reason.CHIP else ()
        detail = f": {', '.join(parts)}" if parts else ""
        return f"the firmware switched the coils off: {reading.reason.text}{detail}"
    if engaged and reading.mode is BoardMode.OFF:  # safety: firmware-restarted
        return f"the firmware is off without a command: {reading.reason.text}"
    return ""


def refusal(state: BoardState) -> str:
    """Explain why the firmware refused the command to which it responded with `state`; empty if it accepted it."""
    if state.refusal is Refusal.ACCEPTED:
        return ""
    reasons = {
        Refusal.STOP_BUTTON: Reason.STOP_BUTTON.text,
        Refusal.CHIP: "not ready: " + (", ".join(missing_chips(state.missing & _NEEDED)) or "try again"),
        Refusal.TRIPPED: f"it tripped: {state.reason.text}",
        Refusal.HOT: Reason.HOT.text,
        Refusal.THERMOMETER: "the coil temperature is unknown: "
        + (", ".join(missing_chips(state.missing & _THERMOMETERS)) or "a thermometer")
        + " has sent nothing for 4 s (check its wire; after a restart wait two seconds)",
        Refusal.WRITING: "its calibration is being written (try again)",
        Refusal.EEPROM: "its EEPROM does not store data: the chip may be worn out",
    }
    return reasons.get(state.refusal, state.refusal.name)
