"""Compiler process beside a servo: `python -m haptorb.runtime.first_start WHAT FOLDER PARENT`.

`controller`: at a first start. The servo's process warms up its simulated device first and the controller after it;
meanwhile this one compiles the controller. They share the cache of compiled code, so that two processors need little
more than half the time. It is killed when the loop runs.

`catalogue`: from then on, the worlds that the servo has not found in the cache, at the lowest priority. A requested
world is compiled next.
"""

from __future__ import annotations

import gc

if __name__ == "__main__":
    gc.disable()  # as in the servo's process: nearly all objects that imports and compiling make are permanent

import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from time import monotonic, sleep

from haptorb.cache_folder import cache_folder
from haptorb.runtime import plan
from haptorb.runtime.linux import die_with_parent, is_parent_gone, lower_share
from haptorb.runtime.prestart import CATALOGUE, PLAN, WANTED, code_note
from haptorb.runtime.warm_up import Compilation

__all__ = ["main"]

_NICE = 19  #: nice value
_MAX_WAIT_S = 20.0  #: longest wait for another process that compiles the same
_LOCK_RETRY_INTERVAL_S = 0.1  #: between two tries to lock


def main(what: str, folder: Path, parent: int) -> int:
    """Compile `what` for the plan in `folder` until done or the parent has ended."""
    die_with_parent()
    compilation = Compilation(plan.load(folder / PLAN).config)
    parts: Iterable[object] = compilation.compile_controller()
    if what == CATALOGUE:
        lower_share(_NICE)
        _take_turn()
        parts = _compile_catalogue(compilation, folder)
    for _ in parts:
        if is_parent_gone(parent):
            return 1
    return 0


def _compile_catalogue(compilation: Compilation, folder: Path) -> Iterator[str]:
    """Compile the worlds one by one; mark each in `folder` when its code is available."""
    for name in compilation.compile_catalogue(lambda: _read_wanted(folder / WANTED)):
        with suppress(OSError):  # the servo has ended
            code_note(folder, name).touch()
        yield name


def _take_turn() -> None:
    """Wait for exclusive access: one process at a time compiles the catalogue, the next finds it in the cache."""
    with suppress(OSError, ImportError):  # no writable cache folder; Windows: no such lock, and both compile
        import fcntl

        descriptor = os.open(cache_folder() / "compiling", os.O_CREAT | os.O_RDWR, 0o600)

        end = monotonic() + _MAX_WAIT_S
        while monotonic() < end:
            with suppress(BlockingIOError):
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)  # until this process ends
                return
            sleep(_LOCK_RETRY_INTERVAL_S)  # no blocking lock: the hang detection would count a blocked process as hung


def _read_wanted(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return ""


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3])))
