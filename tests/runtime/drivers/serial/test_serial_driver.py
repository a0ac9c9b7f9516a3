"""Serial driver with a scripted board: rejected replies, latches, and reported reasons."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from pretend_board import PretendBoard

from haptorb.control.trip_reasons import CoilState
from haptorb.devices.loader import load
from haptorb.errors import DriverError, InputError
from haptorb.runtime.drivers.serial import SerialDriver
from haptorb.runtime.drivers.serial_protocol import BoardMode, Command, Reason, Refusal

OMNI = load("omni")
SOME = np.array([0.1, -0.05, 0.02])
OFF = np.zeros(3)

Make = Callable[..., tuple[PretendBoard, SerialDriver]]


@pytest.fixture
def made() -> Iterator[Make]:
    """A board, and a driver that is open or, opened=False, not yet."""
    running: list[tuple[PretendBoard, SerialDriver]] = []

    def make(axes: int = 3, *, opened: bool = True, **of_driver: Any) -> tuple[PretendBoard, SerialDriver]:
        board = PretendBoard(axes)
        driver = SerialDriver(OMNI, board.path, timeout=of_driver.pop("timeout", 0.5), **of_driver)
        running.append((board, driver))
        if opened:
            driver.open()
        return board, driver

    yield make
    for board, driver in running:
        board.mute = False
        driver.close()
        board.close()


def ticks(driver: SerialDriver, duties: Any, count: int) -> list[Any]:
    samples = []
    for n in range(count):
        samples.append(driver.read(1e-3 * n))
        driver.write(duties)
    return samples


def test_every_field_channel_is_told_in_its_turn(made: Make) -> None:
    _, driver = made()
    fields = np.array([sample.field for sample in ticks(driver, OFF, 7)][1:])
    told = np.isfinite(fields)
    assert told.sum(axis=(1, 2)).tolist() in ([5, 4] * 3, [4, 5] * 3)
    assert (told.sum(axis=0) == 1).all()
    group, place = 4, 2  # block 0 of axis z: its codes begin at 2448
    assert np.nanmax(fields[:, place, 2]) == pytest.approx(((2048 + 100 * group + place) / 4095 - 0.5) * 0.1)


def test_what_is_set_is_told_back_in_si(made: Make) -> None:
    board, driver = made()
    sample = ticks(driver, SOME, 4)[-1]
    assert board.duties == [410, -205, 82]
    assert sample.currents == pytest.approx(np.array([2.05, -1.025, 0.41]))
    assert sample.temperatures == pytest.approx(273.15 + np.array([25.0, 26.0, 27.0]))


def test_a_sample_says_how_old_currents_and_field_are(made: Make) -> None:
    """By the tick in which they were asked for: a loop that was held up finds an answer that has been lying there."""
    now = 0.0
    _, driver = made(clock=lambda: now)
    for n in range(20):
        period = 6e-3 if n % 4 == 3 else 1e-3
        now += period
        sample = driver.read(now)
        driver.write(SOME)
        if n > 0:  # the first is asked in its own tick
            assert sample.field_age == pytest.approx(period - 0.25e-3 + 420e-6 + 0.15e-3)
            assert sample.currents_age == pytest.approx(period - 0.25e-3 + 868e-6 + 0.43e-3)


def test_sensors_of_one_axis_do_not_do_where_three_are_needed(made: Make) -> None:
    board, driver = made(1, opened=False, hall_axes=3)
    with pytest.raises(DriverError, match=r"1 axis, the tracker 'hall' needs 3.*another tracker"):
        driver.open()
    assert driver.write(SOME).tolist() == [0, 0, 0]
    assert not [frame for frame in board.heard if frame.type in (Command.SET, Command.ENGAGE)]


def test_sensors_of_one_axis_say_where_they_look(made: Make) -> None:
    _, driver = made(1)
    radial = OMNI.hall.positions / np.linalg.norm(OMNI.hall.positions, axis=1, keepdims=True)
    assert driver.field_axes == pytest.approx(radial)
    field = next(s.field for s in ticks(driver, OFF, 3) if np.isfinite(s.field[0]).all())
    assert np.cross(field[0], radial[0]) == pytest.approx(OFF, abs=1e-12)


@pytest.mark.parametrize(
    ("reason", "told"),
    [
        (Reason.OVER_CURRENT, "current was above the limit"),
        (Reason.STOP_BUTTON, "stop button"),
        (Reason.SILENCE, "host was silent"),
        (Reason.HOT, "above 85 °C"),
    ],
)
def test_a_trip_is_told_with_its_reason_and_latches(made: Make, reason: Reason, told: str) -> None:
    board, driver = made()
    ticks(driver, SOME, 3)
    board.mode, board.reason = BoardMode.TRIPPED, reason
    with pytest.raises(DriverError, match=told):
        ticks(driver, SOME, 3)
    board.mode = BoardMode.OFF  # whatever the board thinks: a person must engage
    heard = len(board.heard)
    for _ in range(5):
        driver.read(0.0)
        assert driver.write(SOME).tolist() == [0, 0, 0]
    assert not [frame for frame in board.heard[heard:] if frame.type in (Command.SET, Command.ENGAGE)]
    driver.engage()
    ticks(driver, SOME, 3)
    assert board.duties == [410, -205, 82]


def test_a_chip_that_tripped_it_is_named(made: Make) -> None:
    board, driver = made()
    ticks(driver, SOME, 3)
    board.mode, board.reason, board.missing = BoardMode.TRIPPED, Reason.CHIP, 0b100
    with pytest.raises(DriverError, match=r"INA219 of coil y at 0x44"):
        ticks(driver, SOME, 3)


def test_a_board_that_restarted_is_not_driven_on(made: Make) -> None:
    board, driver = made()
    ticks(driver, SOME, 3)
    board.mode, board.reason = BoardMode.OFF, Reason.BROWN_OUT
    with pytest.raises(DriverError, match=r"supply dropped"):
        ticks(driver, SOME, 3)
    assert driver.write(SOME).tolist() == [0, 0, 0]


@pytest.mark.parametrize(
    ("refusal", "missing", "told"),
    [(Refusal.STOP_BUTTON, 0, "stop button"), (Refusal.CHIP, 0b1000, "INA219 of coil z at 0x45")],
)
def test_a_refusal_to_engage_is_told(made: Make, refusal: Refusal, missing: int, told: str) -> None:
    board, driver = made()
    board.refusal, board.missing = refusal, missing
    with pytest.raises(DriverError, match=rf"refused to engage.*{told}"):
        driver.write(SOME)
    assert driver.write(SOME).tolist() == [0, 0, 0]


def test_a_part_that_is_missing_is_named_before_anything_flows(made: Make) -> None:
    board, driver = made(opened=False, warm_up=0.05)
    board.missing = 0b100100
    with pytest.raises(DriverError, match=r"INA219 of coil y at 0x44; thermometer DS18B20 of coil x on D5"):
        driver.open()


def test_three_answers_missed_in_a_row_are_a_device_that_has_gone(made: Make) -> None:
    board, driver = made(timeout=0.02)
    ticks(driver, SOME, 3)
    driver._timeout = 0.002
    board.mute = True
    with pytest.raises(DriverError, match="no response from the firmware"):
        ticks(driver, SOME, 4)
    assert driver.write(SOME).tolist() == [0, 0, 0]


def test_who_waits_for_an_answer_goes_on_talking(made: Make) -> None:
    # A firmware switches off after 15 ms of silence: waiting longer in silence would be the silence.
    board, driver = made(timeout=0.5)
    ticks(driver, SOME, 3)
    driver._timeout = 0.2
    board.heard.clear()
    board.mute = True
    ticks(driver, SOME, 2)
    board.mute = False
    sample = driver.read(1.0)
    said = [frame for frame in board.heard if frame.type == Command.SET]
    assert len(said) == len(board.heard) >= 6  # two ticks, asked again nine times each if the computer is not too busy
    assert {frame.payload for frame in said} == {said[0].payload}
    assert len({frame.sequence for frame in said}) == len(said)
    assert np.abs(sample.currents).max() > 1  # and the duties are what they were


def test_a_late_answer_is_as_good_as_that_to_the_last_question(made: Make) -> None:
    board, driver = made(timeout=0.5)
    ticks(driver, SOME, 3)
    driver._timeout, board.late = 0.4, 0.012  # later than a question is asked again
    assert len(ticks(driver, SOME, 6)) == 6
    assert driver._lost == 0
    board.late = 0.0
    driver._timeout = 0.5
    ticks(driver, SOME, 10)  # until what was late has come, too


def test_who_waits_at_rest_asks_and_engages_nothing(made: Make) -> None:
    board, driver = made(timeout=0.02)
    ticks(driver, OFF, 3)
    driver.read(1.0)  # nothing is on its way any more
    board.heard.clear()
    board.mute = True
    driver.read(2.0)
    assert {frame.type for frame in board.heard} == {Command.READ}


def test_at_rest_the_answer_is_there_when_the_next_tick_reads(made: Make) -> None:
    board, driver = made()
    ticks(driver, OFF, 3)
    time.sleep(0.1)  # until the last question is heard and answered
    heard = len(board.heard)
    board.mute = True  # what is asked from now on is not answered, and need not be
    driver.read(1.0)
    assert len(board.heard) == heard
    assert driver.fault == ""


def test_a_silent_board_at_rest_is_given_more_time(made: Make) -> None:
    board, driver = made(timeout=0.02)
    driver._timeout = 0.002
    board.mute = True
    ticks(driver, OFF, 19)
    with pytest.raises(DriverError, match="no response from the firmware"):
        ticks(driver, OFF, 2)


def test_a_reading_of_another_shape_switches_off(made: Make) -> None:
    board, driver = made()
    ticks(driver, SOME, 3)
    board.payload = bytes(35)
    with pytest.raises(DriverError, match="35 bytes where protocol 3 has 36"):
        ticks(driver, SOME, 2)
    assert driver.write(SOME).tolist() == [0, 0, 0]


def test_an_id_is_kept_when_the_firmware_says_that_it_is_and_not_before(made: Make) -> None:
    board, driver = made()
    board.writing = 4
    assert driver.remember(bytes(range(16)))
    assert board.calibration == bytes(range(16))
    assert sum(frame.type == Command.STORE for frame in board.heard) == 5  # asked until it was written
    board.refusal = Refusal.EEPROM
    with pytest.raises(DriverError, match="worn out"):
        driver.remember(bytes(16))
    assert driver.calibration == bytes(range(16))


@pytest.mark.parametrize(
    ("why", "missing", "told"),
    [
        (Refusal.HOT, 0, "above 85 °C"),
        (Refusal.THERMOMETER, 0x40, "DS18B20 of coil y on D6 has sent nothing"),
        (Refusal.THERMOMETER, 0, "a thermometer has sent nothing"),
        (Refusal.WRITING, 0, "being written"),
    ],
)
def test_why_engaging_is_refused_is_told(made: Make, why: Refusal, missing: int, told: str) -> None:
    board, driver = made()
    board.refusal, board.missing = why, missing
    with pytest.raises(DriverError, match=told):
        ticks(driver, SOME, 3)
    assert driver.write(SOME).tolist() == [0, 0, 0]
    assert board.duties == [0, 0, 0]


def test_the_device_keeps_the_id_of_its_calibration(made: Make) -> None:
    board, driver = made()
    ticks(driver, SOME, 2)
    wanted = bytes(range(16))
    assert driver.remember(wanted)
    assert driver.calibration == board.calibration == wanted
    assert board.mode is BoardMode.OFF


def test_duties_have_one_entry_per_coil(made: Make) -> None:
    _, driver = made()
    with pytest.raises(InputError, match="one entry per coil"):
        driver.write(np.zeros(2))


def test_the_coils_state_is_what_the_firmware_says_and_unknown_without_a_word(made: Make) -> None:
    board, driver = made(opened=False, timeout=0.05)
    assert driver.coil_state is CoilState.UNKNOWN
    driver.open()
    assert driver.coil_state is CoilState.OFF
    ticks(driver, SOME, 2)
    assert driver.coil_state is CoilState.ON
    board.mode, board.reason = BoardMode.TRIPPED, Reason.OVER_CURRENT
    with pytest.raises(DriverError, match="limit"):
        ticks(driver, SOME, 2)
    assert driver.coil_state is CoilState.OFF
    board.mode, board.reason = BoardMode.OFF, Reason.NONE
    driver.engage()
    ticks(driver, SOME, 2)
    board.mute = True
    with pytest.raises(DriverError, match="no response"):
        ticks(driver, SOME, 5)
    assert driver.coil_state is CoilState.UNKNOWN
    with pytest.raises(DriverError):
        driver.read(1.0)
    assert driver.coil_state is CoilState.UNKNOWN
    board.mute = False
    end = time.monotonic() + 10.0
    while driver.coil_state is not CoilState.OFF and time.monotonic() < end:
        with suppress(DriverError):
            driver.read(1.0)
    assert driver.coil_state is CoilState.OFF
    assert board.mode is BoardMode.OFF


def test_a_board_that_does_not_say_goodbye_leaves_the_state_unknown(made: Make) -> None:
    board, driver = made(timeout=0.05)
    driver.close()
    assert driver.coil_state is CoilState.OFF
    driver.open()
    ticks(driver, SOME, 2)
    board.mute = True
    driver.close()
    assert driver.coil_state is CoilState.UNKNOWN
