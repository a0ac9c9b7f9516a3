"""The protocol itself: one inventory for a new client, and one state message in reply to every message."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from time import monotonic
from typing import Any, final

from haptorb.apps.serve.haply.commands import read_device_force, read_list
from haptorb.apps.serve.haply.cursor import Cursor
from haptorb.apps.serve.haply.inventory import DeviceIds, Settings
from haptorb.apps.serve.haply.session import Session
from haptorb.apps.serve.haply.space import MAPPING, Space, default_space
from haptorb.apps.serve.haply.transform import parse_basis, parse_transform
from haptorb.apps.serve.served_device import LATE, ServedDevice
from haptorb.errors import HaptorbError, InputError

__all__ = ["Service"]


@final
class Service:
    """All clients of one server, before the device `served`; `tell` sends an event: name, category, level, data,
    message."""

    def __init__(self, served: ServedDevice, tell: Callable[..., None]) -> None:
        self.served, self.tell = served, tell
        self.sessions: dict[int, Session] = {}
        self.identity = DeviceIds.of(served.device)
        self.settings = Settings()
        self.space: Space = default_space(served.device)  #: of clients that say nothing else
        self.cursor = Cursor(served)
        self._tick, self._texts = -1, dict[tuple[int | bool, ...], tuple[Space, str]]()

    def open(self, peer: str) -> Session:
        """A client has connected from the address `peer`."""
        session = Session(self.served.open_session(), peer, self.space)
        self.sessions[session.number] = session
        self.tell("session-connected", "session", "info", {"session_id": session.number})
        return session

    def close(self, session: Session) -> None:
        """Its connection is lost, however it ended: so is its force."""
        if self.sessions.pop(session.number, None) is not None:
            self.served.lose(session.number)
            self.tell("session-disconnected", "session", "info", {"session_id": session.number})

    def inventory(self, session: Session) -> str:
        """The inventory: what a client that has just connected is sent, unasked."""
        return self._write(session, config=True, inventory=True)

    def answer(self, session: Session, text: str | bytes, arrival: float) -> str:
        """The one reply to a client's message, which came at `arrival` on the monotonic clock [s]: the state, whatever
        the message. What has waited for long is answered and not done."""
        session.messages += 1
        self.cursor.look()
        try:
            message = json.loads(text)
        except (ValueError, RecursionError):
            message, session.unreadable = None, session.unreadable + bool(text.strip())
        late = monotonic() - arrival > LATE  # safety: late-messages
        full = self._obey(session, message, arrival) if isinstance(message, dict) and not late else False
        return self._write(session, config=full)

    def _obey(self, session: Session, message: dict[str, Any], arrival: float) -> bool:
        """Do what `message` says, as far as it can be understood; whether the answer has the config again."""
        full = False
        wanted = message.get("session")
        if isinstance(wanted, Mapping):
            full = "force_render_full_state" in wanted
            self._set_session(session, wanted.get("configure"))
        force: list[float] | None = None
        for entry in read_list(message.get("inverse3")):
            if not self.identity.is_meant(entry.get("device_id")):
                continue
            if isinstance(given := entry.get("configure"), Mapping):
                self._try(partial(self.configure, session, given, by=session))
            found = read_device_force(entry, session.space, self.cursor)
            if found.transform is not None:
                self._try(partial(self._move, session, found.transform))
            if found.force is not None:
                force = [a + b for a, b in zip(force or (0.0, 0.0, 0.0), found.force, strict=True)]
        if force is not None:
            self._command(session, force, arrival)
        return full

    def _command(self, session: Session, force: list[float], arrival: float) -> None:
        stator = session.space.stator_force(force)
        refusals = self.served.busy
        if self.served.command(session.number, stator, arrival=arrival, mapping=session.mapping):
            session.refused = False
        elif self.served.busy > refusals and not session.refused:
            session.refused = True  # said once, not with each of a thousand commands a second
            self.tell(
                "device-busy", "device", "warning",
                {
                    "device_family": "inverse", "device_id": self.identity.device,
                    "session_id": session.number, "holder": self.served.holder,
                },
                "another session commands this device; this one may watch",
            )  # fmt: skip

    def _set_session(self, session: Session, given: object) -> None:
        if not isinstance(given, Mapping):
            return
        profile = given.get("profile")
        if isinstance(profile, Mapping):
            session.rename(profile.get("name"))
        for found in (given, profile):
            if isinstance(found, Mapping) and "basis" in found:
                basis = found["basis"]
                text = basis.get("permutation") if isinstance(basis, Mapping) else basis
                self._try(partial(self._rename_axes, session, text))

    def _rename_axes(self, session: Session, text: object) -> None:
        session.change_space(replace(session.space, basis=parse_basis(text)))

    def _move(self, session: Session, given: object) -> None:
        session.move_space(replace(session.space, transform=parse_transform(given, session.space.transform)))

    def configure(self, session: Session | None, found: Mapping[str, Any], *, by: Session | None = None) -> None:
        """What one client sets for itself, or, for None, somebody for all clients of now and later; `by` whom, None for
        a request over HTTP. Raises InputError for what cannot be; then nothing changes.

        How the client that holds the device sees it, only that client itself changes: its force would turn.
        """
        changed = list(self.sessions.values()) if session is None else [session]
        holder = self.served.holder
        concerned = holder and any(one.number == holder for one in changed) and (by is None or by.number != holder)
        if concerned and any(name in found for name in MAPPING):  # safety: holder-maps
            raise InputError(
                f"session {holder} commands the device, and only its own messages change how it sees it: wait until "
                "it has let the device go (2 s after its last command), or name another session"
            )
        spaces = [one.space.configure(found) for one in changed]
        later = self.space.configure(found) if session is None else self.space
        self.settings, self.space = self.settings.configure(found), later
        for one, space in zip(changed, spaces, strict=True):
            one.change_space(space)

    @staticmethod
    def _try(change: Callable[[], None]) -> None:
        """What cannot be set changes nothing; the answer is the state all the same."""
        try:
            change()
        except HaptorbError:
            return

    def _write(self, session: Session, *, config: bool, inventory: bool = False) -> str:
        cursor = self.cursor
        cursor.look()
        holder, buttons = self.served.holder, self.served.buttons
        if not config and not inventory:
            return self._write_state(session.space, holder, buttons)
        return json.dumps({"session_id": session.number, **self._describe_all(session.space, holder, buttons)})

    def list_devices(self, space: Space) -> dict[str, Any]:
        """Config, state and status of all devices, as who sees them through `space`."""
        self.cursor.look()
        return self._describe_all(space, self.served.holder, self.served.buttons)

    def _describe_all(self, space: Space, holder: int, buttons: dict[str, bool]) -> dict[str, Any]:
        state = self._describe(space, holder, buttons)
        state["inverse3"][0]["config"] = self.settings.as_json(self.identity, space)
        state["wireless_verse_grip"][0]["config"] = {"type": "wireless_verse_grip", "handedness": "right"}
        return state

    def _write_state(self, space: Space, holder: int, buttons: dict[str, bool]) -> str:
        """The state as clients receive it that see the device through `space`, written once per tick."""
        if self._tick != self.cursor.tick:
            self._tick, self._texts = self.cursor.tick, {}
        # With the space itself kept beside the text, no other one can have its id within the tick.
        key = (id(space), holder, *buttons.values())
        found = self._texts.get(key)
        if found is None:
            found = self._texts[key] = (space, json.dumps(self._describe(space, holder, buttons)))
        return found[1]

    def _describe(self, space: Space, holder: int, buttons: dict[str, bool]) -> dict[str, Any]:
        cursor = self.cursor
        place, force = _point(space.place(cursor.place)), _point(space.force(cursor.force))
        x, y, z, w = space.orientation(cursor.turn)
        turn = {"w": w, "x": x, "y": y, "z": z}
        mode = "force" if holder else "idle"
        still = {"a0": 0.0, "a1": 0.0, "a2": 0.0}  # this device has no joints
        return {
            "inverse3": [
                {
                    "device_id": self.identity.device,
                    "state": {
                        "cursor_position": place,
                        "cursor_velocity": _point(space.velocity(cursor.velocity)),
                        "current_cursor_force": force,
                        "current_cursor_position": place,
                        "angular_position": still,
                        "angular_velocity": still,
                        "current_angular_position": still,
                        "current_angular_torques": still,
                        "body_orientation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0},
                        "control_domain": "cartesian",
                        "control_mode": mode,
                        "mode": mode,
                        "transform": space.transform.as_json(),
                    },
                    "status": {
                        "calibrated": cursor.known,
                        "in_use": holder != 0,
                        "power_supply": not cursor.tripped,
                        "ready": cursor.ready and self.served.renders_force,
                        "started": True,
                    },
                }
            ],
            "verse_grip": [],
            "wireless_verse_grip": [
                {
                    "device_id": self.identity.grip,
                    "state": {"orientation": turn, "buttons": buttons, "battery_level": 1.0, "hall": 0},
                    "status": {"connected": True, "awake": True, "ready": cursor.known},
                }
            ],
            "custom_verse_grip": [],
        }


def _point(v: tuple[float, float, float]) -> dict[str, float]:
    return {"x": v[0], "y": v[1], "z": v[2]}
