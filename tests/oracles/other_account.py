"""A child process under another account of this computer."""

from __future__ import annotations

import encodings.idna  # noqa: F401  # another account may not be able to read Python's own files any more
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

__all__ = ["NOBODY", "as_nobody", "needs_root"]

NOBODY = 65534

needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can start a process of another account")


@contextmanager
def as_nobody(deed: Callable[[], Any]) -> Iterator[int]:
    """`deed()` runs in a process of the account `nobody`, which is ended with the block."""
    number = os.fork()
    if number == 0:
        try:
            os.setgroups([])
            os.setresgid(NOBODY, NOBODY, NOBODY)
            os.setresuid(NOBODY, NOBODY, NOBODY)
            deed()
        finally:
            os._exit(0)
    try:
        yield number
    finally:
        os.kill(number, signal.SIGKILL)
        os.waitpid(number, 0)
