"""A timer in the kernel that kills this process unless it is set again in time, whatever runs inside it.

No code of the process takes part in its end: not its signal handlers, which Python runs only between two of its own
instructions, and not a thread, which would wait for the interpreter's lock. SIGKILL can neither be caught, nor blocked,
nor ignored, and the timer also runs while the process is stopped. A forked child does not inherit it.
"""

from __future__ import annotations

import ctypes
import os
import signal
from typing import final

from haptorb.errors import ServoError

__all__ = ["KillTimer"]

_CLOCK_MONOTONIC = 1
_SIGEV_SIGNAL = 0


class _Event(ctypes.Structure):
    _fields_ = (
        ("value", ctypes.c_void_p), ("signal", ctypes.c_int), ("notify", ctypes.c_int), ("rest", ctypes.c_char * 48),
    )  # fmt: skip


class _Times(ctypes.Structure):
    _fields_ = (
        ("every_s", ctypes.c_long), ("every_ns", ctypes.c_long),
        ("first_s", ctypes.c_long), ("first_ns", ctypes.c_long),
    )  # fmt: skip


@final
class KillTimer:
    """Does nothing until `set` is called for the first time. Raises ServoError if the kernel has no such timers."""

    def __init__(self) -> None:
        libc = ctypes.CDLL(None, use_errno=True)
        if not hasattr(libc, "timer_create"):
            libc = ctypes.CDLL("librt.so.1", use_errno=True)  # where it was before glibc 2.34
        self._timer = ctypes.c_void_p()
        event = _Event(signal=int(signal.SIGKILL), notify=_SIGEV_SIGNAL)  # safety: servo-hung
        if libc.timer_create(_CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(self._timer)):
            why = os.strerror(ctypes.get_errno())
            raise ServoError(f"the kernel provides no timer to end a servo that hangs: timer_create failed ({why})")
        self._settime = libc.timer_settime
        self._settime.argtypes = (ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
        self._times = _Times()  # one for all calls: nothing is allocated per tick
        self._at = ctypes.addressof(self._times)

    def set(self, seconds: float) -> None:
        """The process ends `seconds` from now unless this is called again before."""
        self._times.first_s, self._times.first_ns = divmod(int(seconds * 1e9), 1_000_000_000)
        self._settime(self._timer, 0, self._at, None)
