"""Numbers of the firmware that stand for words: what it lets the coils do, why not, and which part does not answer."""

from __future__ import annotations

from enum import IntEnum

__all__ = ["BoardMode", "Reason", "Refusal", "missing_chips"]


class BoardMode(IntEnum):
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
        'the host was silent for 15 ms (a busy computer, or an unplugged cable)'
        """
        return _REASONS[self]


_REASONS = {
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
    """What the firmware answers to a command that changes its state."""

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
