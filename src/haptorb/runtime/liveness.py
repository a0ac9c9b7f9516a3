"""Whether the program that started the servo still runs: by its heartbeat, and by its state in the kernel.

A heartbeat is late for three reasons. A program that was stopped (SIGSTOP, a debugger) cannot react. One that
computes or sleeps with Python's interpreter lock is late by its own fault, and its heart may beat again. One that waits
for its turn on a busy computer still runs. The kernel distinguishes them.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from time import monotonic
from typing import final

__all__ = [
    "LATE",
    "SILENCE",
    "STARVATION",
    "STOPPED",
    "HangWatch",
    "HostHeartbeat",
    "MemoryGrowth",
    "ProcessorWait",
    "StallTime",
    "StarvedTime",
    "resident_memory",
    "state_of",
]


SILENCE = 0.5  #: a host without a heartbeat for so long counts as ended [s]
STARVATION = 2.0  #: with the time in which it waited for a processor, where nothing real can move [s]
STOPPED = 0.1  #: and so is one that is stopped [s]
LATE = 0.08  #: four beats have not come: time to look [s]

_CHECK_INTERVAL_NS = 5_000_000  #: between two looks [ns]; one takes about 20 µs
_THREAD_CHECK_INTERVAL_NS = 20_000_000  #: this one takes as long for every thread [ns]


def state_of(pid: int) -> Callable[[], str]:
    """A function that gives the state of the process `pid` as in /proc/PID/stat: "R" runs, "T" is stopped, "t" too, by
    a debugger; "X" has ended; empty where the kernel does not say."""
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
    """Judges the host.

    state     gives its state, as `state_of` does
    starved   whether it has waited for a processor since the last call, at a time [ns], as `ProcessorWait.look` does;
              None: that excuses nothing
    """

    def __init__(self, state: Callable[[], str], starved: Callable[[int], bool] | None = None) -> None:
        self._state, self._starved = state, starved
        self._last_look = self._last_threads = 0
        self._silence = self._waited = 0  # how long it is silent, and how much of that it has waited [ns]

    def explain_silence(self, now: int, silence: int) -> str:
        """Why the host counts as ended at `now` [ns], after a `silence` [ns] of its heartbeat; empty if it does not.

        To be called in every tick in which the heart is `LATE`.
        """
        if silence < self._silence:  # it has beaten meanwhile
            self._waited = self._last_threads = 0
        self._silence = silence
        if self._starved is not None and now - self._last_threads >= _THREAD_CHECK_INTERVAL_NS:
            since, self._last_threads = self._last_threads or now, now
            self._waited += (now - since) * self._starved(now)
        if silence > STARVATION * 1e9:  # safety: host-starved
            return f"the program that started the servo did not respond for {STARVATION:g} s: the computer is too busy"
        if silence - self._waited > SILENCE * 1e9:
            return f"the program that started the servo did not respond for {SILENCE:g} s"
        if silence > (STOPPED * 1e9 - _CHECK_INTERVAL_NS) and now - self._last_look >= _CHECK_INTERVAL_NS:
            self._last_look = now
            if self._state() in ("T", "t"):  # safety: host-stopped, host-computing
                return f"the program that started the servo was stopped and did not respond for {STOPPED:g} s"
        return ""


# --------------------------------------------------------------------------------------------------
# Whether a process that shows no life waits for its turn on a busy computer: what the kernel says of its threads.


_SHARE = 0.5  #: of a processor; a process that gets more computes [1]


@final
class ProcessorWait:
    """Watches the process `pid`, of the same user.

    One of its threads is ready to run ("R" in /proc/PID/task/TID/stat), and yet the whole process got less than half of
    a processor: it waits. One look takes 20 to 50 µs a thread up to the first that is ready.
    """

    def __init__(self, pid: int) -> None:
        self._threads = f"/proc/{pid}/task"
        self._clock = (~pid << 3) | 2  # as clock_getcpuclockid(3) makes it: time on a processor, of all threads
        self._last, self._used = 0, 0
        self._ready = ""  # the thread that was ready in the last look

    def look(self, now: int) -> bool:
        """Whether it has waited since the last look; `now` on the monotonic clock [ns]. False for the first."""
        try:
            used = time.clock_gettime_ns(self._clock)
        except OSError:
            return False
        passed, computed = now - self._last, used - self._used
        known, self._last, self._used = self._last > 0, now, used
        return known and computed < _SHARE * passed and self._is_ready()

    def _is_ready(self) -> bool:
        """Whether a thread has, or waits for, a processor."""
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
# For how long a number has not changed: ticks of a loop, looks of a recorder, processor time of a process.


_STEP = 0.5  #: that counts at most between two looks at a process [s]


@final
class StallTime:
    """Counts only time in which the observer was running itself: a computer that was suspended is no stall.

    `step`: at most so much counts between two looks, in any unit of time.
    """

    def __init__(self, step: float) -> None:
        self.time = 0.0  #: since the number changed, in the unit of `step`
        self._step = step
        self._value: int | None = None
        self._last_look = 0.0

    def look(self, now: float, value: int) -> float:
        """The time for which `value` has stayed as it is.

        >>> still = StallTime(step=2.0)
        >>> still.look(10.0, 7), still.look(11.0, 7), still.look(12.0, 8), still.look(99.0, 8)
        (0.0, 1.0, 0.0, 2.0)
        """
        if value != self._value:
            self._value, self.time = value, 0.0
        else:
            self.time += min(now - self._last_look, self._step)
        self._last_look = now
        return self.time


@final
class HangWatch:
    """For how long a process has used no processor time: it is stopped, or waits for what does not come."""

    def __init__(self, pid: int) -> None:
        self._path = Path(f"/proc/{pid}/schedstat")
        self._stall = StallTime(_STEP)

    def look(self) -> float:
        """That time [s]; to be called at least twice a second. 0 where the kernel does not say.

        >>> import os
        >>> HangWatch(os.getpid()).look()
        0.0
        """
        used = -1
        with suppress(OSError, ValueError):
            used = int(self._path.read_text().split()[0])  # [ns]
        return self._stall.look(monotonic(), used) if used >= 0 else 0.0


@final
class StarvedTime:
    """For how long a process was ready to compute without a processor: on a busy computer it is slow, not broken."""

    def __init__(self, pid: int) -> None:
        self._path = Path(f"/proc/{pid}/schedstat")

    def look(self) -> float:
        """That time of its main thread since it began [s]; 0 where the kernel does not say.

        >>> import os
        >>> StarvedTime(os.getpid()).look() >= 0.0
        True
        """
        with suppress(OSError, ValueError, IndexError):
            return 1e-9 * int(self._path.read_text().split()[1])
        return 0.0


# --------------------------------------------------------------------------------------------------
# How much memory a servo's process holds, seen from its host: its garbage collector is off.


_MUCH = 100e6  #: from so much on the user is warned [bytes]
_MEMORY_CHECK_INTERVAL_S = 1.0  #: between two looks [s]


def resident_memory(pid: int) -> int | None:
    """Memory in which the process `pid` has something [bytes]; None if it has ended."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError, ValueError):
        return None


@final
class MemoryGrowth:
    """Looks at the process `pid` once a second from the first `look` on."""

    def __init__(self, pid: int) -> None:
        self.start: int | None = None  #: at the first look [bytes]
        self.now: int | None = None  #: at the last one [bytes]
        self._pid = pid
        self._next = 0.0

    def look(self, now: float) -> None:
        """Look, if a second has passed since the last time; `now` [s]."""
        if now >= self._next and (found := resident_memory(self._pid)) is not None:
            self._next, self.now = now + _MEMORY_CHECK_INTERVAL_S, found
            if self.start is None:
                self.start = found

    @property
    def warning(self) -> str:
        """What a person should know; empty while little has been added."""
        if self.start is None or self.now is None or self.now - self.start < _MUCH:
            return ""
        return (
            f"the servo's process has grown by {(self.now - self.start) / 1e6:.0f} MB since its start. It never "
            "collects garbage, because that would delay the loop: the world must not create objects that refer to "
            "each other in a cycle, or keep objects from a tick"
        )

    def facts(self) -> dict[str, float]:
        """MB at the start of the loop and at the last look, as plain JSON types; empty before the first."""
        if self.start is None or self.now is None:
            return {}
        return {"start": round(self.start / 1e6, 1), "now": round(self.now / 1e6, 1)}
