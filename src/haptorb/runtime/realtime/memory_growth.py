"""How much memory a servo's process holds, seen from its host: its garbage collector is off."""

from __future__ import annotations

import os
from pathlib import Path
from typing import final

__all__ = ["MemoryGrowth", "resident_memory"]

_MUCH = 100e6  #: from so much on the user is warned [bytes]
_EVERY = 1.0  #: between two looks [s]


def resident_memory(pid: int) -> int | None:
    """Memory in which the process `pid` has something [bytes]; None if it has ended."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError, ValueError):
        return None


@final
class MemoryGrowth:
    """Looks at the process `pid` once a second from the first `look` on."""

    def __init__(self, pid: int) -> None:
        self.start: int | None = None  #: at the first look [bytes]
        self.now: int | None = None  #: at the last one [bytes]
        self._pid = pid
        self._next = 0.0

    def look(self, now: float) -> None:
        """Look, if a second has passed since the last time; `now` [s]."""
        if now >= self._next and (found := resident_memory(self._pid)) is not None:
            self._next, self.now = now + _EVERY, found
            if self.start is None:
                self.start = found

    @property
    def warning(self) -> str:
        """What a person should know; empty while little has been added."""
        if self.start is None or self.now is None or self.now - self.start < _MUCH:
            return ""
        return (
            f"the servo's process has grown by {(self.now - self.start) / 1e6:.0f} MB since its start. It never "
            "collects garbage, because that would delay the loop: the world must not create objects that refer to "
            "each other in a cycle, or keep objects from a tick"
        )

    def facts(self) -> dict[str, float]:
        """MB at the start of the loop and at the last look, as plain JSON types; empty before the first."""
        if self.start is None or self.now is None:
            return {}
        return {"start": round(self.start / 1e6, 1), "now": round(self.now / 1e6, 1)}
