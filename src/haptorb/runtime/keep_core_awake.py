"""A core that does not fall asleep between ticks: a small process that waits on it, behind everybody else.

A core with nothing to do is halted. When it wakes for the next tick its clock is slow, its caches have been emptied,
and in a virtual machine other work ran there meanwhile: the same tick takes about twice as long as on a
core that stayed awake. Real-time people boot with `idle=poll` against this; here a process of its own spins on the
servo's core under the kernel's idle policy, which gives way to everything else that runs there, the servo first.

The kernel fetches work to a core at the moment at which it falls idle; one that never does gets its share late. So the
process steps aside while the other cores are busy: the programs there need this one too.
"""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time

__all__ = ["CoreWaker", "busy_share"]

_CHECK_INTERVAL_S = 0.1  #: between two looks at the other cores [s]
_ASIDE = 0.5  #: for so long it steps aside before it looks again [s]
_MUCH = 0.5  #: share of the other cores' time from which on they have much to do
_PR_SET_PDEATHSIG = 1

Times = tuple[int, int]  #: the kernel's ticks in which the other cores were busy, and all


class CoreWaker:
    """Keeps `core`, to which this process is bound, awake until `end`; −1: it is bound to none, and none is kept.

    `awake` says whether that could be had.
    """

    def __init__(self, core: int) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        if os.sched_getaffinity(0) != {core} or not hasattr(os, "SCHED_IDLE"):
            return
        # Without the package and its libraries: it is up within milliseconds and needs a few megabytes.
        program = [sys.executable, "-I", "-S", __file__, str(os.getpid()), str(core)]
        try:
            self._process = subprocess.Popen(program, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        except OSError:
            return

    @property
    def awake(self) -> bool:
        """Whether another process waits for the core."""
        return self._process is not None and self._process.poll() is None

    def end(self) -> None:
        """The core may sleep. May be called twice."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()


def busy_share(before: Times, after: Times) -> float:
    """Share of the time between two looks in which the other cores had something to do; 0 for no time at all.

    >>> busy_share((100, 1000), (130, 1040))
    0.75
    """
    passed = after[1] - before[1]
    return (after[0] - before[0]) / passed if passed > 0 else 0.0


def _read_other_cores(core: int) -> Times:
    """What the kernel has counted for all cores but `core`."""
    worked, passed = 0, 0
    with open("/proc/stat") as stat:
        for line in stat:
            name, *counts = line.split()
            if not name.startswith("cpu"):
                break
            if name in ("cpu", f"cpu{core}"):
                continue
            ticks = [int(count) for count in counts[:8]]  # user, nice, system, idle, iowait, irq, softirq, steal
            worked += sum(ticks) - ticks[3] - ticks[4]
            passed += sum(ticks)
    return worked, passed


def _wait(parent: int, core: int) -> None:
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the servo's, which ends this
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    before = _read_other_cores(core)
    while os.getppid() == parent:
        until = time.monotonic() + _CHECK_INTERVAL_S
        while time.monotonic() < until:
            pass
        after = _read_other_cores(core)
        if busy_share(before, after) > _MUCH:
            time.sleep(_ASIDE)
            after = _read_other_cores(core)
        before = after


if __name__ == "__main__":
    _wait(int(sys.argv[1]), int(sys.argv[2]))
