"""Whether the program that started the servo still lives: by its heartbeat, and by the processor time that it uses.

A heartbeat is late for two reasons. A program that computes holds Python's interpreter lock, its heart waits for its
turn, and nothing is wrong. A program that was stopped (SIGSTOP, a debugger, a frozen container) can obey nobody. The
kernel tells them apart: the first one uses processor time, the second one none at all.
"""

from __future__ import annotations

from collections.abc import Callable
from time import clock_gettime_ns
from typing import final

from haptorb.runtime.stillness import Stillness

__all__ = ["FROZEN", "LATE", "SILENCE", "HostLife", "processor_time"]

SILENCE = 0.5  #: a host that shows no heartbeat for so long is taken for dead [s]
FROZEN = 0.1  #: and so is one that uses no processor time meanwhile, if its heart comes before ordinary programs [s]
LATE = 0.04  #: two beats have not come: time to look [s]

_UNUSED = 50_000_000  #: without processor time [ns]; a heart that waits for the interpreter lock wakes every 5 ms
_STEP = 25_000_000  #: longest time between two looks that counts: this process may have been held up itself [ns]


def processor_time(pid: int) -> Callable[[], int]:
    """A function that gives the processor time of all threads of the process `pid` [ns]; −1 if there is none."""
    clock = ~pid << 3 | 2  # what clock_getcpuclockid does

    def used() -> int:
        try:
            return clock_gettime_ns(clock)
        except OSError:
            return -1

    return used


@final
class HostLife:
    """Judges the host; `used` gives its processor time [ns]."""

    def __init__(self, used: Callable[[], int]) -> None:
        self._used = used
        self._still = Stillness(_STEP)

    def trouble(self, now: int, silence: int, *, urgent: bool) -> str:
        """Why the host is taken for dead at `now` [ns], after a `silence` [ns] of its heart; empty if it is not.

        `urgent`: its heart is granted a real-time priority. Without one, a busy computer alone keeps it from running.
        To be called in every tick in which the heart is late.
        """
        if silence > SILENCE * 1e9:
            return f"the program that started the servo showed no sign of life for {SILENCE:g} s"
        if not urgent:
            return ""
        unused = self._still.look(now, self._used())
        if silence > FROZEN * 1e9 and unused > _UNUSED:
            return (
                f"the program that started the servo showed no sign of life for {FROZEN:g} s and used no processor "
                "time: it was stopped"
            )
        return ""
