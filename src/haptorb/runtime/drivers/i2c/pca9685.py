"""PCA9685: sixteen channels of 12-bit PWM; here three coils, outputs 0–2 their PWM, 3–5 their direction."""

from __future__ import annotations

from typing import final

from haptorb.errors import DriverError
from haptorb.runtime.drivers.i2c.i2c_bus import I2cBus

__all__ = ["ADDRESS", "ALL_OFF", "Pca9685"]

ADDRESS = 0x60  #: 0x40, where it comes from the shop, is a current sensor's

_MODE1, _MODE2, _LED0_OFF, _ALL_LED, _ALL_LED_OFF_H, _PRE_SCALE = 0x00, 0x01, 0x08, 0xFA, 0xFD, 0xFE
_SLEEP, _AUTO_INCREMENT = 0x10, 0x20
_TOTEM_POLE = 0x04  # outputs change at STOP, all together; low while OE is high
_FASTEST = 3  # 25 MHz / 4096 / (3 + 1) = 1526 Hz
_FULL = 0x10  # in a high byte: always on, or always off

#: one message that switches every output off, whatever the chip was doing: with and without auto-increment, the bit
#: "always off" wins over all others
ALL_OFF = bytes((_ALL_LED_OFF_H, _FULL))

_READ_BACK = 0x1E  # registers from MODE1 to LED5_OFF_H
_OFF_HIGH = slice(0x09, 0x1E, 4)  # LED0_OFF_H to LED5_OFF_H


def _pulse(steps: int) -> bytes:
    """OFF registers for a pulse of |steps| of 4096; zero is the chip's own "always off"."""
    size = abs(steps)
    return bytes((size & 0xFF, size >> 8 if size else _FULL))


@final
class Pca9685:
    """One burst per update; 11 bytes while no direction changes, else 23."""

    def __init__(self, bus: I2cBus, address: int = ADDRESS) -> None:
        self._bus = bus
        self._address = address
        self._negative: list[bool] | None = None  # directions as the chip has them; None: not known

    def _write(self, data: bytes) -> None:
        self._bus.transfer([(self._address, data)])

    def setup(self) -> None:
        """Every output off, then the oscillator at 1526 Hz; DriverError if the chip does not hold its settings."""
        self._negative = None
        try:
            self._start()
            confirmed = self._is_confirmed()
        except OSError as cause:
            raise DriverError(f"no PCA9685 (PWM) at {self._address:#04x}; check wiring and address") from cause
        if not confirmed:
            raise DriverError(f"the chip at {self._address:#04x} is not a PCA9685 (PWM); check wiring and address")

    def _start(self) -> None:
        self._write(ALL_OFF)  # before it sleeps: asleep, its outputs do not change
        self._write(bytes((_MODE1, _SLEEP | _AUTO_INCREMENT)))
        self._write(bytes((_PRE_SCALE, _FASTEST)))
        self._write(bytes((_MODE2, _TOTEM_POLE)))
        self._write(bytes((_MODE1, _AUTO_INCREMENT)))
        # The beginnings of the pulses too, which `write` does not move, and the values of a restart.
        self._write(bytes((_ALL_LED, 0, 0, 0, _FULL)))

    def write(self, steps: list[int]) -> None:
        """New duties, in signed steps of 1/4096."""
        before = self._negative
        negative = [s < 0 if s else (before[i] if before else False) for i, s in enumerate(steps)]
        data = bytes((_LED0_OFF,)) + _pulse(steps[0]) + b"".join(b"\0\0" + _pulse(s) for s in steps[1:])
        if negative != before:  # all outputs change together, at STOP
            data += b"".join(bytes((0, _FULL, 0, 0)) if minus else bytes((0, 0, 0, _FULL)) for minus in negative)
        self._negative = None  # until it is known to have arrived
        self._write(data)
        self._negative = negative

    def switch_off(self) -> bool:
        """Every output off; True if the chip confirms it: it reads back as the one that was set up, all of it off.

        One that does not, as after a loss of its supply, is set up again, outputs off. OSError if the chip does not
        respond.
        """
        self._negative = None
        self._write(ALL_OFF)
        if self._is_confirmed():
            return True
        self._start()
        return self._is_confirmed()

    def _is_confirmed(self) -> bool:
        """Whether it reads back as it was set up, and outputs 0 to 5 as always off. ALL_LED itself reads as zero."""
        (block,) = self._bus.transfer([(self._address, bytes((_MODE1,))), (self._address, _READ_BACK)])
        (scale,) = self._bus.transfer([(self._address, bytes((_PRE_SCALE,))), (self._address, 1)])
        as_set_up = block[_MODE1] == _AUTO_INCREMENT and block[_MODE2] == _TOTEM_POLE and scale[0] == _FASTEST
        return as_set_up and all(high & _FULL for high in block[_OFF_HIGH])  # safety: i2c-obeyed, i2c-set-up
