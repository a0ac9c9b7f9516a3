"""Whether the program that started the servo still runs: by its heartbeat, and by its state in the kernel.

A heartbeat is late for three reasons. A program that was stopped (SIGSTOP, a debugger) cannot react. One that
computes or sleeps with Python's interpreter lock is late by its own fault, and its heart may beat again. One that waits
for its turn on a busy computer still runs. The kernel distinguishes them.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import final

__all__ = ["LATE", "SILENCE", "STARVATION", "STOPPED", "HostHeartbeat", "state_of"]

SILENCE = 0.5  #: a host without a heartbeat for so long counts as ended [s]
STARVATION = 2.0  #: with the time in which it waited for a processor, where nothing real can move [s]
STOPPED = 0.1  #: and so is one that is stopped [s]
LATE = 0.08  #: four beats have not come: time to look [s]

_LOOK = 5_000_000  #: between two looks [ns]; one takes about 20 µs
_LOOK_AT_THREADS = 20_000_000  #: this one takes as long for every thread [ns]


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
        if self._starved is not None and now - self._last_threads >= _LOOK_AT_THREADS:
            since, self._last_threads = self._last_threads or now, now
            self._waited += (now - since) * self._starved(now)
        if silence > STARVATION * 1e9:  # safety: host-starved
            return f"the program that started the servo did not respond for {STARVATION:g} s: the computer is too busy"
        if silence - self._waited > SILENCE * 1e9:
            return f"the program that started the servo did not respond for {SILENCE:g} s"
        if silence > (STOPPED * 1e9 - _LOOK) and now - self._last_look >= _LOOK:
            self._last_look = now
            if self._state() in ("T", "t"):  # safety: host-stopped, host-computing
                return f"the program that started the servo was stopped and did not respond for {STOPPED:g} s"
        return ""
