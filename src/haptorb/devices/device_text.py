"""The file that a device was built from, with those that it is based on: whatever carries them can build it again."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field

__all__ = ["DeviceText"]

_MOST = 1_000_000  #: letters of the files that a device is based on


@dataclass(frozen=True)
class DeviceText:
    """own    the file itself
    bases  what its `based_on` says, and those of its bases → the file that this names
    """

    own: str
    bases: Mapping[str, str] = field(default_factory=dict)

    def as_note(self) -> dict[str, str]:
        """As a recording notes it."""
        return {"file": self.own} | ({"bases": json.dumps(dict(self.bases), ensure_ascii=False)} if self.bases else {})

    @classmethod
    def from_note(cls, note: Mapping[str, str]) -> DeviceText | None:
        """What a recording notes; None if it does not carry the file. Bases that are none are left out.

        >>> text = DeviceText("based_on = 'mine'", {"mine": "..."})
        >>> DeviceText.from_note(text.as_note()) == text
        True
        """
        if not note.get("file"):
            return None
        written = note.get("bases", "")
        try:
            found = json.loads(written) if len(written) <= _MOST else {}
        except (ValueError, RecursionError):
            found = {}
        bases = found.items() if isinstance(found, dict) else ()
        return cls(note["file"], {key: text for key, text in bases if isinstance(text, str)})
