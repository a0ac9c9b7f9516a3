"""Standard output of a world, passed to the host's terminal without blocking a tick."""

from __future__ import annotations

import os
import sys
import threading
from contextlib import suppress
from io import TextIOBase
from typing import IO, final

from haptorb.files import visible

__all__ = ["OutputReader", "WorldOutput", "show"]


@final
class WorldOutput(TextIOBase):
    """Non-blocking writer to the pipe `descriptor`: drops what does not fit."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        if hasattr(os, "set_blocking"):  # on Windows, a tick that prints more than the pipe holds waits for its reader
            os.set_blocking(descriptor, False)

    def fileno(self) -> int:
        """Descriptor of the pipe."""
        return self._descriptor

    def write(self, text: str) -> int:
        """Write without blocking, or not at all."""
        with suppress(OSError):  # pipe full or closed
            os.write(self._descriptor, text.encode(errors="replace"))
        return len(text)


# --------------------------------------------------------------------------------------------------
# Output of the servo's process, copied to this program's messages, including `print` in a world.


_READ_BYTES = 65536  #: read at once
_DRAIN_TIMEOUT_S = 0.5  #: for the remaining output when the process has ended


@final
class OutputReader:
    """Copies `pipe` to standard error until its writers have ended; standard output is reserved for results."""

    def __init__(self, pipe: IO[bytes] | None) -> None:
        self._pipe = pipe
        self._thread = threading.Thread(target=self._copy, name="haptorb-output", daemon=True)
        if pipe is not None:
            self._thread.start()

    def end(self) -> None:
        """Show the remaining output after the end of the process."""
        if self._pipe is None:
            return
        self._thread.join(_DRAIN_TIMEOUT_S)  # a process that a world has started may still have the pipe open
        if not self._thread.is_alive():
            self._pipe.close()

    def _copy(self) -> None:
        assert self._pipe is not None
        while content := os.read(self._pipe.fileno(), _READ_BYTES):
            show(content.decode(errors="replace"))


def show(text: str) -> None:
    """Write `text` to standard error, control characters visible: parts of it may come from a file, such as the name of
    a body in MuJoCo's message. Discard it if there is none, if it was closed, or if its terminal has disappeared."""
    if sys.stderr is not None:
        with suppress(OSError, ValueError):  # ValueError: a file object that was closed
            sys.stderr.write(visible(text.replace("\r\n", "\n")))
            sys.stderr.flush()
