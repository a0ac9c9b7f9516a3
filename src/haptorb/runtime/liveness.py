"""Liveness of processes: the host by its heartbeat and kernel state, the others by their progress.

A heartbeat is late for three reasons. A program that was stopped (SIGSTOP, a debugger) cannot react. One that
computes or sleeps with Python's interpreter lock is late by its own fault, and its heartbeat may return. One that is
starved of processor time on a busy computer still runs. The kernel distinguishes them.
"""

from __future__ import annotations

import mmap
import os
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from time import monotonic
from typing import final

from haptorb.runtime.linux import is_linux

__all__ = [
    "HEARTBEAT_TIMEOUT_S",
    "LATE_HEARTBEAT_S",
    "STARVED_TIMEOUT_S",
    "STOPPED_TIMEOUT_S",
    "HangWatch",
    "HostHeartbeat",
    "MemoryGrowth",
    "ProcessorWait",
    "StallTime",
    "StarvedTime",
    "resident_memory",
    "state_of",
]


HEARTBEAT_TIMEOUT_S = 0.5  #: heartbeat timeout after which the host counts as ended [s]
STARVED_TIMEOUT_S = 2.0  #: the same, including the time in which it was starved, for a simulated device only [s]
STOPPED_TIMEOUT_S = 0.1  #: heartbeat timeout of a stopped host [s]
LATE_HEARTBEAT_S = 0.08  #: four heartbeats are missing: from here on the host's state is checked [s]

_CHECK_INTERVAL_NS = 5_000_000  #: between two checks; one takes about 20 µs
_THREAD_CHECK_INTERVAL_NS = 20_000_000  #: the same for the threads; about 20 µs for each


def state_of(pid: int) -> Callable[[], str]:
    """Return a function that reads the state of the process `pid` in /proc/PID/stat: "R" running, "T" stopped, "t"
    stopped by a debugger, "X" ended; empty where the kernel does not report it."""
    if not is_linux():
        return lambda: ""
    try:
        file = os.open(f"/proc/{pid}/stat", os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return lambda: ""

    def state() -> str:
        try:
            return os.pread(file, 512, 0).rpartition(b")")[2][1:2].decode()
        except OSError:
            return "X"

    return state


@final
class HostHeartbeat:
    """Watchdog of the host: decides from its heartbeat and state whether it has ended.

    state     returns its state, as `state_of` does
    starved   whether it was starved of processor time since the last call, at a time [ns], as `ProcessorWait.update`;
    None: starvation does not extend the timeout
    """

    def __init__(self, state: Callable[[], str], starved: Callable[[int], bool] | None = None) -> None:
        self._state, self._starved = state, starved
        self._last_check = self._last_threads = 0
        self._silence = self._waited = 0  # time since the heartbeat, and the part in which it was starved [ns]

    def explain_silence(self, now: int, silence: int) -> str:
        """Return why the host counts as ended at `now` [ns], `silence` [ns] after its heartbeat; empty if it does not.

        Call it in every tick in which the heartbeat is `LATE_HEARTBEAT_S`.
        """
        if silence < self._silence:  # a heartbeat came meanwhile
            self._waited = self._last_threads = 0
        self._silence = silence
        if self._starved is not None and now - self._last_threads >= _THREAD_CHECK_INTERVAL_NS:
            since, self._last_threads = self._last_threads or now, now
            self._waited += (now - since) * self._starved(now)
        if silence > STARVED_TIMEOUT_S * 1e9:  # safety: host-starved
            silent = f"did not respond for {STARVED_TIMEOUT_S:g} s"
            return f"the program that started the servo {silent}: the computer is too busy"
        if silence - self._waited > HEARTBEAT_TIMEOUT_S * 1e9:
            return f"the program that started the servo did not respond for {HEARTBEAT_TIMEOUT_S:g} s"
        if silence > (STOPPED_TIMEOUT_S * 1e9 - _CHECK_INTERVAL_NS) and now - self._last_check >= _CHECK_INTERVAL_NS:
            self._last_check = now
            if self._state() in ("T", "t"):  # safety: host-stopped, host-computing
                return f"the program that started the servo was stopped and did not respond for {STOPPED_TIMEOUT_S:g} s"
        return ""


# --------------------------------------------------------------------------------------------------
# Detection of processor starvation of an unresponsive process, from the scheduler state of its threads.


_MAX_STARVED_SHARE = 0.5  #: share of a processor above which a process is computing, not starved [1]


@final
class ProcessorWait:
    """Detects starvation of the process `pid`, of the same user.

    It is starved if one of its threads is ready to run ("R" in /proc/PID/task/TID/stat), and yet the whole process got
    less than half of a processor. An update takes 20 to 50 µs a thread up to the first that is ready.
    """

    def __init__(self, pid: int) -> None:
        self._threads = f"/proc/{pid}/task"
        self._clock = (~pid << 3) | 2  # as clock_getcpuclockid(3) makes it: processor time of all threads
        self._last, self._used = 0, 0
        self._ready = ""  # the thread that was ready at the last update

    def update(self, now: int) -> bool:
        """Whether it was starved since the last update; `now` on the monotonic clock [ns]. False at the first.

        True on systems that do not report it: there, a simulated device tolerates silence up to `STARVED_TIMEOUT_S`.
        """
        if not is_linux():
            return True
        try:
            used = time.clock_gettime_ns(self._clock)
        except OSError:
            return False
        passed, computed = now - self._last, used - self._used
        known, self._last, self._used = self._last > 0, now, used
        return known and computed < _MAX_STARVED_SHARE * passed and self._is_ready()

    def _is_ready(self) -> bool:
        """Whether a thread is running or ready to run."""
        try:
            names = os.listdir(self._threads)
        except OSError:
            return False
        if self._ready in names:
            names.insert(0, self._ready)
        self._ready = next((name for name in names if self._state(name) == b"R"), "")
        return bool(self._ready)

    def _state(self, name: str) -> bytes:
        try:
            file = os.open(f"{self._threads}/{name}/stat", os.O_RDONLY | os.O_CLOEXEC)
        except OSError:
            return b""
        try:
            return os.read(file, 512).rpartition(b")")[2][1:2]
        except OSError:
            return b""
        finally:
            os.close(file)


# --------------------------------------------------------------------------------------------------
# Stall detection: the time since a counter changed (ticks of a loop, polls of a recorder, processor time of a process).


_MAX_STEP_S = 0.5  #: longest time that counts between two updates


@final
class StallTime:
    """Time since a value changed; counts only time in which the observer was running, not that of a suspended computer.

    `step`: longest time that counts between two updates, in any unit.
    """

    def __init__(self, step: float) -> None:
        self.time = 0.0  #: since the value changed, in the unit of `step`
        self._step = step
        self._value: int | None = None
        self._last_check = 0.0

    def update(self, now: float, value: int) -> float:
        """Return the time since `value` changed.

        >>> still = StallTime(step=2.0)
        >>> still.update(10.0, 7), still.update(11.0, 7), still.update(12.0, 8), still.update(99.0, 8)
        (0.0, 1.0, 0.0, 2.0)
        """
        if value != self._value:
            self._value, self.time = value, 0.0
        else:
            self.time += min(now - self._last_check, self._step)
        self._last_check = now
        return self.time


@final
class HangWatch:
    """Time for which a process has used no processor time: it is stopped or blocked."""

    def __init__(self, pid: int) -> None:
        self._path = Path(f"/proc/{pid}/schedstat")
        self._stall = StallTime(_MAX_STEP_S)

    def update(self) -> float:
        """Return that time [s]; call it at least twice a second. 0 where the kernel does not report it.

        >>> import os
        >>> HangWatch(os.getpid()).update()
        0.0
        """
        used = -1
        with suppress(OSError, ValueError):
            used = int(self._path.read_text(encoding="utf-8").split()[0])  # [ns]
        return self._stall.update(monotonic(), used) if used >= 0 else 0.0


@final
class StarvedTime:
    """Time for which a process was ready to run without a processor: on a busy computer it is slow, not hung."""

    def __init__(self, pid: int) -> None:
        self._path = Path(f"/proc/{pid}/schedstat")

    def read(self) -> float:
        """Return that time of its main thread since it began [s]; 0 where the kernel does not report it.

        >>> import os
        >>> StarvedTime(os.getpid()).read() >= 0.0
        True
        """
        with suppress(OSError, ValueError, IndexError):
            return 1e-9 * int(self._path.read_text(encoding="utf-8").split()[1])
        return 0.0


# --------------------------------------------------------------------------------------------------
# Memory use of a servo's process, measured by its host: its garbage collector is off.


_WARN_GROWTH_BYTES = 100e6  #: growth from which the user is warned
_MEMORY_CHECK_INTERVAL_S = 1.0  #: between two measurements


def resident_memory(pid: int) -> int | None:
    """Resident memory of the process `pid` [bytes]; None if it has ended."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text(encoding="utf-8").split()[1]) * mmap.PAGESIZE
    except (OSError, IndexError, ValueError):
        return None


@final
class MemoryGrowth:
    """Measures the memory of the process `pid` once a second from the first `update` on."""

    def __init__(self, pid: int) -> None:
        self.start: int | None = None  #: at the first update [bytes]
        self.now: int | None = None  #: at the last one [bytes]
        self._pid = pid
        self._next = 0.0

    def update(self, now: float) -> None:
        """Measure if a second has passed since the last time; `now` [s]."""
        if now >= self._next and (found := resident_memory(self._pid)) is not None:
            self._next, self.now = now + _MEMORY_CHECK_INTERVAL_S, found
            if self.start is None:
                self.start = found

    @property
    def warning(self) -> str:
        """Warning for the user; empty below 100 MB of growth."""
        if self.start is None or self.now is None or self.now - self.start < _WARN_GROWTH_BYTES:
            return ""
        return (
            f"the servo's process has grown by {(self.now - self.start) / 1e6:.0f} MB since its start. It never "
            "collects garbage, because that would delay the loop: the world must not create objects that refer to "
            "each other in a cycle, or keep objects from a tick"
        )

    def facts(self) -> dict[str, float]:
        """Memory at the start of the loop and at the last update [MB], as plain JSON types; empty before the first."""
        if self.start is None or self.now is None:
            return {}
        return {"start": round(self.start / 1e6, 1), "now": round(self.now / 1e6, 1)}
