"""Events of that service: what happened to the device and its clients, for listeners on the second port.

A trip is its emergency brake; damping that the passivity control adds is its ceiling of stability. Coils so warm that
less than the asked force is rendered have no word there: `thermal_derating` is this server's own.
"""

from __future__ import annotations

import json
from typing import Any, TypeAlias, final

from haptorb.apps.serve.haply.cursor import Cursor
from haptorb.apps.serve.haply.inventory import DeviceIds
from haptorb.apps.serve.served_device import ServedDevice
from haptorb.control.protection.trip import Trip

__all__ = ["DeviceWatcher", "Event", "write_event"]

Event: TypeAlias = tuple[str, str, str, dict[str, Any], str]  #: name, category, level, data, message


def write_event(name: str, category: str, level: str, data: dict[str, Any], message: str = "") -> str:
    """One event as that service writes it."""
    return json.dumps({"name": name, "category": category, "level": level, "data": data, "message": message})


_CALM = 1.0  #: what lasted, and was over for so long, is new when it comes again [s]


@final
class _Spell:
    """Something that comes and goes in the rows: `has_begun` is true once for each time that it comes."""

    def __init__(self) -> None:
        self._last = float("-inf")

    def has_begun(self, there: bool, t: float) -> bool:
        """Whether it has begun, given that it is `there` at the time `t` [s]."""
        first = there and not self._last <= t < self._last + _CALM
        self._last = t if there else self._last
        return first


@final
class DeviceWatcher:
    """Turns what the rows say into events: connection, trips, the way back, and what holds the force back."""

    def __init__(self, served: ServedDevice, identity: DeviceIds) -> None:
        self._served, self._identity, self._cursor = served, identity, Cursor(served)
        self._tripped = False
        self._warm, self._damped = _Spell(), _Spell()

    def look(self) -> list[Event]:
        """What has happened since the last look: name, category, level, data, message."""
        cursor, found = self._cursor, list[Event]()
        cursor.look()
        if cursor.tripped and not self._tripped:
            reason = Trip(cursor.trip)
            found.append(self._warn("ebrake_triggered", "error", reason.text, reason=reason.name.lower()))
        elif self._tripped and cursor.ready:
            found.append(self._warn("ebrake_released", "notice", "a person has switched the coils on"))
            self._tripped = False
        self._tripped = self._tripped or cursor.tripped
        if self._warm.has_begun(cursor.derated, cursor.t):
            found.append(self._warn("thermal_derating", "warning", "the coils are warm: less force is rendered"))
        if self._damped.has_begun(cursor.damped, cursor.t):
            found.append(self._warn("stability_ceiling", "warning", "damping is added: the force gave energy away"))
        return found

    def _warn(self, kind: str, level: str, message: str, **more: str) -> Event:
        return ("device-safety-triggered", "device", level, {**self._name(), "safety_type": kind, **more}, message)

    def _name(self) -> dict[str, Any]:
        return {"device_family": "inverse", "device_id": self._identity.device}

    def introduce(self) -> str:
        """For a listener that has just come: the device that is connected."""
        text = f"{self._served.device.title} is connected"
        return write_event("device-connected", "device", "info", self._name(), text)

    def end(self) -> Event:
        """The servo has ended."""
        return ("device-disconnected", "device", "warning", self._name(), "the servo has ended")
