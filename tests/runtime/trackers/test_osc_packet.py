"""Arbitrary OSC packets are read completely or rejected, in bounded time."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pythonosc.osc_bundle_builder import OscBundleBuilder
from pythonosc.osc_message_builder import OscMessageBuilder

from haptorb.errors import InputError
from haptorb.runtime.trackers.osc_feed import read_packet
from oracles.repetitions import repetitions


def make_message(address: str, *values: object):
    builder = OscMessageBuilder(address)
    for value in values:
        builder.add_arg(value)
    return builder.build()


def make_bundle(*contents):
    builder = OscBundleBuilder(1e9)
    for content in contents:
        builder.add_content(content)
    return builder.build()


def test_messages_of_bundles_within_bundles_come_in_order() -> None:
    inner = make_bundle(make_message("/b", "text", 2.0), make_message("/c"))
    packet = make_bundle(make_message("/a", 1), inner, make_message("/d", True, None))
    assert read_packet(packet.dgram) == [("/a", [1]), ("/b", ["text", 2.0]), ("/c", []), ("/d", [True, None])]


@pytest.mark.parametrize("size", [-4, -2147483648, 0, 3, 2147483644, 100])
def test_an_impossible_size_in_a_bundle_is_refused(size: int) -> None:
    with pytest.raises(InputError):
        read_packet(b"#bundle\0" + bytes(7) + b"\x01" + struct.pack(">i", size) + b"/a\0\0,\0\0\0")


@pytest.mark.parametrize("data", [b"", b"/", b"#bundle\0", b"text", b"/a\0\0,?\0\0", b"#bundle\0" + bytes(9)])
def test_what_is_no_packet_is_refused(data: bytes) -> None:
    with pytest.raises(InputError):
        read_packet(data)


def test_deep_bundles_are_refused() -> None:
    packet = make_message("/a", 1)
    for _ in range(6):
        packet = make_bundle(packet)
    with pytest.raises(InputError, match="bundles"):
        read_packet(packet.dgram)


@settings(max_examples=repetitions(50, 150), deadline=None)
@given(
    st.binary(max_size=200),
    st.sampled_from([b"", b"/", b"#bundle\0" + bytes(8), b"/a\0\0,s\0\0", b"/a\0\0,fff\0\0\0\0"]),
)
def test_nonsense_is_refused_or_read_and_nothing_else(nonsense: bytes, start: bytes) -> None:
    try:
        found = read_packet(start + nonsense)
    except InputError:
        return
    assert all(isinstance(address, str) and isinstance(values, list) for address, values in found)
