"""What a client's message commands of the device, in all spellings that clients use; what is misspelt is nothing."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import Any

from haptorb.apps.serve.haply.cursor import Cursor
from haptorb.apps.serve.haply.space import Space
from haptorb.apps.serve.haply.transform import Vector
from haptorb.numerics.record import record

__all__ = ["DeviceCommand", "read_device_force", "read_list"]

_MOST = 16  #: entries of one message that are read
_STIFFNESS = 40.0  #: of the spring that draws the tool to a commanded place [N/m]
_PULL = 1.0  #: and its greatest force [N]


@record
class DeviceCommand:
    """force      (3,) in the client's axes [N]; None: none is commanded
    transform  of the workspace, as the client wrote it; None: it stays
    """

    force: Vector | None
    transform: object


def read_list(found: object) -> list[Mapping[str, Any]]:
    """The entries of a message's array that are objects; a single object is an array of one."""
    if isinstance(found, Mapping):
        found = [found]
    return [one for one in found[:_MOST] if isinstance(one, Mapping)] if isinstance(found, list) else []


def read_device_force(entry: Mapping[str, Any], space: Space, cursor: Cursor) -> DeviceCommand:
    """What one `entry` of `inverse3` commands; forces of one message add.

    A commanded place draws the tool there with a weak spring: this device is driven by forces.
    """
    total, transform = None, None
    for name in ("commands", "command"):
        for commands in read_list(entry.get(name)):
            force = _read_vector(commands.get("set_cursor_force"), ("vector", "values"))
            place = _read_vector(commands.get("set_cursor_position"), ("position", "values", "vector"))
            if place is not None:
                force = _add(force, _pull(place, space.place(cursor.place)))
            if force is not None:
                total = _add(total, force)
            moved = commands.get("set_transform")
            transform = moved if isinstance(moved, Mapping) else transform
    return DeviceCommand(total, transform)


def _read_vector(found: object, names: tuple[str, ...]) -> Vector | None:
    if not isinstance(found, Mapping):
        return None
    for name in names:
        if isinstance(inner := found.get(name), Mapping | list):
            found = inner
            break
    if isinstance(found, list):
        found = dict(zip("xyz", found, strict=False))
    if not any(name in found for name in "xyz"):
        return None
    numbers = []
    for name in "xyz":
        number = found.get(name, 0.0)
        if isinstance(number, bool) or not isinstance(number, int | float):
            return None
        try:
            number = float(number)
        except OverflowError:
            return None
        if not isfinite(number):
            return None
        numbers.append(number)
    return (numbers[0], numbers[1], numbers[2])


def _add(a: Vector | None, b: Vector) -> Vector:
    return b if a is None else (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _pull(place: Vector, now: Vector) -> Vector:
    ways = [goal - here for goal, here in zip(place, now, strict=True)]
    size = sum(way * way for way in ways) ** 0.5
    share = min(_STIFFNESS, _PULL / size) if size > 0.0 else 0.0
    return (share * ways[0], share * ways[1], share * ways[2])
