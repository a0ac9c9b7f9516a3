"""The emulated chips against their data sheets, and the host's register drivers against the chips."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from haptorb.errors import DriverError
from haptorb.runtime.drivers.i2c_chips import ALL_OFF, HallAdc, Ina219, Pca9685
from oracles.chips import INA219, MAX11616, PCA9685, ChipBus

steps = st.lists(st.integers(-4095, 4095), min_size=3, max_size=3)


def pwm() -> tuple[ChipBus, PCA9685, Pca9685]:
    chip = PCA9685()
    bus = ChipBus([chip])
    driver = Pca9685(bus)
    driver.setup()
    return bus, chip, driver


def test_pwm_is_off_after_power_on_and_after_set_up() -> None:
    assert PCA9685().duties().tolist() == [0, 0, 0]
    _, chip, _ = pwm()
    assert chip.duties().tolist() == [0, 0, 0]
    assert chip.frequency == pytest.approx(1526, abs=1)


@given(st.lists(steps, min_size=1, max_size=10))
def test_every_duty_arrives_with_its_sign(series: list[list[int]]) -> None:
    _, chip, driver = pwm()
    for duties in series:
        driver.write(duties)
        assert chip.duties() == pytest.approx(np.array(duties) / 4096)


def test_a_burst_is_eleven_bytes_and_twenty_three_when_a_direction_changes() -> None:
    bus, _, driver = pwm()
    driver.write([1, 1, 1])
    lengths = []
    for duties in ([5, 5, 5], [5, -5, 5], [5, -6, 0], [5, -6, 7]):
        before = bus.bytes_carried
        driver.write(duties)
        lengths.append(bus.bytes_carried - before - 1)
    assert lengths == [11, 23, 11, 11]


def test_outputs_wait_for_stop() -> None:
    chip = PCA9685()
    bus = ChipBus([chip])
    driver = Pca9685(bus)
    driver.setup()
    chip.write(bytes((0x08, 0xFF, 0x07)))  # no STOP yet
    assert chip.level(0) == 0
    chip.stop()
    assert chip.level(0) == pytest.approx(0x7FF / 4096)


def test_always_off_wins() -> None:
    _, chip, driver = pwm()
    driver.write([4095, -4095, 3])
    driver.switch_off()
    assert chip.duties().tolist() == [0, 0, 0]
    chip.write(bytes((0x06, 0, 0x10, 0, 0x10)))
    chip.stop()
    assert chip.level(0) == 0


def test_prescaler_is_locked_while_awake() -> None:
    _, chip, _ = pwm()
    chip.write(bytes((0xFE, 100)))
    assert chip.registers[0xFE] == 3


def test_all_off_needs_no_knowledge_of_the_chip() -> None:
    bus, chip, driver = pwm()
    driver.write([4095, 4095, 4095])
    bus.transfer([(0x60, ALL_OFF)])
    assert chip.duties().tolist() == [0, 0, 0]


@given(st.integers(-31_999, 31_999))
def test_current_is_read_to_a_milliampere(milliampere: int) -> None:
    chip = INA219(0x41)
    driver = Ina219(ChipBus([chip]), 0x41)
    driver.setup()
    chip.pass_time(0.6e-3, milliampere / 1000)
    assert driver.current() == pytest.approx(milliampere / 1000, abs=1e-9)


def test_current_sensor_saturates_at_its_range() -> None:
    chip = INA219(0x41)
    driver = Ina219(ChipBus([chip]), 0x41)
    driver.setup()
    chip.pass_time(0.6e-3, 50.0)
    assert driver.current() == pytest.approx(32.0)


def test_a_reading_is_the_mean_of_one_conversion() -> None:
    chip = INA219(0x41)
    driver = Ina219(ChipBus([chip]), 0x41)
    driver.setup()
    chip.pass_time(0.2e-3, 9.0)
    assert driver.current() == 0.0
    chip.pass_time(0.4e-3, 3.0)
    assert driver.current() == pytest.approx(5.0)


def test_calibration_scales_the_chips_own_current_register() -> None:
    chip = INA219(0x41)
    chip.write(bytes((5, 0x10, 0x01)))  # bit 0 does not exist
    assert chip.registers[5] == 0x1000
    chip.pass_time(0.6e-3, -2.5)
    chip.write(bytes((4,)))
    assert int.from_bytes(chip.read(2), "big", signed=True) == -2500
    chip.write(bytes((0, 0x80, 0)))
    assert chip.registers[0] == 0x399F


def test_hall_sensors_are_found_on_both_blocks() -> None:
    chip = MAX11616()
    chip.inputs[0] = np.linspace(0, 1, 12)
    driver = HallAdc(ChipBus([chip]))
    driver.setup()
    read = np.concatenate([driver.read(0), driver.read(1)])
    assert read == pytest.approx(chip.inputs[0, [0, 1, 2, 3, 4, 6, 7, 8, 9]], abs=0.5 / 4095)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda bus: Pca9685(bus), "no PCA9685 .* at 0x60"),
        (lambda bus: Ina219(bus, 0x44), "no INA219 .* at 0x44"),
        (lambda bus: HallAdc(bus), "no MAX11616 .* at 0x35"),
    ],
)
def test_a_missing_chip_is_named_with_its_address(make, message: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(DriverError, match=message):
        make(ChipBus([])).setup()


def test_another_chip_at_the_address_is_noticed() -> None:
    with pytest.raises(DriverError, match="not a PCA9685"):
        Pca9685(ChipBus([INA219(0x60)])).setup()
    with pytest.raises(DriverError, match="not an INA219"):
        Ina219(ChipBus([PCA9685(0x41)]), 0x41).setup()
    with pytest.raises(DriverError, match="not a MAX11616"):
        HallAdc(ChipBus([INA219(0x35)])).setup()
