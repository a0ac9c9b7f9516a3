"""INA219: the voltage over a coil's shunt, 10 µV a step, so 1 mA over 0.01 Ω.

The shunt register is read, not the current register: it needs no calibration in the chip, and a chip that loses its
supply for a moment then reads wrong for one conversion instead of zero permanently.
"""

from __future__ import annotations

from typing import final

from haptorb.errors import DriverError, InputError
from haptorb.runtime.drivers.i2c.i2c_bus import I2cBus

__all__ = ["ADDRESSES", "Ina219"]

ADDRESSES = (0x41, 0x44, 0x45)  #: of coils x, y, z

_CONFIG, _SHUNT = 0x00, 0x01
#: ±320 mV, 12 bits (532 µs), shunt only, continuous
_SETTING = 0x199D
_STEP = 10e-6  # [V]


@final
class Ina219:
    """Three bytes a reading: the register pointer stays where it was put.

    Raises InputError if `shunt` is not a resistance above 0 and below 10 [Ω].
    """

    def __init__(self, bus: I2cBus, address: int, shunt: float = 0.01) -> None:
        if not 0.0 < shunt < 10.0:
            raise InputError(f"shunt must be a resistance above 0 and below 10 Ω; got {shunt}")
        self._bus = bus
        self._address = address
        self._ampere = _STEP / shunt

    def setup(self) -> None:
        """Range, resolution, and the pointer on the shunt register; DriverError if this is no INA219."""
        at = self._address
        try:
            self._bus.transfer([(at, bytes((_CONFIG, _SETTING >> 8, _SETTING & 0xFF)))])
            (setting,) = self._bus.transfer([(at, bytes((_CONFIG,))), (at, 2)])
            self._bus.transfer([(at, bytes((_SHUNT,)))])
        except OSError as cause:
            raise DriverError(f"no INA219 (current sensor) at {at:#04x}; check wiring and address") from cause
        if int.from_bytes(setting, "big") != _SETTING:
            raise DriverError(f"the chip at {at:#04x} is not an INA219 (current sensor); check wiring and address")

    def current(self) -> float:
        """Mean current over the last conversion [A]."""
        (raw,) = self._bus.transfer([(self._address, 2)])
        return int.from_bytes(raw, "big", signed=True) * self._ampere
