"""A process with coils in its hand must not outlive the one that started it."""

from __future__ import annotations

import ctypes
import os
import signal

__all__ = ["SILENCE", "die_with_parent", "orphaned"]

SILENCE = 0.5  #: a host that shows no heartbeat for so long is taken for dead [s]

_PR_SET_PDEATHSIG = 1

_libc = ctypes.CDLL(None, use_errno=True)


def die_with_parent() -> None:
    """Ask the kernel for SIGUSR1 when the parent ends.

    Not SIGTERM: the kernel also sends it when only the *thread* that started this process ends, and then
    `orphaned` says no and life goes on.
    """
    _libc.prctl(_PR_SET_PDEATHSIG, int(signal.SIGUSR1), 0, 0, 0)


def orphaned(parent: int) -> bool:
    """Whether the process `parent` is no longer this one's parent: it ended, however it ended."""
    return os.getppid() != parent
