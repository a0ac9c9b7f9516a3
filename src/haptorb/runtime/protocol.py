"""What the frames between host and firmware say: commands one way, identity, limits, state and readings the other.

Byte layouts, states and times are in docs/reference/protocol.md; the firmware's side is `core/bridge.c`. Frames that
both sides must make and read alike are in `firmware/vectors/frames.txt`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from struct import Struct
from struct import error as StructError

import numpy as np
from numpy.typing import ArrayLike

from haptorb.errors import DriverError, InputError
from haptorb.physics.arrays import Array, finite
from haptorb.runtime.frames import Frame

__all__ = [
    "CHANNELS",
    "DUTY_FULL",
    "DUTY_STEPS",
    "ENGAGE_KEY",
    "HALL_SENSORS",
    "PROTOCOL_VERSION",
    "BoardLimits",
    "BoardState",
    "Command",
    "Identity",
    "Reading",
    "Reason",
    "Refusal",
    "Standing",
    "counts",
    "engage",
    "missing_chips",
    "set_duties",
]

PROTOCOL_VERSION = 1
CHANNELS = 3
HALL_SENSORS = 9
THERMOMETERS = 3
DUTY_FULL = 4095  #: greatest duty, in steps
DUTY_STEPS = 4096  #: steps in one PWM period: a duty of n steps is n / 4096 of the supply
ENGAGE_KEY = 0x5AFE
CALIBRATION_ID = 16  #: bytes

_NO_TEMPERATURE = 0x7FFF
_NO_HALL = 0xFFFF


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


class Standing(IntEnum):
    """What the firmware lets the coils do."""

    OFF = 0
    ENGAGED = 1
    TRIPPED = 2


class Reason(IntEnum):
    """Why the firmware switched off; `text` says what to do."""

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
        """One clause: what happened and what to look at.

        >>> Reason.SILENCE.text
        'the host was silent for 15 ms (a busy computer, or a cable pulled)'
        """
        return _REASONS[self]


_REASONS = {
    Reason.NONE: "no reason",
    Reason.SILENCE: "the host was silent for 15 ms (a busy computer, or a cable pulled)",
    Reason.LINE: "too many damaged frames on the serial line (check cable, ground and baud rate)",
    Reason.OVER_CURRENT: "a coil's current was above the limit (look for a short before going on)",
    Reason.HEAT: "a coil took more heat than it stands (let it cool)",
    Reason.HOT: "a coil's boundary is above 85 °C (let it cool, look at the fans)",
    Reason.CHIP: "the PWM chip or a current sensor stopped answering (check the I²C wiring)",
    Reason.BUS: "the I²C bus was held low (check the I²C wiring)",
    Reason.STOP_BUTTON: "the stop button is pressed, or its wire is open",
    Reason.HOST: "the host said so",
    Reason.POWER_ON: "it was just switched on",
    Reason.RESET_PIN: "it was reset by its pin (opening the port does that on an Arduino)",
    Reason.BROWN_OUT: "its supply sagged below 4.3 V (check the 5 V supply)",
    Reason.WATCHDOG: "its program hung and was restarted (please report it)",
}


class Refusal(IntEnum):
    """What the firmware answers to a command that changes its state."""

    ACCEPTED = 0
    KEY = 1
    TRIPPED = 2
    CHIP = 3
    STOP_BUTTON = 4
    ENGAGED = 5
    FRAME = 6


#: bit in `missing` → which part, where
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
    """The parts that do not answer, with their addresses.

    >>> missing_chips(0b100)
    ('current sensor INA219 of coil y at 0x44',)
    """
    return tuple(part for bit, part in enumerate(_PARTS) if mask >> bit & 1)


def counts(duties: ArrayLike) -> list[int]:
    """Duties (3,) in −1…1 [1] as signed PWM steps, clipped; what is not a number is zero.

    Raises InputError for another shape.

    >>> counts([0.5, -2.0, float("nan")])
    [2048, -4095, 0]
    """
    asked = np.asarray(duties, dtype=np.float64)
    if asked.shape != (CHANNELS,):
        raise InputError(f"duties must have one entry per coil, shape ({CHANNELS},); got shape {asked.shape}")
    return [0 if d != d else round(min(max(d * DUTY_STEPS, -DUTY_FULL), DUTY_FULL)) for d in asked.tolist()]


_SET = Struct("<3h")
_ENGAGE = Struct("<3H")


def set_duties(sequence: int, steps: list[int]) -> Frame:
    """The frame that sets the coils' duties, in signed steps."""
    return Frame(Command.SET, sequence, _SET.pack(*steps))


def engage(sequence: int, duty_limit: float = 1.0, current_limit: float = 65.5) -> Frame:
    """The frame that engages the coils for a session, at most `duty_limit` [1] and `current_limit` [A].

    The firmware never goes above its own limits, whatever is asked here.

    Raises InputError for a duty that is not above 0 and at most 1, or a current not above 0 and at most 65.5 A.
    """
    if not 0.0 < finite(duty_limit, "duty_limit") <= 1.0:
        raise InputError(f"duty_limit must be above 0 and at most 1; got {duty_limit}")
    if not 0.0 < finite(current_limit, "current_limit") <= 65.5:
        raise InputError(f"current_limit must be above 0 and at most 65.5 A; got {current_limit}")
    steps = min(round(duty_limit * DUTY_STEPS), DUTY_FULL)
    return Frame(Command.ENGAGE, sequence, _ENGAGE.pack(ENGAGE_KEY, steps, round(current_limit * 1e3)))


def _unpack(layout: Struct, payload: bytes, what: str) -> tuple[int, ...]:
    try:
        return layout.unpack(payload)
    except StructError as cause:
        raise DriverError(
            f"the firmware's {what} has {len(payload)} bytes where protocol {PROTOCOL_VERSION} has {layout.size}; "
            "flash the firmware that came with this version"
        ) from cause


def _known(kind: type[IntEnum], value: int) -> bool:
    return value in kind._value2member_map_


def _reason(value: int) -> Reason:
    return Reason(value) if _known(Reason, value) else Reason.NONE


def _standing(value: int) -> Standing:
    """A state that nobody knows is one in which nothing may be asked."""
    return Standing(value) if _known(Standing, value) else Standing.TRIPPED


@dataclass(frozen=True, slots=True)
class Identity:
    """Who answers at the other end of the line."""

    protocol: int
    version: tuple[int, int]
    board: str
    channels: int
    hall_sensors: int
    thermometers: int
    reset: Reason
    name: str
    calibration: bytes  #: of the calibration file that belongs to this device; zeros: none stored

    _LAYOUT = Struct("<8B8s16s")

    @classmethod
    def parse(cls, payload: bytes) -> Identity:
        """From the answer to IDENTIFY; DriverError if it is another protocol's."""
        if len(payload) < 1 or payload[0] != PROTOCOL_VERSION:
            other = payload[0] if payload else "none"
            raise DriverError(
                f"the firmware speaks protocol version {other}, this program version {PROTOCOL_VERSION}; "
                "flash the firmware that came with this version (`make firmware`)"
            )
        p, major, minor, board, channels, halls, thermometers, reset, name, calibration = cls._LAYOUT.unpack(
            _sized(cls._LAYOUT, payload, "identity")
        )
        boards = {1: "ATmega328P", 2: "ATmega2560"}
        return cls(
            p,
            (major, minor),
            boards.get(board, f"board {board}"),
            channels,
            halls,
            thermometers,
            _reason(reset),
            name.rstrip(b"\0").decode("ascii", "replace"),
            calibration,
        )


def _sized(layout: Struct, payload: bytes, what: str) -> bytes:
    _unpack(layout, payload, what)
    return payload


@dataclass(frozen=True, slots=True)
class BoardLimits:
    """What the firmware never exceeds, and what it was asked for in this session."""

    duty: float  #: [1]
    current: float  #: [A]
    session_duty: float  #: [1]
    session_current: float  #: [A]
    silence: float  #: [s]
    sustained_current: float  #: [A]
    heat: float  #: store above the sustained current [A²·s]
    boundary: float  #: thermometer limit [K]
    current_step: float  #: of one reading [A]

    _LAYOUT = Struct("<7Hh2H")

    @classmethod
    def parse(cls, payload: bytes) -> BoardLimits:
        """From the answer to LIMITS; DriverError if that has another length."""
        duty, current, s_duty, s_current, silence, sustained, heat, hot, _, step = _unpack(
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
    """The answer to ENGAGE, OFF and STORE."""

    standing: Standing
    reason: Reason
    missing: int
    refusal: Refusal

    _LAYOUT = Struct("<BBHB")

    @classmethod
    def parse(cls, payload: bytes) -> BoardState:
        """From its payload; DriverError if that has another length."""
        standing, reason, missing, refusal = _unpack(cls._LAYOUT, payload, "state")
        refused = Refusal(refusal) if _known(Refusal, refusal) else Refusal.FRAME
        return cls(_standing(standing), _reason(reason), missing, refused)


@dataclass(frozen=True, slots=True)
class Reading:
    """The answer to SET and READ.

    applied       (3,) duties that the coils have [1]
    currents      (3,) [A]
    hall_first    number of the first Hall sensor in `hall`
    hall          (4 or 5,) of the converter's range, 0…1; NaN before the first reading
    thermometer   which one `temperature` [K] is of; NaN while it has none
    age           of the oldest of the currents when this was sent [s]
    """

    standing: Standing
    reason: Reason
    missing: int
    applied: Array
    currents: Array
    hall_first: int
    hall: Array
    thermometer: int
    temperature: float
    age: float
    line_errors: int
    rounds: int

    _LAYOUT = Struct("<BBH3h3hB5HBhHBB")

    @classmethod
    def parse(cls, payload: bytes) -> Reading:
        """From its payload. Raises DriverError if that has another length, or names a Hall group or a thermometer that
        there is not."""
        values = _unpack(cls._LAYOUT, payload, "reading")
        group, thermometer = values[9], values[15]
        if group > 1 or thermometer >= THERMOMETERS:
            raise DriverError(f"the firmware's reading names Hall group {group} and thermometer {thermometer}")
        codes = np.array(values[10:15] if group == 0 else values[10:14], dtype=np.float64)
        codes[codes == _NO_HALL] = np.nan
        raw = values[16]
        return cls(
            _standing(values[0]),
            _reason(values[1]),
            values[2],
            np.array(values[3:6]) / DUTY_STEPS,
            np.array(values[6:9]) * 1e-3,
            0 if group == 0 else 5,
            codes / 4095.0,
            thermometer,
            float("nan") if raw == _NO_TEMPERATURE else raw / 16 + 273.15,
            values[17] * 1e-6,
            values[18],
            values[19],
        )
