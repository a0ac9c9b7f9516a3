"""Messages: decoded bytes in SI units, and errors of invalid ones."""

from __future__ import annotations

import struct
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from haptorb.errors import DriverError, InputError
from haptorb.runtime.drivers.base import counts
from haptorb.runtime.drivers.serial_protocol import (
    READING_BYTES,
    BoardLimits,
    BoardMode,
    BoardState,
    Command,
    Identity,
    Reading,
    Reason,
    Refusal,
    engage,
    missing_chips,
    set_duties,
)


def reading(**changes: int) -> bytes:
    fields = {
        "mode": 1, "reason": 0, "missing": 0, "d0": 4095, "d1": -4095, "d2": 1, "i0": 19000, "i1": -19000, "i2": 5,
        "group": 0, "h0": 2048, "h1": 0, "h2": 4095, "h3": 1, "h4": 2, "thermometer": 1, "temperature": 400,
        "age": 868, "hall_age": 420, "errors": 3, "rounds": 17,
    }  # fmt: skip
    return struct.pack("<BBH3h3hB5HBhHHBB", *(fields | changes).values())


def test_a_reading_is_told_in_si() -> None:
    said = Reading.parse(reading())
    assert said.mode is BoardMode.ENGAGED
    assert said.applied == pytest.approx([4095 / 4096, -4095 / 4096, 1 / 4096])
    assert said.currents == pytest.approx([19.0, -19.0, 0.005])
    assert said.hall == pytest.approx(np.array([2048, 0, 4095, 1, 2]) / 4095)
    assert (said.hall_axis, said.hall_first, said.hall_fresh) == (0, 0, True)
    assert said.hall_age == pytest.approx(420e-6)
    assert (said.thermometer, said.temperature) == (1, pytest.approx(298.15))
    assert said.age == pytest.approx(868e-6)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_second_block_has_four_sensors(axis: int) -> None:
    said = Reading.parse(reading(group=2 * axis + 1, h4=0xFFFF))
    assert (said.hall_axis, said.hall_first, len(said.hall)) == (axis, 5, 4)
    assert not Reading.parse(reading(group=0x80 | 2 * axis)).hall_fresh


def test_what_has_not_been_read_is_not_a_number() -> None:
    said = Reading.parse(reading(h2=0xFFFF, temperature=0x7FFF))
    assert np.isnan(said.hall[2])
    assert np.isnan(said.temperature)


@pytest.mark.parametrize(
    "payload", [b"", bytes(READING_BYTES - 1), bytes(READING_BYTES + 1), reading(group=6), reading(thermometer=3)]
)
def test_a_reading_of_another_shape_is_refused(payload: bytes) -> None:
    with pytest.raises(DriverError, match="firmware"):
        Reading.parse(payload)


@given(st.binary(max_size=40))
def test_any_payload_is_a_message_or_a_driver_error(payload: bytes) -> None:
    for kind in (Reading, BoardState, BoardLimits, Identity):
        with suppress(DriverError):
            kind.parse(payload)


@given(st.binary(min_size=READING_BYTES, max_size=READING_BYTES))
def test_a_state_that_nobody_knows_counts_as_tripped(payload: bytes) -> None:
    try:
        said = Reading.parse(payload)
    except DriverError:
        return
    assert said.mode in BoardMode
    assert payload[0] in (0, 1, 2) or said.mode is BoardMode.TRIPPED


def test_another_protocol_is_told_with_both_versions() -> None:
    with pytest.raises(DriverError, match=r"version 9, this program version 3.*make firmware"):
        Identity.parse(bytes((9,)) + bytes(31))


def test_identity_and_limits() -> None:
    who = Identity.parse(struct.pack("<9B8s16s", 3, 1, 4, 2, 3, 9, 3, 3, 18, b"haptorb\0", bytes(range(16))))
    assert (who.board, who.version, who.reset, who.name) == ("ATmega2560", (1, 4), Reason.BROWN_OUT, "haptorb")
    assert (who.hall_sensors, who.hall_axes) == (9, 3)
    assert who.calibration == bytes(range(16))
    limits = BoardLimits.parse(struct.pack("<7Hh2H", 4095, 21000, 400, 5000, 15, 5300, 4300, 1360, 4095, 1000))
    assert limits.current == pytest.approx(21.0)
    assert limits.boundary == pytest.approx(358.15)
    assert limits.silence == pytest.approx(0.015)


def test_a_refusal_is_named() -> None:
    said = BoardState.parse(struct.pack("<BBHB", 2, 3, 0x20, 2))
    assert (said.mode, said.reason, said.refusal) == (BoardMode.TRIPPED, Reason.OVER_CURRENT, Refusal.TRIPPED)
    assert missing_chips(said.missing) == ("thermometer DS18B20 of coil x on D5",)


@given(st.lists(st.floats(width=64), min_size=3, max_size=3))
def test_no_duty_exceeds_full_scale(duties: list[float]) -> None:
    steps = counts(duties)
    assert all(-4095 <= step <= 4095 for step in steps)
    assert all(step == 0 for step, duty in zip(steps, duties, strict=True) if duty != duty)
    assert len(set_duties(1, steps).payload) == 6


def test_duties_need_one_entry_per_coil() -> None:
    with pytest.raises(InputError, match="one entry per coil"):
        counts([0.0, 0.0])


@pytest.mark.parametrize(("duty", "current"), [(0.0, 1.0), (1.1, 1.0), (0.5, 0.0), (0.5, 66.0), (float("nan"), 1.0)])
def test_session_limits_must_make_sense(duty: float, current: float) -> None:
    with pytest.raises(InputError):
        engage(1, duty, current)


def test_engage_carries_key_and_limits() -> None:
    frame = engage(7, 0.25, 4.0)
    assert frame.type == Command.ENGAGE
    assert struct.unpack("<3H", frame.payload) == (0x5AFE, 1024, 4000)


def test_every_reason_has_a_text() -> None:
    assert all(reason.text for reason in Reason)
