"""Detect connected devices and their parts, test a coil, read sensors, run the emulator."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import numpy as np

from haptorb.arrays import Array
from haptorb.control.trip_reasons import CoilState
from haptorb.devices.api import electromagnet
from haptorb.devices.base import Device
from haptorb.errors import DriverError, InputError, UnknownName
from haptorb.estimation.types import Sample
from haptorb.runtime.drivers import i2c_chips
from haptorb.runtime.drivers.base import Driver
from haptorb.runtime.drivers.emulator_process import EmulatedDevice, Emulator
from haptorb.runtime.drivers.i2c import LinuxPort
from haptorb.runtime.drivers.i2c_chips import HallSelect, I2cBus, Pca9685, bus_list
from haptorb.runtime.drivers.serial import Board, port_list
from haptorb.runtime.drivers.serial_protocol import missing_chips
from haptorb.simulation.electromagnet import SimulatedElectromagnet
from haptorb.simulation.hand_motion import lead_tool

__all__ = [
    "GENTLE_CURRENT",
    "GENTLE_DUTY",
    "Finding",
    "Jog",
    "chips_on",
    "emulate",
    "jog",
    "line",
    "monitor",
    "numbers",
    "probe",
    "state_words",
]


_SELECT = i2c_chips.TCA9534_ADDRESS

#: I²C address → part expected there
_CHIPS = {
    i2c_chips.ADDRESS: "PWM driver PCA9685",
    **{
        address: f"current sensor INA219 of coil {coil}"
        for address, coil in zip(i2c_chips.ADDRESSES, "xyz", strict=True)
    },
    i2c_chips.MAX11616_ADDRESS: "Hall converter MAX11616",
}


@dataclass(frozen=True)
class Finding:
    """Result for one port or bus; `driver` is the value for `--driver`, empty if no usable device is connected."""

    place: str
    answers: bool
    about: tuple[str, ...]
    driver: str = ""


def probe(ports: Sequence[str] | None = None, buses: Sequence[int] | None = None) -> Iterator[Finding]:
    """Probe all serial ports and I²C buses, or those given; yield one finding each as soon as it is known.

    Opening an Arduino's port resets it, which takes up to two seconds.
    """
    for path in [one for one, _ in port_list()] if ports is None else ports:
        yield _port(path)
    for number in bus_list() if buses is None else buses:
        port = LinuxPort(number)
        try:
            bus = port.open()
        except DriverError as cause:  # also if another program has the port open: then nothing is sent
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
    """List the device's chips that acknowledge on `bus`, and test its monostable; outputs are switched off first.

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
    """Yield findings on the chip that selects the Hall sensors' axes and triggers the monostable, and on OE."""
    select, where = HallSelect(bus), f"TCA9534 (axes of the Hall sensors, trigger of the monostable) at {_SELECT:#04x}"
    if not select.present():
        yield f"missing: {where}: Hall sensors of one axis only, and no monostable: coils need --no-watchdog"
        return
    yield where
    try:
        # safety: probe-off
        Pca9685(bus).setup()  # all off: the test enables its outputs
        select.setup()
        held = i2c_chips.pulse(select, clock)
    except (DriverError, OSError) as cause:
        yield f"monostable not verified: {cause}"
    else:
        yield f"monostable: outputs disabled {1e3 * held:.1f} ms after the last trigger"


# --------------------------------------------------------------------------------------------------
# Emulated device: the real firmware, its chips and a simulated electromagnet on a serial port.


def emulate(
    device: Device,
    build: Path,
    port: Path,
    board: str = "m328p",
    duration: float = float("inf"),
    ready: Callable[[], None] = lambda: None,
    height: float | None = None,
    *,
    led: bool = False,
    dead: int | None = None,
) -> None:
    """Emulate `device` behind the pseudo-terminal `port` for `duration` [s]; `ready` is called when it answers.

    The simulated tool is held upright on the axis, its magnet `height` [m] above the centre (None: above the summit,
    as at the start of the simulation); the emulated device has no pointer input. With `led`, a simulated hand moves it
    over the whole dome, as the calibration step 'sensors' requires. Field sensor number `dead`, from 1, has failed.

    Raises InputError if there is another file or link at `port`, for a height inside the dome or above 2 m, for a
    height together with `led`, and for the number of a sensor that does not exist.
    """
    known = electromagnet(device, "the emulated firmware")
    if height is not None and not known.contact_distance <= height <= 2.0:
        raise InputError(
            f"height of the tool's magnet must be from {1e3 * known.contact_distance:g} mm, the dome, to 2000 mm; got "
            f"{1e3 * height:g} mm"
        )
    if led and height is not None:
        raise InputError("a tool moved by --led has no fixed height: use --led or --height")
    if dead is not None and not 1 <= dead <= known.sensors:
        raise InputError(f"the failed field sensor must be 1 to {known.sensors}; got {dead}")
    own = port.is_symlink() and str(port.readlink()).startswith("/dev/pts/")  # of an emulator that was killed
    if not own and (port.exists() or port.is_symlink()):  # safety: port-not-replaced
        raise InputError(f"{port} is there already, and is no emulated port: name another path with --port")
    with tempfile.TemporaryDirectory() as folder:
        goal = (lambda t: lead_tool(known, t)) if led else None if height is None else _rest_pose(height)
        physics = EmulatedDevice(known, Path(folder, "physics"), goal)
        if dead is not None:
            assert isinstance(physics.simulation, SimulatedElectromagnet)
            physics.simulation.fail([dead - 1])
        if goal is not None:
            physics.place(*goal(0.0))
        try:
            with Emulator(build, port, board, physics) as emulator:
                ready()
                end = monotonic() + duration
                while monotonic() < end and emulator.alive:
                    sleep(0.05)
        finally:
            physics.close()


def _rest_pose(height: float) -> Callable[[float], tuple[Array, Array]]:
    p, q = np.array([0.0, 0.0, height]), np.array([0.0, 0.0, 0.0, 1.0])
    return lambda t: (p, q)


# --------------------------------------------------------------------------------------------------
# Test of one coil at low current: ramp up, hold, ramp down; check coil, current sensor and wiring.


GENTLE_DUTY = 0.2  #: largest permitted duty [1]
GENTLE_CURRENT = 5.3  #: continuous current of every coil: 17 W in 0.6 Ω [A]

_WRITE_RATE_HZ = 250.0  #: write rate [Hz]: the firmware switches off after 15 ms of silence
_RAMP_SHARE = 0.4  #: share of the duration for the ramp up, and the same for the ramp down
_MIN_CURRENT_A = 0.1  #: smallest current for a resistance measurement [A]
_MAX_RESISTANCE_RATIO = 1.6  #: permitted ratio of measured to nominal resistance, either way


@dataclass(frozen=True)
class Jog:
    """Result of a coil test, measured at the top of the ramp.

    duty        applied duty [1]
    currents    (m,) measured currents [A]
    resistance  supply voltage times duty over current [Ω]; NaN if the current was too small
    verdict     findings as sentences; empty if everything agrees with the device file
    """

    coil: str
    duty: float
    currents: tuple[float, ...]
    resistance: float
    verdict: tuple[str, ...]


def jog(
    device: Device,
    driver: Driver,
    coil: str,
    duty: float = 0.05,
    seconds: float = 1.0,
    current_limit: float = GENTLE_CURRENT,
    clock: Callable[[], float] = monotonic,
    wait: Callable[[float], None] = sleep,
) -> Jog:
    """Ramp `coil` of `device` to `duty` and back within `seconds` through `driver` (not open yet).

    Raises InputError for a duty, duration or current limit out of range, DriverError if the current exceeds
    `current_limit` [A] or the device stops; the coils are off afterwards in any case.
    """
    names = device.coils.names
    if coil not in names:
        raise UnknownName("coil", coil, names)
    if not 0.0 < abs(duty) <= GENTLE_DUTY:
        raise InputError(f"duty must be nonzero and at most {GENTLE_DUTY} in size for jogging; got {duty}")
    if not 0.2 <= seconds <= 10.0:
        raise InputError(
            f"seconds must be 0.2 to 10; got {seconds:g}", command=f"--duration must be 0.2 to 10 s; got {seconds:g}"
        )
    if not 0.0 < current_limit <= GENTLE_CURRENT:
        raise InputError(f"current_limit must be above 0 and at most {GENTLE_CURRENT} A; got {current_limit} A")
    which = names.index(coil)
    duties = np.zeros(device.channels)
    tops: list[tuple[float, np.ndarray]] = []
    with driver:
        start = clock()
        count = 0
        while (passed := clock() - start) < seconds:
            currents = driver.read(passed).currents
            if np.abs(currents).max() > current_limit:
                over = names[int(np.argmax(np.abs(currents)))]
                raise DriverError(
                    f"coil {over} carries {np.abs(currents).max():.2f} A with coil {coil} at a duty of "
                    f"{duties[which]:.3f}, above {current_limit:g} A: switched off. Check its resistance and the "
                    "shunt's value"
                )
            share = passed / seconds
            up = min(share / _RAMP_SHARE, (1 - share) / _RAMP_SHARE, 1.0)
            duties[which] = duty * up
            applied = driver.write(duties)
            if 0.5 <= share < 1 - _RAMP_SHARE:
                tops.append((float(applied[which]), currents.copy()))
            count += 1
            wait(max(0.0, start + count / _WRITE_RATE_HZ - clock()))
        driver.write(np.zeros(device.channels))
    if not tops:
        raise DriverError("the computer was too busy: no reading at the top of the ramp; try again")
    return _judge(device, which, tops)


def _judge(device: Device, which: int, tops: list[tuple[float, np.ndarray]]) -> Jog:
    duty = float(np.mean([one for one, _ in tops]))
    currents = np.mean([one for _, one in tops], axis=0)
    names = device.coils.names
    own = float(currents[which])
    expected = float(device.coils.resistance[which])
    verdict = []
    resistance = float("nan")
    strongest = int(np.argmax(np.abs(currents)))
    if duty == 0.0:
        verdict.append("the device applied no duty: it was not engaged")
    elif np.abs(currents).max() < _MIN_CURRENT_A:
        verdict.append(f"no coil carries current: check the supply, the driver of coil {names[which]} and its wires")
    elif strongest != which:
        verdict.append(f"coil {names[strongest]} responded instead of {names[which]}: their wires are swapped")
    else:
        resistance = device.supply.voltage * abs(duty) / abs(own)
        if own * duty < 0:
            verdict.append(f"the current of coil {names[which]} is negative for a positive duty: swap its two wires")
        ratio = resistance / expected
        if not 1 / _MAX_RESISTANCE_RATIO < ratio < _MAX_RESISTANCE_RATIO:
            ten = 6 < max(ratio, 1 / ratio) < 16
            verdict.append(
                f"coil {names[which]} measures {resistance:.3g} Ω, the device file has {expected:g} Ω: "
                + ("the shunt's value is wrong by a factor of ten" if ten else "check coil and contacts")
            )
    return Jog(names[which], duty, tuple(currents.tolist()), resistance, tuple(verdict))


# --------------------------------------------------------------------------------------------------
# Live readings of a real device with its coils off.


_STATES = {
    CoilState.OFF: "off",
    CoilState.ON: "on",
    CoilState.UNKNOWN: "COIL STATE UNKNOWN: switch the supply off",
}

_MAX_READINGS = 24  #: readings at most to cover all field sensors; three axes in two blocks usually need six


def monitor(
    driver: Driver,
    rate: float = 10.0,
    duration: float = float("inf"),
    clock: Callable[[], float] = monotonic,
    wait: Callable[[float], None] = sleep,
) -> Iterator[Sample]:
    """Yield samples of `driver` (not open yet) at `rate` [Hz] for `duration` [s]; the coils are never switched on.

    A driver that multiplexes its field sensors is read as often as needed; each sample has the last reading of each.
    """
    if not 0.0 < rate <= 200.0:
        raise InputError(f"rate must be above 0 and at most 200 Hz; got {rate} Hz")
    with driver:
        start = clock()
        count = 0
        while clock() - start < duration:
            yield _read_whole(driver, clock() - start)
            count += 1
            wait(max(0.0, start + count / rate - clock()))


def _read_whole(driver: Driver, now: float) -> Sample:
    sample = driver.read(now)
    field = sample.field.copy()
    for _ in range(_MAX_READINGS):
        if np.isfinite(field).all():
            break
        part = driver.read(now).field
        field = np.where(np.isfinite(part), part, field)
    return replace(sample, field=field)


def state_words(state: CoilState) -> str:
    """Describe whether current can flow.

    >>> state_words(CoilState.OFF), state_words(CoilState.UNKNOWN)
    ('off', 'COIL STATE UNKNOWN: switch the supply off')
    """
    return _STATES[state]


def numbers(sample: Sample, state: CoilState = CoilState.OFF) -> dict[str, Any]:
    """Return a sample as plain JSON types; null where a sensor gave no reading."""

    def to_json(values: Array) -> list[Any]:
        return [float(one) if np.isfinite(one) else None for one in values]

    return {
        "t_s": sample.t, "currents_a": to_json(sample.currents),
        "temperatures_degc": to_json(sample.temperatures - 273.15),
        "field_t": [to_json(one) for one in sample.field], "coil_state": state.name.lower(),
    }  # fmt: skip


def line(sample: Sample, state: CoilState = CoilState.OFF) -> str:
    """Format a sample as one line: time, currents, temperatures, field magnitude at every sensor; the coils' `state`,
    if they are not off.

    >>> from haptorb.runtime.drivers.base import invalid_pose
    >>> line(Sample(1.5, np.array([1.0, -2, 0]), np.full(3, 300.0), np.eye(3) * 1e-3, invalid_pose(0.0)))
    '   1.50 s   +1.000  -2.000  +0.000 A    26.9  26.9  26.9 °C   1.00 1.00 1.00 mT'
    """
    currents = "  ".join(f"{one:+.3f}" for one in sample.currents)
    heat = "  ".join(f"{one - 273.15:.1f}" for one in sample.temperatures)
    field = " ".join(f"{one * 1e3:.2f}" for one in np.linalg.norm(sample.field, axis=1))
    text = f"{sample.t:7.2f} s   {currents} A    {heat} °C   {field} mT"
    return text if state is CoilState.OFF else f"{text}   coils: {state_words(state)}"
