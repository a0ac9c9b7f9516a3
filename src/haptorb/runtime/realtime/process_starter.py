"""A thread that lives as long as the program, and starts its processes.

The kernel's parent-death signal comes when the thread ends that started a process. Started by this thread, a process
can ask to be killed then, and is killed when the program ends, not when one of its threads does.
"""

from __future__ import annotations

import os
import queue
import subprocess
import threading
from collections.abc import Sequence
from concurrent.futures import Future
from subprocess import TimeoutExpired
from time import monotonic
from typing import Any, cast

from haptorb.cluster.python_process import environment, python_command

__all__ = ["end_process", "start", "start_python", "wait_for_end"]

_SLICE = 0.05  #: between two looks for an interruption [s]
_KILLED = 2.0  #: for a process to end that was killed; the kernel may hold one that waits for a disk [s]

Job = tuple[Sequence[str], dict[str, Any], "Future[subprocess.Popen[bytes]]"]

_jobs: queue.SimpleQueue[Job] | None = None
_making = threading.Lock()


def start(command: Sequence[str], **options: Any) -> subprocess.Popen[bytes]:
    """A process, made by that thread as `subprocess.Popen` would with these `options`. A caller that is interrupted
    meanwhile leaves no process behind."""
    future: Future[subprocess.Popen[bytes]] = Future()
    _queue().put((command, options, future))
    try:
        return future.result()
    except BaseException:
        future.add_done_callback(_kill)
        raise


def start_python(module: str, *arguments: str, isolated: bool = False, **options: Any) -> subprocess.Popen[bytes]:
    """`python -m module arguments` in a session of its own, with the `options` of `subprocess.Popen`; see
    `python_command` for what it can import.

    Ctrl-C in the terminal then reaches the parent alone, which ends its children in order.
    """
    command = python_command(module, *arguments, isolated=isolated)
    return start(command, **{"start_new_session": True, "env": environment(), **options})


def wait_for_end(process: subprocess.Popen[bytes], patience: float, interrupted: threading.Event | None = None) -> bool:
    """Whether `process` has ended within `patience` [s]; False before that when `interrupted`."""
    end = monotonic() + patience
    while True:
        left = end - monotonic()
        try:
            process.wait(max(left if interrupted is None else min(left, _SLICE), 0.0))
            return True
        except TimeoutExpired:
            if left <= 0.0 or (interrupted is not None and interrupted.is_set()):
                return False


def end_process(
    process: subprocess.Popen[bytes] | None, patience: float, interrupted: threading.Event | None = None
) -> bool:
    """Wait for `process`, if there is one, for `patience` [s], then kill it; whether it has ended.

    One that the kernel holds, as on a disk that does not answer, cannot be ended and is not waited for.
    """
    if process is None or wait_for_end(process, patience, interrupted):
        return True
    process.kill()
    return wait_for_end(process, _KILLED)


def _queue() -> queue.SimpleQueue[Job]:
    global _jobs
    with _making:
        if _jobs is None:
            _jobs = queue.SimpleQueue()
            # A daemon: the interpreter does not wait for it, and only the end of the process ends it.
            threading.Thread(target=_work, args=(_jobs,), name="haptorb-starter", daemon=True).start()
        return _jobs


def _work(jobs: queue.SimpleQueue[Job]) -> None:
    while True:
        command, options, future = jobs.get()
        try:
            process = cast("subprocess.Popen[bytes]", subprocess.Popen(command, **options))
            future.set_result(process)
        except BaseException as cause:
            future.set_exception(cause)
        del future  # only the caller holds the process


def _kill(future: Future[subprocess.Popen[bytes]]) -> None:
    if future.exception() is None:
        process = future.result()
        process.kill()
        process.wait()


def _forget() -> None:
    """A forked child has none of its parent's threads."""
    global _jobs, _making
    _jobs, _making = None, threading.Lock()


if hasattr(os, "register_at_fork"):  # elsewhere nothing forks
    os.register_at_fork(after_in_child=_forget)
