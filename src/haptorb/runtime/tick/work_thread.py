"""A background thread that computes the work of a world while ticks continue."""

from __future__ import annotations

import os
from contextlib import suppress
from queue import SimpleQueue
from threading import Thread
from time import thread_time
from typing import Any, final

from haptorb.worlds.dynamic_world import WorldWork

__all__ = ["WorkThread"]


@final
class WorkThread:
    """Computes one work at a time, at ordinary priority and on other processors than the loop's.

    The thread begins with the first work and ends with the process; where none can begin, the work is computed at once,
    and the tick is late. It holds Python's lock only between calls of the engine, for some ten microseconds.

    done   the work that was given last has been computed
    took   processor time that it took [s]
    """

    def __init__(self) -> None:
        self._works: SimpleQueue[WorldWork] = SimpleQueue()
        self._thread: Thread | None = None
        self._result: Any = None
        self._fault: BaseException | None = None
        self.done, self.took = False, 0.0

    def give(self, work: WorldWork) -> None:
        """Have `work` computed; the one before has been."""
        self.done = False
        if self._thread is None:
            loops = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
            thread = Thread(target=self._run, args=(loops,), name="work of the world", daemon=True)
            try:
                thread.start()
            except RuntimeError:  # no memory, or too many threads
                self._compute(work)
                return
            self._thread = thread
        self._works.put(work)

    def take(self) -> Any:
        """The result of the work that was given last, which is done. Raises what its computation raised."""
        if self._fault is not None:
            fault, self._fault = self._fault, None
            raise fault
        return self._result

    def _run(self, loops: set[int]) -> None:
        """`loops`: the processors of the loop, which are not for this thread, nor is the loop's priority. Empty where
        the system does not say."""
        if loops:
            others = {*range(os.cpu_count() or 1)} - loops
            with suppress(OSError):
                os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
            with suppress(OSError):
                os.sched_setaffinity(0, others or loops)
        while True:
            self._compute(self._works.get())

    def _compute(self, work: WorldWork) -> None:
        start = thread_time()
        try:
            self._result = work.compute()
        except BaseException as fault:  # the tick that takes it trips
            self._fault = fault
        self.took = thread_time() - start
        self.done = True
