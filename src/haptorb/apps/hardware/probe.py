"""What is connected to this computer, and what answers. Nothing is switched on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass

from haptorb.errors import DriverError
from haptorb.runtime import hall_adc, ina219, pca9685
from haptorb.runtime.board import Board
from haptorb.runtime.board_words import missing_chips
from haptorb.runtime.i2c_bus import I2cBus, LinuxBus, bus_list
from haptorb.runtime.serial_port import port_list

__all__ = ["Finding", "chips_on", "probe"]

#: address → what should answer there
_CHIPS = {
    pca9685.ADDRESS: "PWM driver PCA9685",
    **{address: f"current sensor INA219 of coil {coil}" for address, coil in zip(ina219.ADDRESSES, "xyz", strict=True)},
    hall_adc.ADDRESS: "Hall converter MAX11616",
}


@dataclass(frozen=True)
class Finding:
    """One place where a device might be; `driver` is what `--driver` wants, empty if nobody useful is there."""

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
        try:
            bus = LinuxBus(number)
        except DriverError as cause:
            yield Finding(f"i2c:{number}", False, (str(cause),))
            continue
        with closing(bus):
            yield chips_on(bus, f"i2c:{number}")


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


def chips_on(bus: I2cBus, place: str) -> Finding:
    """Which of the device's chips acknowledge on `bus`."""
    there, missing = [], []
    for address, part in _CHIPS.items():
        try:
            bus.transfer([(address, 1)])
        except OSError:
            missing.append(f"missing: {part} at {address:#04x}")
        else:
            there.append(f"{part} at {address:#04x}")
    if not there:
        return Finding(place, False, ("none of the device's chips answers",))
    return Finding(place, True, (*there, *missing), "" if missing else place)
