"""Keeps the servo's CPU core out of idle states (C-states) between ticks: a process that spins at idle priority.

An idle core is halted. When it wakes for the next tick its clock is slow, its caches have been flushed,
and in a virtual machine other work ran there meanwhile: the same tick takes about twice as long as on a
core that stayed awake. Real-time systems are booted with `idle=poll` against this; here a separate process spins on
the servo's core under the kernel's idle policy (SCHED_IDLE), so that everything else on that core preempts it.

The kernel migrates work to a core when it becomes idle; a core that never does gets its share late. So the process
yields while the other cores are loaded: the programs there need this core too.
"""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time

__all__ = ["CoreWaker", "busy_share", "spin"]

_CHECK_INTERVAL_S = 0.1  #: between two checks of the load of the other cores
_YIELD_TIME_S = 0.5  #: sleep while the other cores are loaded
_MAX_LOAD = 0.5  #: load of the other cores above which this process yields
_PR_SET_PDEATHSIG = 1  #: as in `linux.py`, which this program does not import: it must start within milliseconds

Times = tuple[int, int]  #: busy time and total time of the other cores [kernel ticks]


class CoreWaker:
    """Keeps `core`, to which this process is bound, awake until `end`; −1: it is bound to none, and nothing is done.

    `awake` states whether that succeeded.
    """

    def __init__(self, core: int) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        if not hasattr(os, "SCHED_IDLE") or os.sched_getaffinity(0) != {core}:
            return
        # Imports neither the package nor its libraries: it starts within milliseconds and needs a few megabytes.
        program = [sys.executable, "-I", "-S", __file__, str(os.getpid()), str(core)]
        try:
            self._process = subprocess.Popen(program, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        except OSError:
            return

    @property
    def awake(self) -> bool:
        """Whether the process that keeps the core awake runs."""
        return self._process is not None and self._process.poll() is None

    def end(self) -> None:
        """End the process. May be called twice."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()


def busy_share(before: Times, after: Times) -> float:
    """Load of the other cores between two readings, 0 to 1; 0 if no time has passed.

    >>> busy_share((100, 1000), (130, 1040))
    0.75
    """
    passed = after[1] - before[1]
    return (after[0] - before[0]) / passed if passed > 0 else 0.0


def _read_other_cores(core: int) -> Times:
    """Read the kernel's counters of all cores but `core`."""
    worked, passed = 0, 0
    with open("/proc/stat", encoding="ascii") as stat:
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
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the servo, which ends this process
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    spin(parent, core)


def spin(parent: int, core: int) -> None:
    """Use all of `core` as long as `parent` lives and the other cores are not loaded."""
    before = _read_other_cores(core)
    while os.getppid() == parent:
        until = time.monotonic() + _CHECK_INTERVAL_S
        while time.monotonic() < until:
            pass
        after = _read_other_cores(core)
        while busy_share(before, after) > _MAX_LOAD and os.getppid() == parent:
            time.sleep(_YIELD_TIME_S)  # without spinning in between: another session's programs would lose that time
            before, after = after, _read_other_cores(core)
        before = after


if __name__ == "__main__":
    _wait(int(sys.argv[1]), int(sys.argv[2]))
