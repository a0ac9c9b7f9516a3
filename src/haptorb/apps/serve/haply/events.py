"""Events of that service: what happened to the device and its clients, for listeners on the second port."""

from __future__ import annotations

import json
from typing import Any, final

from haptorb.apps.serve.haply.cursor import Cursor
from haptorb.apps.serve.haply.inventory import DeviceIds
from haptorb.apps.serve.served_device import ServedDevice
from haptorb.control.protection.trip import Trip

__all__ = ["DeviceWatcher", "write_event"]


def write_event(name: str, category: str, level: str, data: dict[str, Any], message: str = "") -> str:
    """One event as that service writes it."""
    return json.dumps({"name": name, "category": category, "level": level, "data": data, "message": message})


@final
class DeviceWatcher:
    """Turns what the rows say into events: connection, trips, and the way back."""

    def __init__(self, served: ServedDevice, identity: DeviceIds) -> None:
        self._served, self._identity, self._cursor = served, identity, Cursor(served)
        self._tripped = False

    def look(self) -> list[tuple[str, str, str, dict[str, Any], str]]:
        """What has happened since the last look: name, category, level, data, message."""
        cursor, found = self._cursor, list[tuple[str, str, str, dict[str, Any], str]]()
        cursor.look()
        ids = {"device_id": self._identity.device}
        if cursor.tripped and not self._tripped:
            reason = Trip(cursor.trip)
            data = {**ids, "safety_type": "ebrake_triggered", "reason": reason.name.lower()}
            found.append(("device-safety-triggered", "safety", "error", data, reason.text))
        elif self._tripped and cursor.ready:
            data = {**ids, "safety_type": "ebrake_released"}
            found.append(("device-safety-triggered", "safety", "info", data, "a person has switched the coils on"))
            self._tripped = False
        self._tripped = self._tripped or cursor.tripped
        return found

    def introduce(self) -> str:
        """For a listener that has just come: the device that is connected."""
        ids = {"device_id": self._identity.device}
        return write_event("device-connected", "device", "info", ids, f"{self._served.device.title} is connected")

    def end(self) -> tuple[str, str, str, dict[str, Any], str]:
        """The servo has ended."""
        ids = {"device_id": self._identity.device}
        return ("device-disconnected", "device", "warning", ids, "the servo has ended")
