"""What a world prints, on its way to the host's terminal: a tick never waits for its reader."""

from __future__ import annotations

import os
import sys
import threading
from contextlib import suppress
from io import TextIOBase
from typing import IO, final

__all__ = ["OutputReader", "WorldOutput", "show"]


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


# --------------------------------------------------------------------------------------------------
# Output of the servo's process, copied to this program's messages, including `print` in a world.


_READ_BYTES = 65536  #: bytes read at once
_DRAIN_TIMEOUT_S = 0.5  #: for what is still in the pipe when the process has ended [s]


@final
class OutputReader:
    """Copies `pipe` to standard error until its writers have ended; standard output is reserved for results."""

    def __init__(self, pipe: IO[bytes] | None) -> None:
        self._pipe = pipe
        self._thread = threading.Thread(target=self._copy, name="haptorb-output", daemon=True)
        if pipe is not None:
            self._thread.start()

    def end(self) -> None:
        """The process has ended: show the remaining output."""
        if self._pipe is None:
            return
        self._thread.join(_DRAIN_TIMEOUT_S)  # a process that a world has started may hold the pipe open
        if not self._thread.is_alive():
            self._pipe.close()

    def _copy(self) -> None:
        assert self._pipe is not None
        while content := os.read(self._pipe.fileno(), _READ_BYTES):
            show(content.decode(errors="replace"))


def show(text: str) -> None:
    """Write `text` to standard error; nowhere if the program has none, or if it was closed or its terminal has
    disappeared."""
    if sys.stderr is not None:
        with suppress(OSError, ValueError):  # ValueError: a file object that was closed
            sys.stderr.write(text)
            sys.stderr.flush()
