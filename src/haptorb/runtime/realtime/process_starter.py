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
from typing import Any, cast

__all__ = ["start"]

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
