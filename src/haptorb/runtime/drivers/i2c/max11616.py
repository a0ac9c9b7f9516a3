"""MAX11616/MAX11617: twelve channels of 12 bits; nine Hall inputs on the two blocks that the chip can scan."""

from __future__ import annotations

from typing import final

from haptorb.errors import DriverError
from haptorb.runtime.drivers.i2c.i2c_bus import I2cBus

__all__ = ["ADDRESS", "BLOCKS", "HallAdc"]

ADDRESS = 0x35

#: first sensors and one past the last of each scan: 0–4 on AIN0–AIN4, 5–8 on AIN6–AIN9
BLOCKS = ((0, 5), (5, 9))

_SETUP = bytes((0x8A,))  # against the supply, conversions clocked by SCL (no stretching), unipolar
_SCANS = (bytes((0x09,)), bytes((0x53,)))  # up from AIN0 to AIN4; up from AIN6 to AIN9


@final
class HallAdc:
    """One block of sensors a reading, 13 or 11 bytes."""

    def __init__(self, bus: I2cBus, address: int = ADDRESS) -> None:
        self._bus = bus
        self._address = address

    def setup(self) -> None:
        """DriverError if the chip does not respond, or does not mark its codes as this chip does."""
        try:
            self._bus.transfer([(self._address, _SETUP)])
            (raw,) = self._bus.transfer([(self._address, _SCANS[0]), (self._address, 10)])
        except OSError as cause:
            raise DriverError(f"no MAX11616 (Hall sensors) at {self._address:#04x}; check wiring") from cause
        if any(byte >> 4 != 0xF for byte in raw[::2]):
            raise DriverError(f"the chip at {self._address:#04x} is not a MAX11616 (Hall sensors); check wiring")

    def read(self, block: int) -> tuple[float, ...]:
        """(5,) or (4,) the inputs of `block`, in shares of the supply, 0…1 [1]."""
        first, last = BLOCKS[block]
        (raw,) = self._bus.transfer([(self._address, _SCANS[block]), (self._address, 2 * (last - first))])
        return tuple([((high & 0x0F) << 8 | low) / 4095.0 for high, low in zip(raw[::2], raw[1::2], strict=True)])
