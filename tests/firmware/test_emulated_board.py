"""Emulated firmware with the real driver: readings, limits, reasons, and reconnection."""

from __future__ import annotations

import importlib.util
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from haptorb.cli.board_tools import emulate
from haptorb.devices.loader import load
from haptorb.errors import DriverError, InputError
from haptorb.runtime.drivers.emulator_process import Emulator
from haptorb.runtime.drivers.serial import Board, SerialDriver
from haptorb.runtime.drivers.serial_protocol import BoardMode, Reason, Refusal, refusal

pytestmark = [pytest.mark.firmware, pytest.mark.realtime, pytest.mark.timeout(600)]

SMALL = np.array([0.1, -0.05, 0.02])


@pytest.fixture(scope="module")
def running(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Emulator]:
    """One emulator for nearly all tests: what each of them breaks is mended before the next."""
    with Emulator(built, tmp_path_factory.mktemp("board") / "omni") as one:
        yield one


@pytest.fixture
def emulator(running: Emulator) -> Iterator[Emulator]:
    running.execute("pace 1")
    yield running
    for command in ("button 0", "resistance 0 0.6"):
        running.execute(command)


@pytest.fixture
def driver(emulator: Any) -> Iterator[SerialDriver]:
    one = SerialDriver(load("omni"), emulator.port, timeout=1.0, warm_up=90.0)
    one.open()
    emulator.set_pace()
    yield one
    one.close()


def ticks(driver: SerialDriver, duties: Any, count: int) -> list[Any]:
    samples = []
    for _ in range(count):
        samples.append(driver.read(0.0))
        driver.write(duties)
    return samples


def test_currents_settle_at_duty_times_supply_over_resistance(emulator: Any, driver: SerialDriver) -> None:
    samples = ticks(driver, SMALL, 25)
    last = samples[-1]
    # the emulator's own coils: 0.6 Ω and 12 V, and the PWM's steps of 1/4096
    assert last.currents == pytest.approx(np.round(SMALL * 4096) / 4096 * 20, abs=3e-3)
    assert last.temperatures == pytest.approx(np.full(3, 298.15), abs=0.2)
    fields = np.stack([sample.field for sample in samples])
    assert fields.shape == (25, 9, 3)
    assert np.isfinite(fields).any(axis=0).all()  # in turns: every channel within so many ticks
    assert driver.fault == ""


def test_identity_limits_and_calibration_can_be_read(started: Callable[..., Any]) -> None:
    for board, name in (("m328p", "ATmega328P"), ("m2560", "ATmega2560")):
        emulator = started(board)
        device = Board(emulator.port, 30.0, answer=5.0)
        assert device.identity.board == name
        assert device.identity.reset is Reason.POWER_ON
        assert (device.identity.channels, device.identity.hall_sensors, device.identity.hall_axes) == (3, 9, 3)
        assert device.identity.calibration == bytes(16)
        assert device.limits.current == pytest.approx(21.0)
        assert device.limits.silence == pytest.approx(0.015)
        wanted = bytes(range(100, 116))
        assert device.store(wanted).refusal is Refusal.WRITING  # the EEPROM takes 3.4 ms a byte
        assert device.identify().calibration == bytes(16)
        device.store_and_wait(wanted)
        assert device.identity.calibration == wanted
        device.close()
        emulator.execute("reset")  # the EEPROM remembers
        again = Board(emulator.port, 30.0, answer=5.0)
        assert again.identity.calibration == wanted
        assert again.identity.reset is Reason.RESET_PIN
        again.close()


def test_a_session_may_ask_for_less_than_the_limits(emulator: Any) -> None:
    device = Board(emulator.port, 30.0, answer=5.0)
    emulator.wait(1.5)  # until it knows how warm the coils are
    emulator.set_pace()
    assert device.engage(0.25, 30.0).refusal is Refusal.ACCEPTED
    reading = device.set([4095, -4095, 5])
    assert reading.applied == pytest.approx([0.25, -0.25, 5 / 4096])
    assert device.store(bytes(16)).refusal is Refusal.ENGAGED
    device.close()


def test_engaging_is_refused_while_a_coil_is_too_warm_or_nobody_knows(started: Callable[..., Any]) -> None:
    emulator = started()
    device = Board(emulator.port, 30.0, answer=5.0)
    early = device.engage()
    while early.refusal in (Refusal.STOP_BUTTON, Refusal.CHIP):  # it has just started
        early = device.engage()
    assert early.refusal is Refusal.THERMOMETER  # the first conversion takes a second
    assert "coil temperature is unknown" in refusal(early)
    emulator.wait(1.5)
    emulator.execute("heat 1 93.9")
    emulator.wait(2.5)
    hot = device.engage()
    assert hot.refusal is Refusal.HOT
    assert hot.mode is BoardMode.OFF
    assert "above 85 °C" in refusal(hot)
    emulator.execute("heat 1 40")
    emulator.execute("absent ds18b20-z")
    emulator.wait(5.0)
    blind = device.engage()
    assert blind.refusal is Refusal.THERMOMETER
    assert "DS18B20 of coil z on D7" in refusal(blind)
    emulator.execute("present ds18b20-z")
    emulator.wait(2.5)
    assert device.engage().refusal is Refusal.ACCEPTED
    device.close()


def store_resets() -> ModuleType:
    """benchmarks/safety/store_resets.py."""
    path = Path(__file__).resolve().parents[2] / "benchmarks" / "safety" / "store_resets.py"
    spec = importlib.util.spec_from_file_location("store_resets", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("resets", [12, pytest.param(100, marks=pytest.mark.slow)])
def test_no_reset_loses_an_id_that_was_called_kept(built: Path, tmp_path: Path, resets: int) -> None:
    found = store_resets().try_resets(built, tmp_path / "port", resets, seed=1)
    assert found.resets == resets
    assert (found.lost, found.garbage) == (0, 0)
    assert found.intact > 0  # resets after it
    assert found.old > 0  # and before


def test_over_current_trips_the_firmware_and_the_host_says_why(emulator: Any, driver: SerialDriver) -> None:
    ticks(driver, SMALL, 5)
    emulator.execute("resistance 0 0.02")
    with pytest.raises(DriverError, match="current was above the limit"):
        ticks(driver, np.array([0.9, 0.0, 0.0]), 60)
    assert driver.write(SMALL).tolist() == [0, 0, 0]
    emulator.expect_line("@off")


def test_after_a_trip_nothing_flows_until_somebody_engages(emulator: Any, driver: SerialDriver) -> None:
    ticks(driver, SMALL, 5)
    emulator.execute("button 1")
    with pytest.raises(DriverError, match="stop button"):
        ticks(driver, SMALL, 20)
    emulator.execute("button 0")
    for _ in range(10):
        with pytest.raises(DriverError, match="stop button"):
            driver.read(0.0)
        assert driver.write(SMALL).tolist() == [0, 0, 0]
    assert emulator.status()["on"] == "0"
    driver.engage()
    ticks(driver, SMALL, 5)
    assert emulator.status()["on"] == "1"


def test_silence_is_told_as_silence(emulator: Any, driver: SerialDriver) -> None:
    ticks(driver, SMALL, 5)
    emulator.execute("pace 1")
    emulator.wait(0.1)
    with pytest.raises(DriverError, match="host was silent"):
        ticks(driver, SMALL, 3)


def test_a_port_that_comes_back_is_found_within_two_seconds_and_stays_off(emulator: Any, driver: SerialDriver) -> None:
    ticks(driver, SMALL, 5)
    emulator.execute("pull")
    with pytest.raises(DriverError, match="disappeared"):
        ticks(driver, SMALL, 3)
    assert driver.write(SMALL).tolist() == [0, 0, 0]
    time.sleep(0.5)
    with pytest.raises(DriverError, match="retrying"):
        driver.read(0.0)
    emulator.execute("pace 1")
    emulator.execute("plug")
    began = time.monotonic()
    while True:
        try:
            driver.read(0.0)
            break
        except DriverError:
            assert time.monotonic() - began < 30
            time.sleep(0.002)
    assert time.monotonic() - began < 2.0
    assert driver.write(SMALL).tolist() == [0, 0, 0]  # back, and still off
    assert emulator.status()["on"] == "0"
    emulator.set_pace()
    driver.engage()
    ticks(driver, SMALL, 5)
    assert emulator.status()["on"] == "1"


def test_a_restarted_firmware_is_noticed(emulator: Any, driver: SerialDriver) -> None:
    ticks(driver, SMALL, 5)
    emulator.execute("brownout")
    with pytest.raises(DriverError, match=r"supply dropped|host was silent|no response"):
        ticks(driver, SMALL, 20)


@pytest.mark.parametrize(
    ("chip", "part", "known"),
    [
        ("ina219-z", "INA219 of coil z at 0x45", 1.5),
        ("max11616", "MAX11616 at 0x35", 1.5),
        ("ds18b20-y", "DS18B20 of coil y on D6", 5.0),  # asked three times, a conversion of 0.76 s between
    ],
)
def test_a_missing_sensor_is_named_with_its_address(emulator: Any, chip: str, part: str, known: float) -> None:
    emulator.execute(f"absent {chip}")
    emulator.execute("reset")
    emulator.wait(known)
    try:
        with pytest.raises(DriverError, match=part):
            SerialDriver(load("omni"), emulator.port, timeout=1.0, warm_up=0.2).open()
    finally:
        emulator.execute(f"present {chip}")
        emulator.execute("reset")


def test_a_frame_and_its_answer_take_less_than_a_millisecond(emulator: Any, driver: SerialDriver) -> None:
    """On the wire and in the processor; what this computer adds comes on top."""
    emulator.set_pace(0.06)
    ticks(driver, SMALL, 10)
    emulator.status()
    before = emulator.status()
    ticks(driver, SMALL, 200)
    after = emulator.status()
    assert int(after["turns"]) >= 199
    assert float(after["turn_us"]) < 1000
    assert int(after["overruns"]) == 0
    assert int(before["resets"]) == int(after["resets"])


def test_duties_of_either_sign_reach_the_coils(emulator: Any, driver: SerialDriver) -> None:
    for sign in (1.0, -1.0):
        ticks(driver, sign * SMALL, 6)
        words = emulator.status()
        applied = [float(one) for one in words["duty"].split(",")]
        assert applied == pytest.approx(np.round(sign * SMALL * 4096) / 4096, abs=1e-6)


def test_standing_is_off_after_close(emulator: Any, driver: SerialDriver) -> None:
    ticks(driver, SMALL, 5)
    driver.close()
    driver.close()
    assert emulator.status()["on"] == "0"
    device = Board(emulator.port, 30.0, answer=5.0)
    assert device.read().mode is BoardMode.OFF
    device.close()


def test_anybody_can_start_an_emulated_device(built: Path, tmp_path: Path) -> None:
    seen: list[Board] = []
    emulate(
        load("omni"),
        built,
        tmp_path / "port",
        duration=0.2,
        ready=lambda: seen.append(Board(str(tmp_path / "port"), 30.0)),
    )
    assert seen[0].identity.name == "haptorb"
    seen[0].close()
    with pytest.raises(InputError, match="the dome, to 2000 mm"):
        emulate(load("omni"), built, tmp_path / "port", height=0.01)
    with pytest.raises(InputError, match="--led or --height"):
        emulate(load("omni"), built, tmp_path / "port", height=0.5, led=True)
    with pytest.raises(InputError, match="must be 1 to 9; got 10"):
        emulate(load("omni"), built, tmp_path / "port", dead=10)
    with pytest.raises(InputError, match="works for spherical electromagnets"):
        emulate(load("pmsm"), built, tmp_path / "port")
    with pytest.raises(DriverError, match="make firmware"):
        emulate(load("omni"), tmp_path, tmp_path / "port")
