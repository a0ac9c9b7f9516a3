"""A process with coils in its hand must not outlive the one that started it."""

from __future__ import annotations

import ctypes
import os
import signal
from contextlib import suppress
from functools import cache
from pathlib import Path

__all__ = ["die_with_parent", "end_group", "is_parent_gone"]

_PR_SET_PDEATHSIG = 1


@cache
def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def die_with_parent(number: signal.Signals | None = None) -> None:
    """Ask the kernel for the signal `number` when the parent ends; None: for SIGKILL.

    The kernel sends it when the *thread* ends that started this process. Processes are therefore started by a thread
    that lives as long as its program (`starter`); with another signal, ask `is_parent_gone` as well.
    """
    _libc().prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL if number is None else number), 0, 0, 0)


def is_parent_gone(parent: int) -> bool:
    """Whether the process `parent` is no longer this one's parent: it ended, however it ended."""
    return os.getppid() != parent


def end_group(leader: int) -> None:
    """Kill all processes of the group that `leader` began, but not the one that calls this."""
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError, ValueError):
            group = int((folder / "stat").read_text().rpartition(")")[2].split()[2])
            if group == leader and (number := int(folder.name)) != os.getpid():
                os.kill(number, signal.SIGKILL)
