"""What the console needs of a session in which designs are felt and rated, and nothing else of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

__all__ = ["DesignSession"]


class DesignSession(Protocol):
    """A session that chooses the worlds: pages show it and send its commands. Methods may be called in any thread."""

    @property
    def version(self) -> int:
        """Another number after every change."""
        ...

    @property
    def hidden(self) -> bool:
        """Whether name, values and picture of the design are hidden from every page."""
        ...

    def describe(self) -> Mapping[str, Any]:
        """What a page shows of it, as plain JSON types."""
        ...

    def execute(self, command: Mapping[str, Any]) -> None:
        """What a page asks for; HaptorbError if it cannot be."""
        ...
