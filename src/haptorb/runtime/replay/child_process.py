"""Processes that compute a part of a replay beside this one, with everything that it has loaded."""

from __future__ import annotations

import multiprocessing
import signal
import sys
import warnings
from collections.abc import Callable
from multiprocessing.process import BaseProcess
from typing import Any

from haptorb.cluster.cores import count_cores
from haptorb.errors import HaptorbError
from haptorb.runtime.realtime.linux import is_linux

__all__ = ["count_processors", "start_child"]


def count_processors() -> int:
    """On how many processors this process may compute; 1 where a process cannot be forked, or not safely."""
    return count_cores() if is_linux() else 1


def start_child(work: Callable[..., None], *given: Any) -> BaseProcess:
    """A process that does `work(*given)`, with a copy of this one's memory, and ends with it.

    It says nothing about a mistake, and ends with another code than 0: this process finds the mistake again.
    """
    process = multiprocessing.get_context("fork").Process(target=_work, args=(work, given), daemon=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # other threads: the child only computes
        process.start()
    return process


def _work(work: Callable[..., None], given: tuple[Any, ...]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # ^C is the parent's business, whose end ends this one
    try:
        work(*given)
    except HaptorbError:
        sys.exit(1)
