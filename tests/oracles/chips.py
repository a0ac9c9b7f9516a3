"""Emulated chips, register by register: PCA9685, INA219, MAX11616, TCA9534 on an I²C bus.

They stand in for hardware in tests of the drivers, and know of the world only what their pins see: PWM outputs go out,
shunt voltages and Hall voltages come in. Beside them stands the 74HC123 that hangs on the PCA9685's OE pin.
`firmware/emulator/chips.c` has the same chips for the emulated firmware.
"""

from __future__ import annotations

import errno
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import final

import numpy as np

from haptorb.arrays import Array

__all__ = ["INA219", "MAX11616", "PCA9685", "TCA9534", "Chip", "ChipBus", "Monostable", "OpenBus", "Thermometers"]


_BYTE = 9 / 400e3  #: eight bits and an acknowledgement [s]


class Chip(ABC):
    """Something on the bus that acknowledges its address."""

    def __init__(self, address: int) -> None:
        self.address = address
        self.present = True

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Bytes of one message to the chip."""

    @abstractmethod
    def read(self, count: int) -> bytes:
        """Bytes of one message from the chip."""

    @abstractmethod
    def stop(self) -> None:
        """The STOP that ends a transfer whose last message was this chip's."""


@final
class PCA9685(Chip):
    """16 channels of 12-bit PWM. New values reach the outputs at STOP; the prescaler can be set only in sleep."""

    def __init__(self, address: int = 0x60) -> None:
        super().__init__(address)
        self.oe: Callable[[], bool] = lambda: False  #: level of the OE pin; tied to ground until something is wired
        self.power_on()

    def power_on(self) -> None:
        """As the data sheet gives it: asleep, every output off."""
        self.registers = bytearray(256)
        self.registers[0x00] = 0x11
        self.registers[0x01] = 0x04
        self.registers[0xFE] = 0x1E
        self.registers[0x09:0x46:4] = b"\x10" * 16
        self._outputs = bytes(self.registers)
        self._pointer = 0

    def write(self, data: bytes) -> None:
        """Pointer, then registers, moving on by itself if MODE1 says so."""
        if not data:
            return
        self._pointer = data[0]
        for byte in data[1:]:
            self._store(byte)
            self._advance()

    def _store(self, byte: int) -> None:
        at, registers = self._pointer, self.registers
        if at == 0xFE:
            if registers[0x00] & 0x10:
                registers[at] = max(byte, 3)
        elif 0xFA <= at <= 0xFD:
            registers[0x06 + at - 0xFA : 0x46 : 4] = bytes((byte,)) * 16
        elif at <= 0x45:
            registers[at] = byte

    def _advance(self) -> None:
        if self.registers[0x00] & 0x20:
            self._pointer = 0 if self._pointer == 0x45 else (self._pointer + 1) & 0xFF

    def read(self, count: int) -> bytes:
        """Registers from the pointer on; the all-LED registers read as zero."""
        data = bytearray()
        for _ in range(count):
            data.append(0 if 0xFA <= self._pointer <= 0xFD else self.registers[self._pointer])
            self._advance()
        return bytes(data)

    def stop(self) -> None:
        """Outputs take the new values."""
        self._outputs = bytes(self.registers)

    def level(self, output: int) -> float:
        """Share of the time for which `output` is high; none of it while OE is high."""
        return 0.0 if self.oe() else self.read_output(output)

    def read_output(self, output: int) -> float:
        """The same as the registers alone have it."""
        on_low, on_high, off_low, off_high = self._outputs[0x06 + 4 * output : 0x0A + 4 * output]
        if self._outputs[0x00] & 0x10 or off_high & 0x10:  # asleep, or always off, which wins
            return 0.0
        if on_high & 0x10:
            return 1.0
        return ((((off_high & 15) << 8 | off_low) - ((on_high & 15) << 8 | on_low)) & 0xFFF) / 4096

    @property
    def frequency(self) -> float:
        """Of the PWM [Hz]."""
        return 25e6 / 4096 / (self.registers[0xFE] + 1)

    def duties(self, channels: int = 3) -> Array:
        """(channels,) signed duties: outputs 0… are PWM, the next ones directions, high for negative."""
        return np.array([self.level(i) * (-1 if self.level(channels + i) > 0.5 else 1) for i in range(channels)])


@final
class INA219(Chip):
    """Shunt voltage of one coil: 10 µV a step, range by PGA, one conversion's mean at a time."""

    def __init__(self, address: int, shunt: float = 0.01) -> None:
        super().__init__(address)
        self.shunt = shunt
        self.power_on()

    def power_on(self) -> None:
        """Default configuration, pointer on it, nothing converted."""
        self.registers = [0x399F, 0, 0, 0, 0, 0]
        self._pointer = 0
        self._charge = self._elapsed = 0.0

    @property
    def conversion(self) -> float:
        """Time of one shunt conversion [s]."""
        adc = self.registers[0] >> 3 & 0xF
        return 532e-6 * (1 << (adc & 7)) if adc & 8 else (84e-6, 148e-6, 276e-6, 532e-6)[adc & 3]

    def pass_time(self, dt: float, current: float) -> None:
        """`dt` [s] with a mean `current` [A] through the shunt."""
        self._charge += current * dt
        self._elapsed += dt
        if self.registers[0] & 5 == 5 and self._elapsed >= self.conversion * 0.999:
            self._convert(self._charge / self._elapsed)
            self._charge = self._elapsed = 0.0

    def _convert(self, current: float) -> None:
        limit = (0.04, 0.08, 0.16, 0.32)[self.registers[0] >> 11 & 3]
        raw = round(min(max(current * self.shunt, -limit), limit) / 10e-6)
        self.registers[1] = raw & 0xFFFF
        self.registers[4] = (raw * self.registers[5] >> 12) & 0xFFFF

    def write(self, data: bytes) -> None:
        """Pointer, and with two more bytes a register: configuration (bit 15 resets) or calibration."""
        if data:
            self._pointer = data[0]
        if len(data) >= 3:
            value = data[1] << 8 | data[2]
            if self._pointer == 0 and value & 0x8000:
                self.power_on()
            elif self._pointer == 0:
                self.registers[0] = value
            elif self._pointer == 5:
                self.registers[5] = value & 0xFFFE

    def read(self, count: int) -> bytes:
        """The register under the pointer, high byte first."""
        value = self.registers[self._pointer] if self._pointer < 6 else 0
        return (value.to_bytes(2, "big") * (count // 2 + 1))[:count]

    def stop(self) -> None:
        """Nothing waits for it."""


@final
class TCA9534(Chip):
    """Eight pins, inputs until they are told otherwise; a pin that is no output is pulled low unless something is wired
    to it."""

    def __init__(self, address: int = 0x20) -> None:
        super().__init__(address)
        self.registers = bytearray((0x00, 0xFF, 0x00, 0xFF))  # input, output, polarity, configuration
        self.wired: dict[int, Callable[[], bool]] = {}  #: number of an input → its level
        self.moved: Callable[[int], None] = lambda pins: None  #: told of the outputs after every byte
        self._pointer = 0

    @property
    def pins(self) -> int:
        """Which of the eight are high."""
        inputs = sum(1 << pin for pin, level in self.wired.items() if level())
        return self.registers[1] & ~self.registers[3] | inputs & self.registers[3]

    def write(self, data: bytes) -> None:
        """Pointer, and with one more byte a register."""
        if data:
            self._pointer = data[0] & 3
        for byte in data[1:]:
            if self._pointer:
                self.registers[self._pointer] = byte
                self.moved(self.registers[1] & ~self.registers[3])

    def read(self, count: int) -> bytes:
        """The register under the pointer."""
        return bytes([self.pins if self._pointer == 0 else self.registers[self._pointer]] * count)

    def stop(self) -> None:
        """Nothing waits for it."""


@final
class MAX11616(Chip):
    """12 analogue inputs of 12 bits; scans up from AIN0 or AIN6.

    `inputs` (3, 12) are shares of the supply: three behind every input, of which the multiplexers pass on the one that
    `select` says; without it they pass on the first.
    """

    def __init__(self, address: int = 0x35, select: TCA9534 | None = None) -> None:
        super().__init__(address)
        self.inputs = np.full((3, 12), 0.5)
        self._select = select
        self._setup, self._config = 0x82, 0x01

    def write(self, data: bytes) -> None:
        """Set-up bytes have bit 7, configuration bytes do not."""
        for byte in data:
            if byte & 0x80:
                self._setup = byte
            else:
                self._config = byte

    def read(self, count: int) -> bytes:
        """Codes of the scan, each with four ones before it; round again after the last."""
        last, scan = self._config >> 1 & 0xF, self._config >> 5 & 3
        first = {0: 0, 2: min(last, 6)}.get(scan, last)
        data = bytearray()
        for i in range((count + 1) // 2):
            axis = 0 if self._select is None or not self._select.present else min(self._select.pins & 3, 2)
            share = float(self.inputs[axis, min(first + i % (last - first + 1), 11)])
            code = round(min(max(share, 0.0), 1.0) * 4095)
            data += (0xF000 | code).to_bytes(2, "big")
        return bytes(data[:count])

    def stop(self) -> None:
        """Nothing waits for it."""


@final
class Monostable:
    """One half of a 74HC123: Q is high for `width` [s] after the last rising edge at B; `clock` says when that was."""

    def __init__(self, clock: Callable[[], float], width: float = 0.020) -> None:
        self.width = width
        self._clock = clock
        self._b = False
        self._until = float("-inf")

    def b(self, level: bool) -> None:
        """The level at B, A being low and the reset input high."""
        if level and not self._b:
            self._until = self._clock() + self.width
        self._b = level

    @property
    def q(self) -> bool:
        """The output; OE hangs on its inverse."""
        return self._clock() < self._until


@final
class ChipBus:
    """Chips on one bus; a message to an address where nobody is raises OSError, as Linux does.

    Its time `now` [s] passes with what it carries at 400 kHz, and as a test wants it.
    """

    def __init__(self, chips: Sequence[Chip]) -> None:
        self.chips = tuple(chips)
        self.bytes_carried = 0
        self.closed = False
        self.now = 0.0

    @classmethod
    def of_device(cls) -> tuple[ChipBus, PCA9685, tuple[INA219, INA219, INA219], MAX11616]:
        """The bus of a three-coil device, and its chips; a monostable keeps OE as a Raspberry Pi's is wired."""
        pwm, select = PCA9685(), TCA9534()
        hall = MAX11616(select=select)
        currents = (INA219(0x41), INA219(0x44), INA219(0x45))
        bus = cls((pwm, *currents, hall, select))
        monostable = Monostable(lambda: bus.now)
        pwm.oe = lambda: not monostable.q
        select.moved = lambda pins: monostable.b(bool(pins & 4))
        select.wired[3] = pwm.oe
        return bus, pwm, currents, hall

    def transfer(self, messages: Sequence[tuple[int, bytes | int]]) -> list[bytes]:
        """Messages joined by repeated STARTs; the bytes that were read."""
        if self.closed:
            raise OSError(errno.EBADF, "the bus is closed")
        heard = []
        last: Chip | None = None
        for address, what in messages:
            last = next((chip for chip in self.chips if chip.address == address and chip.present), None)
            if last is None:
                raise OSError(errno.EREMOTEIO, f"nobody acknowledges address {address:#04x}")
            if isinstance(what, int):
                heard.append(last.read(what))
                carried = 1 + what
            else:
                last.write(what)
                carried = 1 + len(what)
            self.bytes_carried += carried
            self.now += carried * _BYTE
        if last is not None:
            last.stop()
        return heard

    def close(self) -> None:
        """May be called twice."""
        self.closed = True


@final
class OpenBus:
    """A bus that stays open when a driver lets go of it."""

    def __init__(self, bus: ChipBus) -> None:
        self._bus = bus

    def transfer(self, messages: Sequence[tuple[int, bytes | int]]) -> list[bytes]:
        """As the bus itself."""
        return self._bus.transfer(messages)

    def close(self) -> None:
        """The bus stays open."""


@final
class Thermometers:
    """Three coils at 300 K, without a bus."""

    def wait_until_ready(self, timeout: float) -> bool:
        """At once."""
        return True

    def read(self) -> Array:
        """(3,) [K]."""
        return np.full(3, 300.0)

    def close(self) -> None:
        """Nothing to close."""
