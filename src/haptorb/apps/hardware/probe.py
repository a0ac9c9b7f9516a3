"""What is connected to this computer, and what answers. Nothing is switched on."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from time import monotonic

from haptorb.errors import DriverError
from haptorb.runtime.drivers.i2c import ina219, max11616, output_enable, pca9685, tca9534
from haptorb.runtime.drivers.i2c.i2c_bus import I2cBus, bus_list
from haptorb.runtime.drivers.i2c.i2c_chips import LinuxPort
from haptorb.runtime.drivers.i2c.pca9685 import Pca9685
from haptorb.runtime.drivers.i2c.tca9534 import HallSelect
from haptorb.runtime.drivers.serial.board import Board
from haptorb.runtime.drivers.serial.codes import missing_chips
from haptorb.runtime.drivers.serial.serial_port import port_list

__all__ = ["Finding", "chips_on", "probe"]

_SELECT = tca9534.ADDRESS

#: address → what should answer there
_CHIPS = {
    pca9685.ADDRESS: "PWM driver PCA9685",
    **{address: f"current sensor INA219 of coil {coil}" for address, coil in zip(ina219.ADDRESSES, "xyz", strict=True)},
    max11616.ADDRESS: "Hall converter MAX11616",
}


@dataclass(frozen=True)
class Finding:
    """One place where a device might be; `driver` is the value for `--driver`, empty if no usable device is there."""

    place: str
    answers: bool
    about: tuple[str, ...]
    driver: str = ""


def probe(ports: Sequence[str] | None = None, buses: Sequence[int] | None = None) -> Iterator[Finding]:
    """Every serial port and I²C bus (or those given), one finding each, as soon as it is known.

    Asking an Arduino restarts it, which takes up to two seconds.
    """
    for path in [one for one, _ in port_list()] if ports is None else ports:
        yield _port(path)
    for number in bus_list() if buses is None else buses:
        port = LinuxPort(number)
        try:
            bus = port.open()
        except DriverError as cause:  # also if another program drives it: it is asked nothing then
            yield Finding(port.name, False, (str(cause),))
            continue
        with closing(port):
            yield chips_on(bus, port.name)


def _port(path: str) -> Finding:
    try:
        board = Board(path)
    except DriverError as cause:
        return Finding(path, False, (str(cause),))
    try:
        who, limits = board.identity, board.limits
        reading = board.read()
        missing = missing_chips(reading.missing)
        calibrated = f"calibration {who.calibration.hex()}" if any(who.calibration) else "no calibration stored"
        about = (
            f"haptorb firmware {who.version[0]}.{who.version[1]} on {who.board}, protocol {who.protocol}, {calibrated}",
            f"limits: {limits.current:g} A, coils off after {limits.silence * 1e3:g} ms of silence; "
            f"last restart: {who.reset.text}",
            *(f"missing: {part}" for part in missing),
        )
        return Finding(path, True, about, f"serial:{path}")
    except DriverError as cause:
        return Finding(path, False, (str(cause),))
    finally:
        board.close()


def chips_on(bus: I2cBus, place: str, clock: Callable[[], float] = monotonic) -> Finding:
    """Which of the device's chips acknowledge on `bus`, and how its monostable fares; outputs are switched off first.

    `clock` [s] is that of the bus.
    """
    there, missing = [], []
    for address, part in _CHIPS.items():
        try:
            bus.transfer([(address, 1)])
        except OSError:
            missing.append(f"missing: {part} at {address:#04x}")
        else:
            there.append(f"{part} at {address:#04x}")
    if not there:
        return Finding(place, False, ("none of the device's chips responds",))
    about = (*there, *missing, *_probe_hall_select(bus, clock))
    return Finding(place, True, about, "" if missing else place)


def _probe_hall_select(bus: I2cBus, clock: Callable[[], float]) -> Iterator[str]:
    """What there is to say of the chip with the Hall sensors' axes and the trigger, and of OE."""
    select, where = HallSelect(bus), f"TCA9534 (axes of the Hall sensors, trigger of the monostable) at {_SELECT:#04x}"
    if not select.present():
        yield f"missing: {where}: Hall sensors of one axis only, and no monostable: coils need --no-watchdog"
        return
    yield where
    try:
        # safety: probe-off
        Pca9685(bus).setup()  # all off: the test enables its outputs
        select.setup()
        held = output_enable.pulse(select, clock)
    except (DriverError, OSError) as cause:
        yield f"monostable not verified: {cause}"
    else:
        yield f"monostable: outputs disabled {1e3 * held:.1f} ms after the last trigger"
