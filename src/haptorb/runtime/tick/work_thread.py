"""A thread beside the loop that computes the work of a world while ticks go on."""

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
    """Computes one work at a time, at ordinary priority and on any processor.

    The thread begins with the first work and ends with the process. It holds Python's lock only between calls of the
    engine, for some ten microseconds.

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
            self._thread = Thread(target=self._run, name="work of the world", daemon=True)
            self._thread.start()
        self._works.put(work)

    def take(self) -> Any:
        """The result of the work that was given last, which is done. Raises what its computation raised."""
        if self._fault is not None:
            fault, self._fault = self._fault, None
            raise fault
        return self._result

    def _run(self) -> None:
        with suppress(OSError):  # a loop's priority and processor are not for this thread
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        with suppress(OSError):
            os.sched_setaffinity(0, range(os.cpu_count() or 1))
        while True:
            work = self._works.get()
            start = thread_time()
            try:
                self._result = work.compute()
            except BaseException as fault:  # the tick that takes it trips
                self._fault = fault
            self.took = thread_time() - start
            self.done = True
