"""TCA9534: two outputs choose the axis of the Hall sensors that the multiplexers pass on to the converter; one more
keeps the monostable going that enables the PWM chip's outputs, and an input sees whether it does."""

from __future__ import annotations

from typing import final

from haptorb.errors import DriverError
from haptorb.runtime.drivers.i2c.i2c_bus import I2cBus

__all__ = ["ADDRESS", "HallSelect", "explain_absence"]

ADDRESS = 0x20

_INPUT, _OUTPUT, _CONFIGURATION = 0x00, 0x01, 0x03
_TRIGGER = 0x04  #: P2, the monostable's trigger: it restarts its pulse when this rises
_SENSE = 0x08  #: P3, the PWM chip's OE pin: low lets current flow
_PINS = 0x07  #: P0, P1 (axis) and P2 are driven; the other five stay inputs


def explain_absence(bus: str, hall_axes: int) -> str:
    """The message where no chip responds on `bus` although `hall_axes` axes are needed: what cannot be done, and the
    remedy."""
    text = f"nothing responds at {ADDRESS:#04x} on {bus}: without a TCA9534 "
    if hall_axes > 1:
        return text + f"and multiplexers the Hall sensors have 1 axis, and the tracker 'hall' needs {hall_axes}"
    return text + (
        "nothing can trigger the monostable on OE of the PCA9685, which switches off when this computer stops; "
        "wire both (docs: hardware), or accept the risk (--no-watchdog; in Python watchdog=False)"
    )


@final
class HallSelect:
    """The axis, 0 to 2, on P0 and P1, 3 bytes a change; a trigger on P2, 4 bytes; OE on P3."""

    def __init__(self, bus: I2cBus, address: int = ADDRESS) -> None:
        self._bus = bus
        self._address = address
        self._axis = -1
        self._level = 0  # of P2 between two triggers

    def present(self) -> bool:
        """Whether it answers; where it does not, there are no multiplexers and the sensors have one axis."""
        try:
            self._bus.transfer([(self._address, bytes((_CONFIGURATION,)))])
        except OSError:
            return False
        return True

    def setup(self) -> None:
        """Axis 0 selected, the trigger low. DriverError if the chip does not respond."""
        try:
            self._axis, self._level = -1, 0
            self.show(0)
            self._bus.transfer([(self._address, bytes((_CONFIGURATION, 0xFF & ~_PINS)))])
        except OSError as cause:
            raise DriverError(f"no TCA9534 (axes of the Hall sensors) at {self._address:#04x}; check wiring") from cause

    def show(self, axis: int) -> None:
        """Pass `axis` on from now on; nothing is written where it is shown already."""
        if axis != self._axis:
            self._bus.transfer([(self._address, bytes((_OUTPUT, axis | self._level)))])
            self._axis = axis

    def trigger(self) -> None:
        """Let P2 fall and rise, in one message: for one more pulse of the monostable the outputs are enabled."""
        axis = max(self._axis, 0)
        self._level = _TRIGGER
        fall_and_rise = (_OUTPUT, axis, axis | _TRIGGER)  # safety: i2c-trigger-edge
        self._bus.transfer([(self._address, bytes(fall_and_rise))])

    def is_enabled(self) -> bool:
        """Whether OE is low now."""
        (pins,) = self._bus.transfer([(self._address, bytes((_INPUT,))), (self._address, 1)])
        return not pins[0] & _SENSE
