"""Whom a request over HTTP means: the device in its path, and the sessions of its ?session=."""

from __future__ import annotations

import re
from collections.abc import Sequence
from fnmatch import fnmatchcase

from haptorb.apps.serve.haply.inventory import DeviceIds
from haptorb.apps.serve.haply.session import Session
from haptorb.errors import InputError

__all__ = ["GRIP", "TOOL", "AmbiguousDevice", "find_kind", "find_session"]

TOOL, GRIP = "inverse3", "wireless_verse_grip"
_FAMILIES = {TOOL: TOOL, "*inverse": TOOL, GRIP: GRIP, "*verse_grip": GRIP}
_LONGEST = 100  #: of a selector [characters]
_NUMBER = re.compile(r"#?(\d{1,9})")
_INDEX = re.compile(r"(.*?):(-?\d{1,4})")
_NAMELESS = "default"  #: profile of a session that has not said its name


class AmbiguousDevice(InputError):
    """A request that needs one device names several."""


def find_kind(identity: DeviceIds, kind: str, which: str, *, one: bool) -> str:
    """The device's type that `kind`/`which` of a path means: a type or a family, and an id, an index or *.

    Raises InputError if there is no such device, AmbiguousDevice for * where `one` is needed.
    """
    found = _FAMILIES.get(kind, "")
    ids = {TOOL: identity.device, GRIP: identity.grip}
    if not found or which.upper() not in ("0", "-1", "*", ids[found]):
        raise InputError(
            f"no device {kind[:_LONGEST]}/{which[:_LONGEST]}; there is {TOOL}/{ids[TOOL]} and {GRIP}/{ids[GRIP]}"
        )
    if one and which == "*":
        raise AmbiguousDevice(f"* may mean several devices; name one: {kind}/0 or {kind}/{ids[found]}")
    return found


def find_session(sessions: Sequence[Session], text: str) -> Session:
    """The session that `text` selects: its number (7 or #7), its place (:0, :-1), or its profile, in which * and ?
    stand for any letters, and of several with that profile the one at a place (name:1).

    Raises InputError if there is none.
    """
    if (number := _NUMBER.fullmatch(text)) is not None:
        found = [one for one in sessions if one.number == int(number[1])]
        return _choose(found, 0, text, sessions)
    parts = _INDEX.fullmatch(text)
    pattern, place = (parts[1], int(parts[2])) if parts else (text, 0)
    pattern = pattern.removeprefix(":")[:_LONGEST].replace("[", "[[]")  # a bracket is a letter there
    found = [one for one in sessions if not pattern or fnmatchcase(one.name or _NAMELESS, pattern)]
    return _choose(found, place, text, sessions)


def _choose(found: Sequence[Session], place: int, text: str, sessions: Sequence[Session]) -> Session:
    if not -len(found) <= place < len(found):
        raise InputError(f"no session {text[:_LONGEST]}; there are {len(sessions)}: /sessions lists them")
    return found[place]
