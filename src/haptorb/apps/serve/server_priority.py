"""Before ordinary programs while it sleeps nearly always: an answer should not wait for its turn on a processor."""

from __future__ import annotations

import os
from contextlib import suppress
from time import monotonic, process_time
from typing import final

__all__ = ["ServerPriority"]

_URGENT = -10  #: niceness; every loop goes before, and so does the console's page
_FLOOD = 0.6  #: of a processor: who needs more is flooded, and takes its turn like any other
_CALM = 0.4  #: and comes first again below


@final
class ServerPriority:
    """Of this process; `look` at it now and then."""

    def __init__(self) -> None:
        self._time, self._used = monotonic(), process_time()
        self._urgent = self._ask(_URGENT)

    def look(self) -> None:
        """Give way if clients keep the processor busy, come first again when they do not."""
        now, used = monotonic(), process_time()
        share = (used - self._used) / max(now - self._time, 1e-3)
        self._time, self._used = now, used
        if self._urgent and share > _FLOOD:
            self._ask(0)
            self._urgent = False
        elif not self._urgent and share < _CALM:
            self._urgent = self._ask(_URGENT)

    @staticmethod
    def _ask(niceness: int) -> bool:
        """Whether it was permitted."""
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, 0, niceness)
            return True
        return False
