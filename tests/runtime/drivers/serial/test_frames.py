"""Frames: identical on both sides, found in any noise, never falsely detected."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from haptorb.errors import InputError
from haptorb.runtime.drivers.serial_protocol import PAYLOAD_MAX, SYNC, Frame, FrameParser, crc16, encode, find_frame

VECTORS = Path(__file__).resolve().parents[4] / "firmware" / "vectors" / "frames.txt"

frames = st.builds(Frame, st.integers(0, 255), st.integers(0, 255), st.binary(max_size=PAYLOAD_MAX))


def vectors() -> list[tuple[str, Frame, bytes]]:
    rows = [line.split() for line in VECTORS.read_text().splitlines() if not line.startswith("#")]
    return [
        (name, Frame(int(kind, 16), int(number, 16), b"" if body == "-" else bytes.fromhex(body)), bytes.fromhex(whole))
        for name, kind, number, body, whole in rows
    ]


@pytest.mark.parametrize(("name", "frame", "whole"), vectors(), ids=[row[0] for row in vectors()])
def test_the_firmwares_frames_are_the_hosts(name: str, frame: Frame, whole: bytes) -> None:
    assert encode(frame) == whole
    assert FrameParser().feed(whole) == [frame]


def test_check_sum_is_ccitt_false() -> None:
    assert crc16(b"123456789") == 0x29B1


@given(st.lists(frames, max_size=5), st.lists(st.integers(1, 7), min_size=1, max_size=20))
def test_frames_arrive_whole_however_they_are_cut(sent: list[Frame], cuts: list[int]) -> None:
    line = b"".join(encode(frame) for frame in sent)
    parser, heard, at = FrameParser(), [], 0
    while at < len(line):
        step = cuts[at % len(cuts)]
        heard += parser.feed(line[at : at + step])
        at += step
    assert heard == sent
    assert parser.bad_frames == 0


@given(frames, st.binary(max_size=60).filter(lambda noise: SYNC[0] not in noise))
def test_a_frame_is_found_behind_noise(frame: Frame, noise: bytes) -> None:
    assert FrameParser().feed(noise + encode(frame)) == [frame]


@given(frames, frames)
def test_a_damaged_frame_does_not_take_the_next_one_with_it(first: Frame, second: Frame) -> None:
    line = bytearray(encode(first))
    line[-1] ^= 0x40
    assert second in FrameParser().feed(bytes(line) + encode(second) + bytes(PAYLOAD_MAX + 7))


@given(frames, st.data())
def test_up_to_three_flipped_bits_are_noticed(frame: Frame, data: st.DataObject) -> None:
    line = bytearray(encode(frame))
    places = st.lists(st.integers(24, 8 * len(line) - 1), min_size=1, max_size=3, unique=True)
    for bit in data.draw(places):
        line[bit // 8] ^= 1 << bit % 8
    assert FrameParser().feed(bytes(line)) == []


def test_what_is_no_frame_cannot_be_encoded() -> None:
    with pytest.raises(InputError, match="at most 40 bytes"):
        encode(Frame(1, 1, bytes(41)))
    with pytest.raises(InputError, match="are bytes"):
        encode(Frame(256, 0, b""))


def test_ten_million_random_bytes_are_no_frame_and_do_not_stop_the_parser() -> None:
    source = random.Random(20201120)
    parser = FrameParser()
    true = Frame(0x83, 7, b"a reading")
    heard: list[Frame] = []
    for _ in range(1000):
        noise = bytearray(source.randbytes(10_000))
        for _ in range(20):  # rich in beginnings of frames
            at = source.randrange(len(noise) - 2)
            noise[at : at + 2] = SYNC
        heard += parser.feed(bytes(noise))
        assert parser.held["end"] - parser.held["begin"] <= PAYLOAD_MAX + 7
    assert heard == []
    assert parser.bad_frames > 1000
    assert true in parser.feed(encode(true) + bytes(PAYLOAD_MAX + 7))


def test_the_test_above_can_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    """A parser that believes every check sum, interpreted instead of compiled."""
    monkeypatch.setattr(
        "haptorb.runtime.drivers.serial_protocol._check", lambda line, first, last: line[last] | line[last + 1] << 8
    )
    monkeypatch.setattr(
        "haptorb.runtime.drivers.serial_protocol.find_frame",
        lambda line, held: find_frame.py_func(line, held.view(np.recarray)),
    )
    noise = bytearray(random.Random(1).randbytes(2_000))
    for at in range(0, len(noise) - 20, 20):
        noise[at : at + 3] = SYNC + b"\x02"
    assert FrameParser().feed(bytes(noise))
