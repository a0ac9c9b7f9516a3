"""`multiprocessing` with new interpreters that import nothing from the current folder, as `python_process` has it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.process import BaseProcess
from threading import RLock
from typing import Any, cast

__all__ = ["spawn_context"]

_changing = RLock()  # the environment


@contextmanager
def _safe_path() -> Iterator[None]:
    """Python processes that are started meanwhile import nothing from the current folder."""
    with _changing:
        before = os.environ.get("PYTHONSAFEPATH")
        os.environ["PYTHONSAFEPATH"] = "1"
        try:
            yield
        finally:
            if before is None:
                del os.environ["PYTHONSAFEPATH"]
            else:
                os.environ["PYTHONSAFEPATH"] = before


class _Process(SpawnProcess):
    @staticmethod
    def _Popen(process_obj: BaseProcess) -> Any:
        with _safe_path():  # safety: spawned-without-folder
            return cast("Any", SpawnProcess)._Popen(process_obj)


class _Context(SpawnContext):
    Process = _Process


def spawn_context() -> SpawnContext:
    """For `multiprocessing`: new interpreters, which import nothing from the current folder."""
    with _safe_path():
        resource_tracker.ensure_running()  # a Python process too
    return _Context()
