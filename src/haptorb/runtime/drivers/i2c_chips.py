"""I²C bus and chip drivers: PWM, current sensors, Hall converter, axis selection and monostable."""

from __future__ import annotations

import errno
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol, TypeAlias, final

from haptorb.errors import DriverError, InputError

__all__ = [
    "ADDRESS",
    "ADDRESSES",
    "ALL_OFF",
    "BLOCKS",
    "MAX11616_ADDRESS",
    "MAX_PULSE_S",
    "MIN_PULSE_S",
    "TCA9534_ADDRESS",
    "HallAdc",
    "HallSelect",
    "I2cBus",
    "Ina219",
    "LinuxBus",
    "Message",
    "Pca9685",
    "bus_list",
    "check_output_enable",
    "explain_absence",
    "pulse",
]


#: address, and the bytes to write or the number of bytes to read
Message: TypeAlias = tuple[int, bytes | int]

_SET_TIMEOUT, _TIMEOUT = 0x0702, 1  #: I2C_TIMEOUT, in units of 10 ms


class I2cBus(Protocol):
    """Transfers messages joined by repeated STARTs, one STOP at the end; real through Linux or simulated."""

    def transfer(self, messages: Sequence[Message]) -> list[bytes]:
        """Transfer `messages`; return the bytes read, in order. OSError without an acknowledgement."""

    def close(self) -> None:
        """May be called twice."""


def bus_list() -> list[int]:
    """Numbers of the I²C buses of this computer that programs may access."""
    return sorted(int(path.name[4:]) for path in Path("/dev").glob("i2c-*") if path.name[4:].isdecimal())


@final
class LinuxBus:
    """/dev/i2c-N through smbus2. A Raspberry Pi's controller supports one read per transfer, as its last message.

    Raises DriverError if smbus2 is not installed, or if the bus does not exist or may not be opened.
    """

    def __init__(self, number: int) -> None:
        try:
            import smbus2
        except ImportError as cause:
            raise DriverError(
                "an I²C bus needs the package smbus2; install it with `pip install 'haptorb[hardware]'`"
            ) from cause
        self._messages: Any = smbus2.i2c_msg
        self.number = number
        self._bus: Any
        try:
            self._bus = smbus2.SMBus(number)
        except OSError as cause:
            raise _explain_bus_error(number, cause) from cause
        # A shorter timeout than the kernel's default of 1 s: every try to switch off waits for a transfer that hangs.
        # Controllers without this setting are not changed.
        import fcntl  # not at the top: Windows has none

        with suppress(OSError, TypeError):
            fcntl.ioctl(self._bus.fd, _SET_TIMEOUT, _TIMEOUT)

    def transfer(self, messages: Sequence[Message]) -> list[bytes]:
        """Transfer `messages` in one system call."""
        make = self._messages
        carried = [make.read(to, what) if isinstance(what, int) else make.write(to, what) for to, what in messages]
        self._bus.i2c_rdwr(*carried)
        return [bytes(one) for one, (_, what) in zip(carried, messages, strict=True) if isinstance(what, int)]

    def close(self) -> None:
        """May be called twice."""
        with suppress(OSError, TypeError):
            self._bus.close()


def _explain_bus_error(number: int, cause: OSError) -> DriverError:
    path = f"/dev/i2c-{number}"
    if cause.errno in (errno.EACCES, errno.EPERM):
        return DriverError(
            f"no permission to open {path}: join its group with `sudo usermod -aG i2c $USER`, then log out and in again"
        )
    if cause.errno == errno.ENOENT:
        there = ", ".join(f"i2c:{one}" for one in bus_list()) or "none"
        return DriverError(f"there is no bus {path} (switch I²C on with `raspi-config`); buses here: {there}")
    return DriverError(f"cannot open {path}: {cause}")


# --------------------------------------------------------------------------------------------------
# PCA9685: sixteen channels of 12-bit PWM, for three coils: outputs 0–2 their PWM, 3–5 their direction.


ADDRESS = 0x60  #: the default, 0x40, is that of a current sensor

_MODE1, _MODE2, _LED0_OFF, _ALL_LED, _ALL_LED_OFF_H, _PRE_SCALE = 0x00, 0x01, 0x08, 0xFA, 0xFD, 0xFE
_SLEEP, _AUTO_INCREMENT = 0x10, 0x20
_TOTEM_POLE = 0x04  # outputs change at STOP, simultaneously; low while OE is high
_FASTEST = 3  # 25 MHz / 4096 / (3 + 1) = 1526 Hz
_FULL = 0x10  # in a high byte: always on or always off

#: one message that switches every output off in any state of the chip: with and without auto-increment, the bit
#: "always off" overrides all others
ALL_OFF = bytes((_ALL_LED_OFF_H, _FULL))

_READ_BACK = 0x1E  # registers from MODE1 to LED5_OFF_H
_OFF_HIGH = slice(0x09, 0x1E, 4)  # LED0_OFF_H to LED5_OFF_H


def _pulse(steps: int) -> bytes:
    """OFF registers for a pulse of |steps| of 4096; zero is the chip's "always off"."""
    size = abs(steps)
    return bytes((size & 0xFF, size >> 8 if size else _FULL))


@final
class Pca9685:
    """PWM chip: one burst per update, 11 bytes while no direction changes, else 23."""

    def __init__(self, bus: I2cBus, address: int = ADDRESS) -> None:
        self._bus = bus
        self._address = address
        self._negative: list[bool] | None = None  # directions in the chip; None: unknown

    def _write(self, data: bytes) -> None:
        self._bus.transfer([(self._address, data)])

    def setup(self) -> None:
        """Switch every output off, then set 1526 Hz; DriverError if the chip does not read back its settings."""
        self._negative = None
        try:
            self._start()
            confirmed = self._is_confirmed()
        except OSError as cause:
            raise DriverError(f"no PCA9685 (PWM) at {self._address:#04x}; check wiring and address") from cause
        if not confirmed:
            raise DriverError(f"the chip at {self._address:#04x} is not a PCA9685 (PWM); check wiring and address")

    def _start(self) -> None:
        self._write(ALL_OFF)  # before sleep mode, in which outputs do not change
        self._write(bytes((_MODE1, _SLEEP | _AUTO_INCREMENT)))
        self._write(bytes((_PRE_SCALE, _FASTEST)))
        self._write(bytes((_MODE2, _TOTEM_POLE)))
        self._write(bytes((_MODE1, _AUTO_INCREMENT)))
        # Also the starts of the pulses, which `write` does not change, and the values of a restart.
        self._write(bytes((_ALL_LED, 0, 0, 0, _FULL)))

    def write(self, steps: list[int]) -> None:
        """Write new duties, in signed steps of 1/4096."""
        before = self._negative
        negative = [s < 0 if s else (before[i] if before else False) for i, s in enumerate(steps)]
        data = bytes((_LED0_OFF,)) + _pulse(steps[0]) + b"".join(b"\0\0" + _pulse(s) for s in steps[1:])
        if negative != before:  # all outputs change simultaneously, at STOP
            data += b"".join(bytes((0, _FULL, 0, 0)) if minus else bytes((0, 0, 0, _FULL)) for minus in negative)
        self._negative = None  # until the write is acknowledged
        self._write(data)
        self._negative = negative

    def switch_off(self) -> bool:
        """Switch every output off; True if the chip confirms it: it reads back its configuration, all outputs off.

        A chip that has lost its configuration, as after a loss of its supply, is configured again, outputs off. OSError
        if the chip does not respond.
        """
        self._negative = None
        self._write(ALL_OFF)
        if self._is_confirmed():
            return True
        self._start()
        return self._is_confirmed()

    def _is_confirmed(self) -> bool:
        """Whether it reads back its configuration, and outputs 0 to 5 as always off. ALL_LED itself reads as zero."""
        (block,) = self._bus.transfer([(self._address, bytes((_MODE1,))), (self._address, _READ_BACK)])
        (scale,) = self._bus.transfer([(self._address, bytes((_PRE_SCALE,))), (self._address, 1)])
        as_set_up = block[_MODE1] == _AUTO_INCREMENT and block[_MODE2] == _TOTEM_POLE and scale[0] == _FASTEST
        return as_set_up and all(high & _FULL for high in block[_OFF_HIGH])  # safety: i2c-obeyed, i2c-set-up


# --------------------------------------------------------------------------------------------------
# INA219: the voltage over a coil's shunt, resolution 10 µV, so 1 mA over 0.01 Ω.
#
# The shunt register is read, not the current register: it needs no calibration in the chip, and a chip that loses its
# supply for a moment is then wrong for one conversion instead of reading zero permanently.


ADDRESSES = (0x41, 0x44, 0x45)  #: of coils x, y, z

_CONFIG, _SHUNT = 0x00, 0x01
#: ±320 mV, 12 bits (532 µs), shunt only, continuous
_SETTING = 0x199D
_RESOLUTION_V = 10e-6  # resolution


@final
class Ina219:
    """Current sensor, three bytes a reading: the register pointer remains set.

    Raises InputError if `shunt` is not a resistance above 0 and below 10 [Ω].
    """

    def __init__(self, bus: I2cBus, address: int, shunt: float = 0.01) -> None:
        if not 0.0 < shunt < 10.0:
            raise InputError(f"shunt must be a resistance above 0 and below 10 Ω; got {shunt}")
        self._bus = bus
        self._address = address
        self._ampere = _RESOLUTION_V / shunt

    def setup(self) -> None:
        """Set range, resolution, and the pointer to the shunt register; DriverError if this is not an INA219."""
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


# --------------------------------------------------------------------------------------------------
# MAX11616/MAX11617: twelve channels of 12 bits; nine Hall inputs in the two blocks that the chip can scan.


MAX11616_ADDRESS = 0x35

#: first sensors and one past the last of each scan: 0–4 on AIN0–AIN4, 5–8 on AIN6–AIN9
BLOCKS = ((0, 5), (5, 9))

_SETUP = bytes((0x8A,))  # supply as reference, conversions clocked by SCL (no stretching), unipolar
_SCANS = (bytes((0x09,)), bytes((0x53,)))  # up from AIN0 to AIN4; up from AIN6 to AIN9


@final
class HallAdc:
    """Hall converter: one block of sensors a reading, 13 or 11 bytes."""

    def __init__(self, bus: I2cBus, address: int = MAX11616_ADDRESS) -> None:
        self._bus = bus
        self._address = address

    def setup(self) -> None:
        """Configure the chip; DriverError if it does not respond, or its codes lack this chip's marker bits."""
        try:
            self._bus.transfer([(self._address, _SETUP)])
            (raw,) = self._bus.transfer([(self._address, _SCANS[0]), (self._address, 10)])
        except OSError as cause:
            raise DriverError(f"no MAX11616 (Hall sensors) at {self._address:#04x}; check wiring") from cause
        if any(byte >> 4 != 0xF for byte in raw[::2]):
            raise DriverError(f"the chip at {self._address:#04x} is not a MAX11616 (Hall sensors); check wiring")

    def read(self, block: int) -> tuple[float, ...]:
        """Read the inputs of `block`, (5,) or (4,), in shares of the supply, 0…1 [1]."""
        first, last = BLOCKS[block]
        (raw,) = self._bus.transfer([(self._address, _SCANS[block]), (self._address, 2 * (last - first))])
        return tuple([((high & 0x0F) << 8 | low) / 4095.0 for high, low in zip(raw[::2], raw[1::2], strict=True)])


# --------------------------------------------------------------------------------------------------
# TCA9534: two outputs select the axis of the Hall sensors that the multiplexers connect to the converter; one more
# triggers the monostable that enables the PWM chip's outputs, and an input reads its state.


TCA9534_ADDRESS = 0x20

_INPUT, _OUTPUT, _CONFIGURATION = 0x00, 0x01, 0x03
_TRIGGER = 0x04  #: P2, the monostable's trigger: it restarts its pulse when this rises
_SENSE = 0x08  #: P3, the PWM chip's OE pin: low enables current
_PINS = 0x07  #: P0, P1 (axis) and P2 are driven; the other five stay inputs


def explain_absence(bus: str, hall_axes: int) -> str:
    """Message if no chip responds on `bus` although `hall_axes` axes are required: what is not possible, and the
    remedy."""
    text = f"nothing responds at {TCA9534_ADDRESS:#04x} on {bus}: without a TCA9534 "
    if hall_axes > 1:
        return text + f"and multiplexers the Hall sensors have 1 axis, and the tracker 'hall' needs {hall_axes}"
    return text + (
        "nothing can trigger the monostable on OE of the PCA9685, which switches off when this computer stops; "
        "wire both (docs: hardware), or accept the risk (--no-watchdog; in Python watchdog=False)"
    )


@final
class HallSelect:
    """Axis selection, 0 to 2, on P0 and P1, 3 bytes a change; trigger on P2, 4 bytes; OE on P3."""

    def __init__(self, bus: I2cBus, address: int = TCA9534_ADDRESS) -> None:
        self._bus = bus
        self._address = address
        self._axis = -1
        self._level = 0  # level of P2 between two triggers

    def present(self) -> bool:
        """Whether the chip answers; without it there are no multiplexers and the sensors have one axis."""
        try:
            self._bus.transfer([(self._address, bytes((_CONFIGURATION,)))])
        except OSError:
            return False
        return True

    def setup(self) -> None:
        """Select axis 0, trigger low. DriverError if the chip does not respond."""
        try:
            self._axis, self._level = -1, 0
            self.show(0)
            self._bus.transfer([(self._address, bytes((_CONFIGURATION, 0xFF & ~_PINS)))])
        except OSError as cause:
            raise DriverError(f"no TCA9534 (axes of the Hall sensors) at {self._address:#04x}; check wiring") from cause

    def show(self, axis: int) -> None:
        """Select `axis`; nothing is written if it is selected already."""
        if axis != self._axis:
            self._bus.transfer([(self._address, bytes((_OUTPUT, axis | self._level)))])
            self._axis = axis

    def trigger(self) -> None:
        """Generate a falling and a rising edge on P2, in one message: enables the outputs for one pulse."""
        axis = max(self._axis, 0)
        self._level = _TRIGGER
        fall_and_rise = (_OUTPUT, axis, axis | _TRIGGER)  # safety: i2c-trigger-edge
        self._bus.transfer([(self._address, bytes(fall_and_rise))])

    def is_enabled(self) -> bool:
        """Whether OE is low."""
        (pins,) = self._bus.transfer([(self._address, bytes((_INPUT,))), (self._address, 1)])
        return not pins[0] & _SENSE


# --------------------------------------------------------------------------------------------------
# Test of the monostable that enables the PWM chip's outputs for 20 ms after each trigger.
#
# It switches off when this computer stops with all its processes. The wiring is in docs/reference/hardware.md.


MIN_PULSE_S = 0.012  #: shortest valid pulse: it must last to the next tick, even if that is late [s]
MAX_PULSE_S = 0.030  #: longest valid pulse: coils are off this long after the last trigger, whatever hangs [s]

_TRIGGER_INTERVAL_S = 4e-3  #: between two triggers of the test

_WIRE = (
    "wire a 74HC123 (P2 of the TCA9534 to its trigger, its inverted output to OE of the PCA9685, OE to P3, as the "
    "hardware reference shows), or accept the risk (--no-watchdog; in Python watchdog=False)"
)


def pulse(select: HallSelect, clock: Callable[[], float]) -> float:
    """Measure the pulse of OE after the last trigger [s], between MIN_PULSE_S and MAX_PULSE_S; takes 0.15 s.

    Outputs must be off. Raises DriverError, which states the wiring, if OE does not follow: high without triggers,
    low at once with one, low while they continue, high again after them. OSError if the TCA9534 does not answer.
    """
    if _measure_duration(select, clock) is None:
        raise DriverError(f"OE of the PCA9685 is low although nothing triggers a monostable: {_WIRE}")
    end = clock() + 2 * MAX_PULSE_S
    while (now := clock()) < end:
        select.trigger()
        while clock() < now + _TRIGGER_INTERVAL_S:
            if not select.is_enabled():
                raise DriverError(f"OE of the PCA9685 does not stay low while its monostable is triggered: {_WIRE}")
    select.trigger()
    lasted = _measure_duration(select, clock)
    if lasted is None:
        raise DriverError(f"OE of the PCA9685 is still low {1e3 * MAX_PULSE_S:g} ms after the last trigger: {_WIRE}")
    if lasted < MIN_PULSE_S:
        raise DriverError(
            f"the monostable on OE of the PCA9685 holds for {1e3 * lasted:.1f} ms, not {1e3 * MIN_PULSE_S:g} to "
            f"{1e3 * MAX_PULSE_S:g} ms: check its resistor (82 kΩ) and capacitor (470 nF)"
        )
    return lasted


def check_output_enable(select: HallSelect, clock: Callable[[], float]) -> None:
    """Quick test, for outputs that are off: DriverError if OE stays low, or does not fall on a trigger; takes at most
    MAX_PULSE_S. OSError if the TCA9534 does not answer."""
    if _measure_duration(select, clock) is None:
        raise DriverError(f"OE of the PCA9685 is low although nothing triggers a monostable: {_WIRE}")
    select.trigger()
    if not select.is_enabled():
        raise DriverError(f"OE of the PCA9685 does not fall when its monostable is triggered: {_WIRE}")


def _measure_duration(select: HallSelect, clock: Callable[[], float]) -> float | None:
    """Measure how long OE stays low [s]; None if longer than MAX_PULSE_S."""
    start = clock()
    while select.is_enabled():
        if clock() - start > MAX_PULSE_S:
            return None
    return clock() - start
