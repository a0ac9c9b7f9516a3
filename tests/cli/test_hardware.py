"""Probing, monitoring and jogging over simulated chips and the simulated device, with wiring mistakes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from haptorb.arrays import Array
from haptorb.cli import main
from haptorb.cli.board_tools import chips_on, emulate, jog, line, monitor, probe
from haptorb.control.trip_reasons import CoilState
from haptorb.devices.loader import load
from haptorb.errors import DriverError, InputError, UnknownName
from haptorb.runtime.drivers.i2c import I2cDriver
from haptorb.runtime.drivers.registry import real_driver
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.servo import Servo
from oracles.chips import TCA9534, ChipBus, Thermometers


class Time:
    """A clock that only moves when somebody waits."""

    def __init__(self) -> None:
        self.now = 0.0
        self.then: Callable[[], None] = lambda: None

    def clock(self) -> float:
        self.now += 1e-6
        return self.now

    def wait(self, seconds: float) -> None:
        self.now += seconds
        self.then()


def wire(matrix: Array) -> tuple[I2cDriver, Time, ChipBus]:
    """A driver whose measured currents are `matrix` (3, 3) [A] times the duties."""
    bus, pwm, currents, _ = ChipBus.of_device()
    time = Time()

    def follow() -> None:
        for chip, current in zip(currents, matrix @ pwm.duties(), strict=True):
            chip.pass_time(0.6e-3, float(current))

    time.then = follow
    return I2cDriver(load("omni"), bus, thermometers=Thermometers, clock=lambda: bus.now), time, bus


def verdict_of(matrix: Array, coil: str = "y", duty: float = 0.05) -> tuple[str, ...]:
    driver, time, _ = wire(matrix)
    return jog(load("omni"), driver, coil, duty, clock=time.clock, wait=time.wait).verdict


GOOD = 20.0 * np.eye(3)


def test_a_good_coil_gets_no_complaint() -> None:
    driver, time, _ = wire(GOOD)
    seen = jog(load("omni"), driver, "y", -0.1, clock=time.clock, wait=time.wait)
    assert seen.verdict == ()
    assert seen.resistance == pytest.approx(0.6, rel=0.01)
    assert seen.duty == pytest.approx(-0.1, abs=1e-3)


@pytest.mark.parametrize(
    ("matrix", "complaint"),
    [
        (GOOD[:, [1, 0, 2]], "coil x responded instead of y"),
        (-GOOD, "negative for a positive duty"),
        (GOOD * 0, "no coil carries current"),
        (GOOD / 10, "shunt's value is wrong by a factor of ten"),
        (GOOD / 3, "check coil and contacts"),
    ],
)
def test_every_mistake_of_wiring_is_named(matrix: Array, complaint: str) -> None:
    (sentence,) = verdict_of(matrix)
    assert complaint in sentence


def test_too_much_current_stops_the_jog_and_the_coils() -> None:
    driver, time, bus = wire(GOOD * 10)
    with pytest.raises(DriverError, match="above 3 A"):
        jog(load("omni"), driver, "x", 0.1, current_limit=3.0, clock=time.clock, wait=time.wait)
    assert bus.closed
    assert bus.chips[0].duties().tolist() == [0, 0, 0]  # type: ignore[attr-defined]


def test_jogging_the_simulated_device_finds_its_own_resistance() -> None:
    time = Time()
    omni = load("omni")
    seen = jog(omni, SimDriver.of(omni, 1e-3), "z", 0.05, clock=time.clock, wait=time.wait)
    assert seen.verdict == ()
    assert seen.resistance == pytest.approx(0.6, rel=0.1)


@pytest.mark.parametrize("link", [False, True])
def test_an_emulated_port_replaces_no_file_and_no_other_link(tmp_path: Path, link: bool) -> None:
    port, precious = tmp_path / "port", tmp_path / "precious"
    precious.write_text("mine")
    if link:
        port.symlink_to(precious)
    else:
        port.write_text("mine")
    with pytest.raises(InputError, match="no emulated port"):
        emulate(load("omni"), tmp_path, port)
    assert port.read_text() == "mine"


@pytest.mark.parametrize(
    "arguments",
    [
        {"duty": 0.0},
        {"duty": 0.3},
        {"seconds": 0.1},
        {"seconds": 60.0},
        {"current_limit": 6.0},
        {"current_limit": -1.0},
    ],
)
def test_what_is_not_gentle_is_refused(arguments: dict[str, float]) -> None:
    driver, _, _ = wire(GOOD)
    with pytest.raises(InputError):
        jog(load("omni"), driver, "x", **arguments)
    with pytest.raises(UnknownName, match="coil"):
        jog(load("omni"), driver, "q")


def test_monitoring_switches_nothing_on() -> None:
    driver, time, bus = wire(GOOD)
    seen = list(monitor(driver, 10.0, 1.0, clock=time.clock, wait=time.wait))
    assert 9 <= len(seen) <= 11
    assert bus.chips[0].duties().tolist() == [0, 0, 0]  # type: ignore[attr-defined]
    assert "°C" in line(seen[0])
    with pytest.raises(InputError, match="rate"):
        next(monitor(driver, 0.0))


def test_probing_a_bus_names_what_answers_and_what_does_not() -> None:
    bus, pwm, currents, _ = ChipBus.of_device()
    bus.transfer([(0x60, bytes((0x00, 0x20)))])
    bus.transfer([(0x60, bytes((0x06, 0, 0x10, 0, 0)))])  # what a program that was killed may leave: always on
    found = chips_on(bus, "i2c:1", lambda: bus.now)
    assert found.answers
    assert pwm.read_output(0) == 0.0  # off before the monostable enables it
    assert any("disabled 20" in sentence for sentence in found.about)
    assert found.driver == "i2c:1"
    currents[1].present = False
    found = chips_on(bus, "i2c:1", lambda: bus.now)
    assert found.driver == ""
    assert "missing: current sensor INA219 of coil y at 0x44" in found.about
    assert not chips_on(ChipBus([]), "i2c:1").answers


def test_probing_a_bus_says_why_its_monostable_will_not_do() -> None:
    bus, *_ = ChipBus.of_device()
    select = next(chip for chip in bus.chips if isinstance(chip, TCA9534))
    select.wired[3] = lambda: False
    about = chips_on(bus, "i2c:1", lambda: bus.now).about
    assert any("not verified" in sentence and "74HC123" in sentence for sentence in about)
    select.present = False
    about = chips_on(bus, "i2c:1", lambda: bus.now).about
    assert any("missing: TCA9534" in sentence and "--no-watchdog" in sentence for sentence in about)


def test_a_line_of_the_monitor_says_when_the_coils_state_is_not_known() -> None:
    driver, time, _ = wire(GOOD)
    sample = next(iter(monitor(driver, 10.0, 0.05, clock=time.clock, wait=time.wait)))
    assert "UNKNOWN" not in line(sample, CoilState.OFF)
    assert "COIL STATE UNKNOWN" in line(sample, CoilState.UNKNOWN)


def test_probing_a_port_that_is_none_says_so() -> None:
    (found,) = probe(ports=["/dev/haptorb-nowhere"], buses=[])
    assert not found.answers
    assert "there is no port" in found.about[0]


@pytest.mark.parametrize("name", ["serial:", "serial", "i2c:", "i2c:one", "usb:1", "sim"])
def test_a_driver_that_is_no_port_or_bus_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="serial:PORT"):
        real_driver(name, load("omni"))


def test_a_wrong_port_says_what_to_do() -> None:
    with pytest.raises(DriverError, match="there is no port"):
        real_driver("serial:/dev/haptorb-nowhere", load("omni")).open()
    with pytest.raises(DriverError, match=r"there is no bus /dev/i2c-99"):
        real_driver("i2c:99", load("omni")).open()


@pytest.mark.parametrize(
    "command",
    [
        ["hardware", "jog", "x", "--driver", "i2c:1"],
        ["calibrate", "omni", "--driver", "i2c:1", "--yes"],
        ["run", "omni", "--driver", "i2c:1", "--headless"],
    ],
)
def test_only_no_watchdog_drives_a_bus_without_a_monostable(
    command: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked: list[object] = []

    class RefusalError(Exception):
        pass

    def refuse(*_: object, watchdog: object = None, **__: object) -> None:
        asked.append(watchdog)
        raise RefusalError

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("haptorb.runtime.drivers.i2c.I2cDriver", refuse)
    monkeypatch.setattr("haptorb.runtime.config.RunConfig.of", refuse)
    for more in ([], ["--no-watchdog"]):
        with suppress(RefusalError, SystemExit):
            main([*command, *more])
    assert asked == [True, False]


def test_a_servo_hands_on_that_there_is_no_monostable(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[object] = []
    monkeypatch.setattr("haptorb.runtime.drivers.i2c.I2cDriver", lambda *_, watchdog, **__: asked.append(watchdog))
    for told in ({}, {"watchdog": False}):
        Servo("omni", "dome", driver="i2c:1", record=False, **told)._make_plan().assemble(
            PointerTracker.__new__(PointerTracker)
        )
    assert asked == [True, False]
