"""Contract of all drivers: coils off outside open and close, clipping reported, no automatic reconnection.

The simulated driver, the I²C driver on simulated chips, and, where the cross-compiler is installed, the serial driver
on the emulated firmware.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware.make_firmware import make_firmware
from haptorb.arrays import Array
from haptorb.control.trip_reasons import CoilState
from haptorb.devices.loader import load
from haptorb.errors import DriverError, InputError
from haptorb.runtime.drivers.base import Driver
from haptorb.runtime.drivers.emulator_process import Emulator
from haptorb.runtime.drivers.i2c import I2cDriver
from haptorb.runtime.drivers.serial import SerialDriver
from haptorb.runtime.drivers.sim import SimDriver
from oracles.chips import ChipBus, OpenBus, Thermometers

SOME = np.array([0.05, -0.03, 0.02])


class Subject:
    """A driver, and a way to see what its coils really get; `repeats`: the same ticks read the same numbers."""

    def __init__(
        self,
        driver: Driver,
        coils: Callable[[], Array],
        between: Callable[[], None] = lambda: None,
        *,
        repeats: bool = True,
    ) -> None:
        self.driver, self.coils, self.between, self.repeats = driver, coils, between, repeats
        self.now = 0.0

    def tick(self, duties: Array) -> tuple[Any, Array]:
        self.between()
        sample = self.driver.read(self.now)
        self.now += 1e-3
        return sample, self.driver.write(duties)


def sim_subject() -> Subject:
    driver = SimDriver.of(load("omni"), 1e-3)
    return Subject(driver, lambda: driver._duties)


def i2c() -> Subject:
    bus, pwm, currents, _ = ChipBus.of_device()

    def coils_follow() -> None:
        for chip, duty in zip(currents, pwm.duties(), strict=True):
            chip.pass_time(0.6e-3, 20.0 * float(duty))

    driver = I2cDriver(load("omni"), OpenBus(bus), thermometers=Thermometers, clock=lambda: bus.now)
    return Subject(driver, pwm.duties, coils_follow)


BESIDE_A_CLOCK = [pytest.mark.firmware, pytest.mark.realtime(retry=False), pytest.mark.timeout(600)]


@pytest.fixture(params=["sim", "i2c", pytest.param("serial", marks=BESIDE_A_CLOCK)])
def subject(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Subject]:
    if request.param == "sim":
        yield sim_subject()
        return
    if request.param == "i2c":
        yield i2c()
        return
    if shutil.which("avr-gcc") is None or not Path("/usr/include/simavr/sim_avr.h").exists():
        pytest.skip("gcc-avr or libsimavr-dev is not installed")
    emulator = Emulator(make_firmware("all", "emulator"), tmp_path / "omni")
    driver = SerialDriver(load("omni"), emulator.port, timeout=1.0, warm_up=90.0)
    original = driver.open

    def open_then_slow() -> None:
        emulator.execute("pace 1")
        original()
        emulator.set_pace()

    driver.open = open_then_slow  # type: ignore[method-assign]
    yield Subject(
        driver, lambda: np.array([float(one) for one in emulator.status()["duty"].split(",")]), repeats=False
    )  # the emulator's time passes by itself
    driver.close()
    emulator.close()


def test_coils_are_off_before_open_and_after_close(subject: Subject) -> None:
    driver = subject.driver
    assert subject.coils() == pytest.approx(np.zeros(3), abs=0)
    with pytest.raises(DriverError, match="open"):
        driver.read(0.0)
    assert driver.write(SOME).tolist() == [0, 0, 0]
    driver.open()
    for _ in range(5):
        subject.tick(SOME)
    assert subject.coils() == pytest.approx(SOME, abs=1e-3)
    driver.close()
    driver.close()
    assert subject.coils() == pytest.approx(np.zeros(3), abs=0)
    assert driver.write(SOME).tolist() == [0, 0, 0]


def test_the_coils_state_is_told(subject: Subject) -> None:
    driver = subject.driver
    with driver:
        assert driver.coil_state is CoilState.OFF
        for _ in range(5):
            subject.tick(SOME)
        assert driver.coil_state is CoilState.ON
    assert driver.coil_state is CoilState.OFF


def test_leaving_with_by_an_exception_switches_off(subject: Subject) -> None:
    def fail() -> None:
        with subject.driver:
            for _ in range(5):
                subject.tick(SOME)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert subject.coils() == pytest.approx(np.zeros(3), abs=0)


def test_a_sample_has_the_devices_shapes(subject: Subject) -> None:
    with subject.driver:
        sample, _ = subject.tick(np.zeros(3))
    assert sample.currents.shape == (3,)
    assert sample.temperatures.shape == (3,)
    assert sample.field.shape == (9, 3)
    assert np.isfinite(sample.currents).all()
    assert np.isfinite(sample.temperatures).all()
    assert np.isfinite(sample.field).all()


def test_what_was_applied_is_told_in_the_choppers_steps(subject: Subject) -> None:
    with subject.driver:
        for duties in (SOME, np.array([0.1234567, -0.0001, 0.0])):
            _, applied = subject.tick(duties)
            assert applied == pytest.approx(np.round(duties * 4096) / 4096, abs=1e-9)


def test_a_duty_that_is_no_number_is_zero_and_too_much_is_clipped(subject: Subject) -> None:
    with subject.driver:
        _, applied = subject.tick(np.array([np.nan, 0.01, 0.0]))
        assert applied[0] == 0
        subject.tick(np.zeros(3))
        _, applied = subject.tick(np.array([0.0, 0.0, 7.0]))
        assert 0.99 <= applied[2] <= 1.0
        subject.tick(np.zeros(3))


def test_it_can_be_opened_again(subject: Subject) -> None:
    for _ in range(2):
        with subject.driver as driver:
            subject.now = 0.0
            for _ in range(3):
                subject.tick(SOME)
            assert subject.coils() == pytest.approx(SOME, abs=1e-3)
            assert driver.wrench_actual().shape == (6,)


def test_engaging_what_runs_changes_nothing(subject: Subject) -> None:
    with subject.driver as driver:
        for _ in range(3):
            subject.tick(SOME)
        driver.engage()
        _, applied = subject.tick(SOME)
        assert applied == pytest.approx(SOME, abs=1e-3)


def prepare_and_apply(subject: Subject, times: int) -> tuple[Array, Array]:
    """What ten ticks, each prepared so many times, applied (10, 3) [1], and what they read (10, 33)."""
    subject.now = 0.0
    applied, read = [], []
    with subject.driver as driver:
        for n in range(10):
            for _ in range(times):
                driver.prepare(subject.now)
            sample, duties = subject.tick(SOME * (n % 4))
            applied.append(duties)
            read.append(np.concatenate((sample.currents, sample.temperatures, sample.field.ravel())))
    return np.array(applied), np.array(read)


def test_a_tick_is_the_same_whether_it_was_prepared_or_not_or_twice(subject: Subject) -> None:
    applied, read = prepare_and_apply(subject, 0)
    assert applied.any()
    for times in (1, 2):
        applied_then, read_then = prepare_and_apply(subject, times)
        np.testing.assert_array_equal(applied_then, applied)
        if subject.repeats:
            np.testing.assert_array_equal(read_then, read)


def test_preparing_never_moves_a_coil(subject: Subject) -> None:
    def prepare_and_see(coils: Array) -> None:
        for _ in range(2):
            driver.prepare(subject.now)
            assert subject.coils() == pytest.approx(coils, abs=1e-3)

    driver, off = subject.driver, np.zeros(3)
    for opened in (False, True):  # not yet, and no longer: silence, or what `read` says as well
        with suppress(DriverError):
            prepare_and_see(off)
        with pytest.raises(DriverError, match="open"):
            driver.read(subject.now)
        assert subject.coils() == pytest.approx(off, abs=0)
        if opened:
            return
        with driver:
            prepare_and_see(off)
            for _ in range(5):
                subject.tick(SOME)
            prepare_and_see(SOME)
            for _ in range(3):
                subject.tick(off)
            prepare_and_see(off)
            for _ in range(3):
                subject.tick(SOME)
            prepare_and_see(SOME)


def test_a_name_whether_it_is_simulated_and_how_long_before_a_tick_it_prepares(subject: Subject) -> None:
    assert subject.driver.name
    assert isinstance(subject.driver.simulated, bool)
    assert isinstance(subject.driver.lead, float)
    assert 0.0 <= subject.driver.lead < 1e-3


def test_a_device_with_other_channels_is_refused() -> None:
    for make in (lambda: SerialDriver(load("pmsm"), "/dev/null"), lambda: I2cDriver(load("pmsm"), 1)):
        with pytest.raises((DriverError, InputError), match="coils"):
            make()


def test_a_driver_with_the_methods_of_version_0_1_works_with_a_remark() -> None:
    with pytest.warns(FutureWarning, match=r"truth\(\) is now called wrench_actual\(\)"):

        class Earlier(SimDriver):  # type: ignore[misc]
            def truth(self) -> Array:
                return np.ones(6)

    driver = Earlier(SimDriver.of(load("omni"), 1e-3).simulation, 1e-3)
    assert driver.wrench_actual().tolist() == [1.0] * 6
