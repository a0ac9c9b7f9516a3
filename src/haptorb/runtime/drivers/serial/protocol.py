"""What the host says to the firmware: its commands.

Byte layouts, states and times are in docs/reference/protocol.md; the firmware's side is `core/bridge.c`. Frames that
both sides must make and read alike are in `firmware/vectors/frames.txt`.
"""

from __future__ import annotations

from enum import IntEnum
from struct import Struct

import numpy as np

from haptorb.errors import InputError
from haptorb.numerics.arrays import check_finite
from haptorb.numerics.compiled import kernel
from haptorb.runtime.drivers.electronics import CHANNELS, DUTY_FULL, DUTY_STEPS
from haptorb.runtime.drivers.serial.frames import HEAD, Frame, Numbers, Octets, seal_frame

__all__ = [
    "ENGAGE_KEY",
    "PROTOCOL_VERSION",
    "READING",
    "SET_BYTES",
    "STATE",
    "Command",
    "engage",
    "set_duties",
    "set_line",
]

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
SET_BYTES = 13  #: of the frame with three duties


_ENGAGE = Struct("<3H")
_SET = int(Command.SET)


@kernel
def set_line(line: Octets, sequence: int, steps: Numbers) -> int:
    """Write the frame that sets the coils' duties, in signed steps (3,), to the front of `line`; its length."""
    for i in range(CHANNELS):
        line[HEAD + 2 * i], line[HEAD + 2 * i + 1] = steps[i] & 0xFF, steps[i] >> 8 & 0xFF
    return seal_frame(line, _SET, sequence, 2 * CHANNELS)


def set_duties(sequence: int, steps: list[int]) -> Frame:
    """The frame that sets the coils' duties, in signed steps."""
    line = np.empty(SET_BYTES, np.uint8)
    set_line(line, sequence, np.array(steps, np.int64))
    return Frame(Command.SET, sequence, line[HEAD : HEAD + 2 * CHANNELS].tobytes())


def engage(sequence: int, duty_limit: float = 1.0, current_limit: float = 65.5) -> Frame:
    """The frame that engages the coils for a session, at most `duty_limit` [1] and `current_limit` [A].

    The firmware never exceeds its own limits, whatever the host requests.

    Raises InputError for a duty that is not above 0 and at most 1, or a current not above 0 and at most 65.5 A.
    """
    if not 0.0 < check_finite(duty_limit, "duty_limit") <= 1.0:
        raise InputError(f"duty_limit must be above 0 and at most 1; got {duty_limit}")
    if not 0.0 < check_finite(current_limit, "current_limit") <= 65.5:
        raise InputError(f"current_limit must be above 0 and at most 65.5 A; got {current_limit}")
    steps = min(round(duty_limit * DUTY_STEPS), DUTY_FULL)
    return Frame(Command.ENGAGE, sequence, _ENGAGE.pack(ENGAGE_KEY, steps, round(current_limit * 1e3)))
