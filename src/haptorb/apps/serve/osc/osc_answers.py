"""OSC messages that go back to the program that sent one."""

from __future__ import annotations

from typing import Any

from pythonosc.osc_message_builder import OscMessageBuilder

from haptorb.worlds.parameter import Parameter

__all__ = ["make_message", "make_parameter_answer"]

_LONGEST = 400  #: characters of a text


def make_message(address: str, *values: str | float | int) -> bytes:
    """The message of `values`: numbers as float32, whole numbers as int32, texts cut to 400 characters.

    >>> make_message("/haptorb/error", "no")
    b'/haptorb/error\\x00\\x00,s\\x00\\x00no\\x00\\x00'
    """
    builder = OscMessageBuilder(address)
    for value in values:
        builder.add_arg(value[:_LONGEST] if isinstance(value, str) else value)
    return bytes(builder.build().dgram)


def make_parameter_answer(parameter: Parameter, value: Any) -> bytes:
    """Name, value or values, low, high and unit of a parameter, in that order."""
    numbers = value if isinstance(value, tuple) else (value,)
    return make_message(
        "/haptorb/parameter",
        parameter.name, *map(float, numbers), float(parameter.low), float(parameter.high), parameter.unit,
    )  # fmt: skip
