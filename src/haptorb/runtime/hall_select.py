"""TCA9534: two outputs that choose which axis of the Hall sensors the multiplexers pass on to the converter."""

from __future__ import annotations

from typing import final

from haptorb.errors import DriverError
from haptorb.runtime.i2c_bus import I2cBus

__all__ = ["ADDRESS", "HallSelect"]

ADDRESS = 0x20

_OUTPUT, _CONFIGURATION = 0x01, 0x03
_PINS = 0x03  #: P0 and P1 drive the select lines; the other six stay inputs


@final
class HallSelect:
    """The axis, 0 to 2, on P0 and P1; 3 bytes a change."""

    def __init__(self, bus: I2cBus, address: int = ADDRESS) -> None:
        self._bus = bus
        self._address = address
        self._axis = -1

    def present(self) -> bool:
        """Whether it answers; where it does not, there are no multiplexers and the sensors have one axis."""
        try:
            self._bus.transfer([(self._address, bytes((_CONFIGURATION,)))])
        except OSError:
            return False
        return True

    def setup(self) -> None:
        """Axis 0 shown. DriverError if nobody answers."""
        try:
            self._axis = -1
            self.show(0)
            self._bus.transfer([(self._address, bytes((_CONFIGURATION, 0xFF & ~_PINS)))])
        except OSError as cause:
            raise DriverError(f"no TCA9534 (axes of the Hall sensors) at {self._address:#04x}; check wiring") from cause

    def show(self, axis: int) -> None:
        """Pass `axis` on from now on; nothing is written where it is shown already."""
        if axis != self._axis:
            self._bus.transfer([(self._address, bytes((_OUTPUT, axis)))])
            self._axis = axis
