"""I²C driver: limits, latches, and a guardian process that outlives it."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from haptorb.arrays import Array
from haptorb.devices.loader import load
from haptorb.errors import DriverError
from haptorb.runtime.drivers.i2c import I2cDriver, Port, W1Thermometers, Watchdog
from haptorb.runtime.drivers.i2c_chips import I2cBus
from haptorb.runtime.drivers.i2c_guardian import watch
from oracles.chips import TCA9534, ChipBus, Thermometers


class Bench:
    """A driver on simulated chips whose coils follow their duties at once: 20 A at full duty."""

    def __init__(self) -> None:
        self.bus, self.pwm, self.currents, self.hall = ChipBus.of_device()
        self.select = next(chip for chip in self.bus.chips if isinstance(chip, TCA9534))
        self.driver = I2cDriver(load("omni"), self.bus, thermometers=Thermometers, clock=lambda: self.bus.now)
        self.ampere = 20.0

    def settle(self) -> None:
        for chip, duty in zip(self.currents, self.pwm.duties(), strict=True):
            chip.pass_time(0.6e-3, self.ampere * float(duty))

    def tick(self, duties: Array) -> Array:
        self.settle()
        sample = self.driver.read(0.0)
        self.driver.write(duties)
        return sample.currents

    def ticks(self, duties: Array, count: int) -> None:
        for _ in range(count):
            self.tick(duties)


SOME = np.array([0.5, -0.25, 0.125])


@pytest.fixture
def bench() -> Iterator[Bench]:
    one = Bench()
    one.driver.open()
    yield one
    one.driver.close()


def test_a_sample_says_how_old_currents_and_field_are(bench: Bench) -> None:
    """The bus takes 9 bytes for the currents, 11 for these sensors; what a current sensor tells is 0.5 ms old."""
    byte = 9 / 400e3
    bench.driver.read(0.0)
    bench.settle()
    sample = bench.driver.read(1.0)
    assert sample.currents_age == pytest.approx(0.53e-3 - 4.5 * byte)
    assert sample.field_age == pytest.approx(-(9 + 5.5) * byte)


def test_currents_and_field_are_read(bench: Bench) -> None:
    bench.hall.inputs[:, 6] = (0.6, 0.5, 0.4)
    for _ in range(4):
        currents = bench.tick(SOME)
    assert currents == pytest.approx(20 * SOME, abs=2e-3)
    parts = np.array([bench.driver.read(0.0).field for _ in range(6)])
    read = np.isfinite(parts)
    assert (read.sum(axis=0) == 1).all()  # every axis of every sensor once in six readings
    assert np.where(read, parts, 0.0).sum(axis=0)[5] == pytest.approx([0.011, 0.0, -0.011], abs=2e-5)
    sample = bench.driver.read(0.0)
    assert sample.temperatures.tolist() == [300.0] * 3
    assert not sample.pose.valid


def test_without_the_selector_the_sensors_have_one_axis() -> None:
    """The radial one; who needs three is told which chip to look for."""
    one = Bench()
    one.select.present = False
    radial = I2cDriver(load("omni"), one.bus, thermometers=Thermometers, watchdog=False)
    with radial as driver:
        assert driver.field_axes is not None
        driver.read(0.0)  # has what was read while it was opened
        field = driver.read(0.0).field
        assert np.isfinite(field).all(axis=1).sum() in (4, 5)
    picky = I2cDriver(load("omni"), one.bus, thermometers=Thermometers, hall_axes=3, watchdog=False)
    one.bus.closed = False
    with pytest.raises(DriverError, match=r"responds at 0x20 .* 1 axis"):
        picky.open()


def test_over_current_switches_off_and_stays_off(bench: Bench) -> None:
    bench.tick(SOME)
    bench.ampere = 60.0
    with pytest.raises(DriverError, match="coil x was above its limit"):
        bench.ticks(SOME, 4)
    assert bench.pwm.duties().tolist() == [0, 0, 0]
    assert bench.driver.write(SOME).tolist() == [0, 0, 0]
    with pytest.raises(DriverError, match="coil x"):
        bench.driver.read(0.0)
    bench.ampere = 20.0
    bench.settle()
    bench.driver.engage()
    bench.tick(SOME)
    assert bench.pwm.duties() == pytest.approx(SOME, abs=1e-3)


def test_a_chip_that_falls_silent_switches_off(bench: Bench) -> None:
    bench.tick(SOME)
    bench.currents[2].present = False
    with pytest.raises(DriverError, match="0x45"):
        bench.ticks(SOME, 3)
    assert bench.pwm.duties().tolist() == [0, 0, 0]
    with pytest.raises(DriverError, match=r"no INA219 .* at 0x45"):
        bench.driver.engage()


def test_open_names_what_is_missing() -> None:
    one = Bench()
    one.hall.present = False
    with pytest.raises(DriverError, match=r"MAX11616 .* at 0x35"):
        one.driver.open()
    assert one.pwm.duties().tolist() == [0, 0, 0]


class WarningLog:
    """A guardian that goes as soon as it is told to, and can be gone."""

    def __init__(self) -> None:
        self.gone = self.ended = False
        self.beats: list[bool] = []

    def wait_until_ready(self, timeout: float) -> bool:
        return not self.ended

    def beat(self, engaged: bool) -> None:
        if self.gone:
            raise DriverError("the guardian has switched off")
        self.beats.append(engaged)

    def leave(self) -> None:
        return

    def end(self, timeout: float) -> bool:
        self.ended = True
        return True


class PortWatch(Port):
    """Simulated chips and guardians of ours."""

    name = "i2c:watched"

    def __init__(self, bus: I2cBus) -> None:
        self.bus = bus
        self.guardians: list[WarningLog] = []

    def open(self) -> I2cBus:
        return self.bus

    def watcher(self) -> Watchdog:
        self.guardians.append(WarningLog())
        return self.guardians[-1]

    def close(self) -> None:
        return


def test_a_guardian_that_has_gone_means_no_current_until_there_is_another() -> None:
    bench = Bench()
    port = PortWatch(bench.bus)
    bench.driver = I2cDriver(load("omni"), port, thermometers=Thermometers, clock=lambda: bench.bus.now)
    with bench.driver:
        bench.tick(SOME)
        assert port.guardians[0].beats == [True]
        port.guardians[0].gone = True
        with pytest.raises(DriverError, match="guardian"):
            bench.driver.write(SOME)
        assert bench.pwm.duties().tolist() == [0, 0, 0]
        assert bench.driver.write(SOME).tolist() == [0, 0, 0]
        bench.driver.engage()
        assert len(port.guardians) == 2
        bench.tick(SOME)
        assert bench.pwm.duties() == pytest.approx(SOME, abs=1e-3)


def start_watch(timeout: float) -> tuple[int, list[float], threading.Thread, list[bool]]:
    read, write = os.pipe()
    off: list[float] = []
    ended: list[bool] = []
    thread = threading.Thread(target=lambda: ended.append(watch(read, lambda: off.append(time.monotonic()), timeout)))
    thread.start()
    return write, off, thread, ended


def test_guardian_switches_off_when_the_program_ends() -> None:
    write, off, thread, ended = start_watch(60.0)
    os.write(write, b"1")
    os.close(write)
    thread.join(10)
    assert len(off) == 1
    assert ended == [True]


def test_guardian_switches_off_when_the_program_hangs_and_is_not_talked_out_of_it() -> None:
    write, off, thread, ended = start_watch(0.05)
    os.write(write, b"1")
    thread.join(10)
    assert len(off) == 1
    assert ended == [False]
    with pytest.raises(BrokenPipeError):
        os.write(write, b"1")
    os.close(write)


def test_guardian_is_patient_while_nothing_is_engaged() -> None:
    write, off, thread, _ = start_watch(0.02)
    os.write(write, b"10")
    time.sleep(0.15)
    assert off == []
    os.close(write)
    thread.join(10)


def test_thermometers_of_the_kernel(tmp_path: Path) -> None:
    for number, text in (("28-03", "23125\n"), ("28-01", "21000\n"), ("28-02", "broken")):
        (tmp_path / number).mkdir()
        (tmp_path / number / "temperature").write_text(text)
    sensors = W1Thermometers(3, tmp_path)
    assert sensors.wait_until_ready(10.0)
    read = sensors.read()
    assert read[0] == pytest.approx(294.15)
    assert np.isnan(read[1])
    assert read[2] == pytest.approx(296.275)
    sensors.close()
    with pytest.raises(DriverError, match=r"4 DS18B20 .* found: 28-01, 28-02, 28-03"):
        W1Thermometers(4, tmp_path)
