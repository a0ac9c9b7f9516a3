"""Whether the program that started the servo still lives: by its heartbeat, and by what the kernel says of it.

A heartbeat is late for two reasons. A program that computes holds Python's interpreter lock, or waits for its turn on a
busy computer: its heart will beat again. A program that was stopped (SIGSTOP, a debugger) can obey nobody. The kernel
tells them apart.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import final

__all__ = ["LATE", "SILENCE", "STOPPED", "HostHeartbeat", "state_of"]

SILENCE = 0.5  #: a host that shows no heartbeat for so long is taken for dead [s]
STOPPED = 0.1  #: and so is one that is stopped [s]
LATE = 0.08  #: four beats have not come: time to look [s]

_LOOK = 5_000_000  #: between two looks [ns]; one takes about 20 µs


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
    """Judges the host; `state` gives its state, as `state_of` does."""

    def __init__(self, state: Callable[[], str]) -> None:
        self._state = state
        self._last_look = 0

    def explain_silence(self, now: int, silence: int) -> str:
        """Why the host is taken for dead at `now` [ns], after a `silence` [ns] of its heart; empty if it is not.

        To be called in every tick in which the heart is `LATE`.
        """
        if silence > SILENCE * 1e9:
            return f"the program that started the servo did not respond for {SILENCE:g} s"
        if silence > (STOPPED * 1e9 - _LOOK) and now - self._last_look >= _LOOK:
            self._last_look = now
            if self._state() in ("T", "t"):  # safety: host-stopped, host-computing
                return f"the program that started the servo was stopped and did not respond for {STOPPED:g} s"
        return ""
