"""For programs that talk to a firmware from an ordinary process: nothing of their own may hold them up for 15 ms."""

from __future__ import annotations

import gc
import sys

from haptorb.runtime.realtime.kernel_requests import raise_priority

__all__ = ["prepare_thread"]

_TURN = 1e-4  #: how long a thread may keep the interpreter from another [s]


def prepare_thread() -> bool:
    """Come before ordinary threads, and never again look for garbage in what exists now; False if the first is refused.

    With all of the package loaded a full look takes 40 ms, and a firmware switches its coils off after 15 ms of
    silence. What is made from now on is still collected. A thread that draws a progress bar releases the interpreter
    after 0.1 ms: by Python's own 5 ms, waited for at every reading, three in a row would be silence.
    """
    sys.setswitchinterval(_TURN)
    gc.collect()
    gc.freeze()
    return raise_priority()
