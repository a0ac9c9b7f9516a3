"""What the firmware says of itself: who it is, what it never exceeds, what it lets the coils do."""

from __future__ import annotations

from dataclasses import dataclass
from struct import Struct
from struct import error as StructError

from haptorb.errors import DriverError
from haptorb.runtime.drivers.electronics import DUTY_STEPS
from haptorb.runtime.drivers.serial.codes import BoardMode, Reason, Refusal
from haptorb.runtime.drivers.serial.protocol import PROTOCOL_VERSION

__all__ = ["BoardLimits", "BoardState", "Identity", "board_mode", "reason", "unpack_payload"]


def unpack_payload(layout: Struct, payload: bytes, what: str) -> tuple[int, ...]:
    """The numbers in the `payload` of a firmware's `what`; DriverError if that has another length."""
    try:
        return layout.unpack(payload)
    except StructError as cause:
        raise DriverError(
            f"the firmware's {what} has {len(payload)} bytes where protocol {PROTOCOL_VERSION} has {layout.size}; "
            "flash the firmware that came with this version"
        ) from cause


_REASONS = {int(one): one for one in Reason}
_STANDINGS = {int(one): one for one in BoardMode}
_REFUSALS = {int(one): one for one in Refusal}


def reason(value: int) -> Reason:
    """The reason `value`; NONE for an unknown one."""
    return _REASONS.get(value, Reason.NONE)


def board_mode(value: int) -> BoardMode:
    """The state `value`; in an unknown one, no current may be requested."""
    return _STANDINGS.get(value, BoardMode.TRIPPED)


@dataclass(frozen=True, slots=True)
class Identity:
    """Who answers at the other end of the line."""

    protocol: int
    version: tuple[int, int]
    board: str
    channels: int
    hall_sensors: int  #: places
    hall_axes: int  #: of each: 3, or 1, the radial one
    thermometers: int
    reset: Reason
    name: str
    calibration: bytes  #: of the calibration file that belongs to this device; zeros: none stored

    _LAYOUT = Struct("<9B8s16s")

    @classmethod
    def parse(cls, payload: bytes) -> Identity:
        """From the answer to IDENTIFY; DriverError if it is another protocol's."""
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
    """The answer to ENGAGE, OFF and STORE."""

    mode: BoardMode
    reason: Reason
    missing: int
    refusal: Refusal

    _LAYOUT = Struct("<BBHB")

    @classmethod
    def parse(cls, payload: bytes) -> BoardState:
        """From its payload; DriverError if that has another length."""
        state, why, missing, refusal = unpack_payload(cls._LAYOUT, payload, "state")
        return cls(board_mode(state), reason(why), missing, _REFUSALS.get(refusal, Refusal.FRAME))
