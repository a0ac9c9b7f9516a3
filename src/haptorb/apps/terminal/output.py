"""Standard output and error where there is none, or where it takes no more."""

from __future__ import annotations

import os
import sys
from contextlib import suppress

__all__ = ["drop_output", "open_output"]


def open_output() -> None:
    """Let what is printed go nowhere where the program was started without standard output or error (`>&-`)."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 (until the program ends)


def drop_output() -> None:
    """Standard output is closed: discard what waits for it, or Python would try again, and report it, at exit."""
    with suppress(OSError, ValueError):  # a stream without a file
        output, nowhere = sys.stdout.fileno(), os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, output)
        os.close(nowhere)
