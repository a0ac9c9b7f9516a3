"""A core that never falls asleep between ticks: a thread that waits on it, behind everybody else.

A core with nothing to do is halted. When it wakes for the next tick its clock is slow, its caches have been emptied,
and in a virtual machine somebody else's work stood there meanwhile: the same tick takes about twice as long as on a
core that stayed awake (`haptorb bench loop`). Real-time people boot with `idle=poll` against this; here a thread spins
on the servo's core under the kernel's idle policy, which gives way to whatever else wants to run there, the servo first
of all. It holds neither the interpreter nor a cache line that changes.
"""

from __future__ import annotations

import ctypes
import os
import signal
import threading

__all__ = ["keep_awake"]


def keep_awake() -> bool:
    """From now to the end of the process, keep the core that it is bound to awake; False where that cannot be had.

    Only for a process bound to one core: anywhere else it would warm a core that nobody waits for.
    """
    if len(os.sched_getaffinity(0)) != 1 or not hasattr(os, "SCHED_IDLE"):
        return False
    libc = ctypes.CDLL(None)
    try:
        lock, spin = libc.pthread_spin_init, libc.pthread_spin_lock
    except AttributeError:
        return False
    held = ctypes.c_int()
    if lock(ctypes.byref(held), 0) != 0 or spin(ctypes.byref(held)) != 0:
        return False
    ready = threading.Event()
    granted = [False]

    def spinning() -> None:
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())  # they are the loop's
        try:
            os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
            granted[0] = True
        except OSError:  # as an ordinary thread it would take what others need
            return
        finally:
            ready.set()
        # Never given back: it ends with the process. In here the thread does not hold the interpreter's lock, and the
        # C library's loop tells the processor that it only waits.
        spin(ctypes.byref(held))

    threading.Thread(target=spinning, name="wakefulness", daemon=True).start()
    ready.wait()
    return granted[0]
