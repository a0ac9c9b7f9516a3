"""What a world prints, on its way to the host's terminal: a tick never waits for its reader."""

from __future__ import annotations

import os
from contextlib import suppress
from io import TextIOBase
from typing import final

__all__ = ["WorldOutput"]


@final
class WorldOutput(TextIOBase):
    """Writes to the pipe `descriptor` what fits into it at once, and drops the rest: the host reads, or does not."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        os.set_blocking(descriptor, False)

    def fileno(self) -> int:
        """Of the pipe."""
        return self._descriptor

    def write(self, text: str) -> int:
        """Write at once, or not at all."""
        with suppress(OSError):  # full, or without a reader
            os.write(self._descriptor, text.encode(errors="replace"))
        return len(text)
