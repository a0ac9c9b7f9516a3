"""What a program asks by an OSC message: understood, or refused with a reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, TypeAlias, final

from haptorb.apps.serve.osc.addresses import INCOMING
from haptorb.errors import InputError, UnknownName, quote

__all__ = [
    "RATE",
    "AskParameters",
    "ChangeWorld",
    "CommandForce",
    "Request",
    "SetParameter",
    "Subscribe",
    "Unsubscribe",
    "parse_request",
]

RATE = 100.0  #: bundles a second, unless a program asks for others [Hz]
_FASTEST = 4000.0  #: [Hz]
_NAME = 64  #: of a world or parameter [characters]
_PARAMETER = "/haptorb/parameter/"


@final
@dataclass(frozen=True)
class Subscribe:
    """Bundles, `rate` a second [Hz], to `port` of the sender's computer; 0: the port that it sends from."""

    port: int
    rate: float


@final
@dataclass(frozen=True)
class Unsubscribe:
    """No more bundles to `port`; 0: the port that the sender sends from."""

    port: int


@final
@dataclass(frozen=True)
class AskParameters:
    """The name of the world and its parameters."""


@final
@dataclass(frozen=True)
class SetParameter:
    """Another value of a parameter of the present world, in its own unit: one number, or several."""

    name: str
    value: float | tuple[float, ...]


@final
@dataclass(frozen=True)
class ChangeWorld:
    """Another world, with its default parameters."""

    name: str


@final
@dataclass(frozen=True)
class CommandForce:
    """The force (3,) of the world `remote` [N], stator frame."""

    force: tuple[float, ...]


Request: TypeAlias = Subscribe | Unsubscribe | AskParameters | SetParameter | ChangeWorld | CommandForce


def parse_request(address: str, values: Sequence[Any]) -> Request:
    """What a message asks. Raises InputError if its address or values are none of `addresses.INCOMING`.

    >>> parse_request("/haptorb/force", [0.5, 0, 1])
    CommandForce(force=(0.5, 0.0, 1.0))
    """
    if address.startswith(_PARAMETER):
        return _read_parameter(address, values)
    match address:
        case "/haptorb/force":
            return CommandForce(_read_numbers(address, values, 3))
        case "/haptorb/subscribe":
            return _read_subscription(values)
        case "/haptorb/unsubscribe":
            return Unsubscribe(_read_port(address, values[0] if values else 0))
        case "/haptorb/parameters":
            return AskParameters()
        case "/haptorb/world":
            return ChangeWorld(_read_name(address, values))
    raise UnknownName("OSC address", address[:80], [one.address for one in INCOMING])


def _read_subscription(values: Sequence[Any]) -> Subscribe:
    address = "/haptorb/subscribe"
    if len(values) > 2:
        raise InputError(f"{address} has at most two values, port and rate; got {len(values)}")
    port = _read_port(address, values[0] if values else 0)
    (rate,) = _read_numbers(address, values[1:] or [RATE], 1)
    if not 0 < rate <= _FASTEST:
        raise InputError(f"{address}: the rate must be above 0 and at most {_FASTEST:g} Hz; got {rate:g}")
    return Subscribe(port, rate)


def _read_port(address: str, value: Any) -> int:
    (number,) = _read_numbers(address, [value], 1)
    if not number.is_integer() or not 0 <= number <= 65535:
        raise InputError(f"{address}: a port is a whole number from 1 to 65535, or 0; got {number:g}")
    return int(number)


def _read_parameter(address: str, values: Sequence[Any]) -> SetParameter:
    name = address.removeprefix(_PARAMETER)
    if not name.isidentifier() or len(name) > _NAME:
        raise InputError(f"{address[:80]} names no parameter; send {_PARAMETER}NAME with a value")
    numbers = _read_numbers(address, values, None)
    return SetParameter(name, numbers[0] if len(numbers) == 1 else numbers)


def _read_name(address: str, values: Sequence[Any]) -> str:
    if len(values) != 1 or not isinstance(values[0], str) or not 0 < len(values[0]) <= _NAME:
        raise InputError(f"{address} has one value, a name of at most {_NAME} characters; got {quote(list(values))}")
    return values[0]


def _read_numbers(address: str, values: Sequence[Any], count: int | None) -> tuple[float, ...]:
    """`values` as finite numbers, `count` of them, or one to three."""
    wanted = "one to three" if count is None else str(count)
    many = len(values)
    if not (1 <= many <= 3 if count is None else many == count):
        raise InputError(f"{address} has {wanted} numbers; got {many} values")
    for value in values:
        if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):  # safety: osc-finite
            raise InputError(f"{address} has {wanted} finite numbers; got {quote(value)}")
    return tuple(float(value) for value in values)
