"""What a process may ask of the kernel to be punctual; what is not permitted is skipped and reported.

What only Linux has is loaded when it is asked for: programs without a loop import this module on other systems, too.
"""

from __future__ import annotations

import ctypes
import os
from contextlib import suppress
from functools import cache

from haptorb.runtime.realtime.core_claim import claim

__all__ = ["Facts", "lower_priority", "raise_priority", "request_real_time"]

Facts = dict[str, str | bool | int]

_PR_SET_TIMERSLACK = 29
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_PRIORITY = 40  #: below the kernel's own interrupt threads (50)
_RUNAWAY = 3_000_000  #: of a processor under the real-time scheduler without one wait [µs]


@cache
def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def request_real_time(*, real_time: bool = True) -> Facts:
    """Ask for exact timers, a real-time scheduler and memory that stays; returns what was granted.

    Without a real-time scheduler the process is not bound to a core either: the kernel could then not move it away
    from a busy one. Nor is it where other servos hold all cores: two real-time loops on one core wait for each other.
    """
    # The default lets timers come up to 50 µs late so that wake-ups can be joined.
    slack = _libc().prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0) == 0
    fifo = real_time and _fifo(_PRIORITY)
    if fifo:
        # Who computes for so long without ever waiting does not come back: the kernel kills it.
        import resource

        resource.setrlimit(resource.RLIMIT_RTTIME, (_RUNAWAY, _RUNAWAY))
    return {
        "policy": "SCHED_FIFO" if fifo else "SCHED_OTHER",
        "priority": _PRIORITY if fifo else 0,
        "memory_locked": _lock_memory(),
        "exact_timers": slack,
        "core": _bind() if fifo else -1,
        "cores": len(os.sched_getaffinity(0)) if not fifo else os.cpu_count() or 1,
    }


def raise_priority(number: int = 0) -> bool:
    """Ask for this thread, or the process `number`, to come before ordinary ones, behind every loop; False if refused.

    For what sleeps nearly always.
    """
    return _fifo(1, number)


def lower_priority() -> None:
    """This process takes its turn like any other again."""
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def _fifo(priority: int, number: int = 0) -> bool:
    try:
        os.sched_setscheduler(number, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except OSError:
        return False
    return True


def _lock_memory() -> bool:
    # With a finite limit the lock on future pages would make later allocations fail: worse than a page fault.
    import resource

    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if soft != resource.RLIM_INFINITY and os.geteuid() != 0:
        return False
    # On fault: pages that are used stay; the compiler's unused ones need not come in.
    return bool(_libc().mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) == 0)


def _bind() -> int:
    """Stay on the last core that is allowed and free of other servos, but not on the first, which interrupts like.

    −1 if there is none: the kernel then chooses.
    """
    core = claim(sorted(os.sched_getaffinity(0))[:0:-1])
    if core < 0:
        return -1
    try:
        os.sched_setaffinity(0, {core})
    except OSError:
        return -1
    return core
