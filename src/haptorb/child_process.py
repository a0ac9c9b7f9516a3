"""Start of Python child processes that import nothing from the current folder, with their objects and their number.

`python -m` and `python -c` put the current folder first on the import path. A `random.py` there, whoever wrote it,
would be executed in the process that holds the coils. Every child is therefore started with `-P`; one that needs no
code of the user with `-I`, which ignores PYTHONPATH too.
"""

from __future__ import annotations

import os
import pickle
import site
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from multiprocessing import resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.process import BaseProcess
from pathlib import Path
from threading import RLock
from typing import Any, cast

from haptorb.own_code import pickle_with_code

__all__ = ["append_folders", "count_cores", "environment", "pack", "python_command", "spawn_context", "unpack"]


def count_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


#: An isolated process finds this package and its dependencies where this process found them: the package before
#: another installed version of it, and after Python's own modules.
_ISOLATED = (
    "import sys; root, user, module = sys.argv[1:4]; del sys.argv[1:4]; "
    "at = next((n for n, one in enumerate(sys.path) if one.endswith('-packages')), len(sys.path)); "
    "sys.path[at:at] = [root] * (root not in sys.path[:at + 1]); "
    "sys.path += [user] * (user != '' and user not in sys.path); "
    "import runpy; runpy.run_module(module, run_name='__main__', alter_sys=True)"
)


def python_command(module: str, *arguments: str, isolated: bool = False) -> list[str]:
    """Return the command for `python -m module arguments` that imports nothing from the current folder.

    `isolated`: nor from PYTHONPATH, for modules that need no code of the user.
    """
    if not isolated:
        return [sys.executable, "-P", "-m", module, *arguments]  # safety: no-current-folder
    # safety: isolated-child
    return [sys.executable, "-I", "-c", _ISOLATED, *_own_folders(), module, *arguments]


def _own_folders() -> tuple[str, str]:
    """Return the folder of this package, and the account's site-packages if this process uses them, else nothing."""
    root = str(Path(__file__).resolve().parents[1])
    return root, site.getusersitepackages() if site.ENABLE_USER_SITE else ""


def environment(more: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return this process's environment for a child, with those entries of `more` that are not set yet.

    An empty entry of PYTHONPATH, left by `export PYTHONPATH=$PYTHONPATH:...`, means the current folder: it is removed.
    A package that is not installed, found by a modified `sys.path`, comes first: otherwise the child would run another
    version, or none. One installed in its source folder does not: other files of that folder would shadow Python's own
    modules in the child, but not in this process.
    """
    found = {**(more or {}), **os.environ}
    if "PYTHONPATH" in found:
        # safety: no-empty-entry
        found["PYTHONPATH"] = os.pathsep.join(one for one in found["PYTHONPATH"].split(os.pathsep) if one)
    root, _ = _own_folders()
    folders = [one for one in found.get("PYTHONPATH", "").split(os.pathsep) if one]
    if root not in folders and not root.endswith("-packages") and not _is_installed_in_place(root):
        found["PYTHONPATH"] = os.pathsep.join([root, *folders])
    return found


@cache
def _is_installed_in_place(root: str) -> bool:
    """Whether a file NAME.pth of this Python names the folder `root`, as after `pip install --editable`, and this
    process found it that way: after Python's own modules."""
    own = os.path.dirname(os.__file__)
    if root not in sys.path or own not in sys.path[: sys.path.index(root)]:
        return False
    folders = [*site.getsitepackages(), *([site.getusersitepackages()] if site.ENABLE_USER_SITE else [])]
    for file in (file for folder in folders for file in sorted(Path(folder).glob("*.pth"))):
        with suppress(OSError):
            if root in file.read_text(encoding="utf-8", errors="replace").splitlines():
                return True
    return False


def append_folders(folders: Iterable[str]) -> None:
    """Append `folders` to the import path, after all others, so that they shadow nothing."""
    for one in folders:
        folder = os.path.abspath(one)
        if folder not in sys.path:
            sys.path.append(folder)  # safety: folders-last


def pack(what: Any) -> bytes:
    """Pickle `what` with its code and the folders of its modules, for a process of this run."""
    return pickle.dumps(([os.path.abspath(one) for one in sys.path], pickle_with_code(what)))


def unpack(content: bytes) -> Any:
    """Return what was given to `pack`; only for data that a process of this run has just packed."""
    folders, packed = pickle.loads(content)
    append_folders(folders)
    return pickle.loads(packed)


# --------------------------------------------------------------------------------------------------
# `multiprocessing` with new interpreters that import nothing from the current folder, as `python_command` does.


_changing = RLock()  # guards the environment


@contextmanager
def _safe_path() -> Iterator[None]:
    """Within the block, Python child processes import nothing from the current folder."""
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
    """Return the `multiprocessing` context whose new interpreters import nothing from the current folder."""
    with _safe_path():
        if sys.platform != "win32":
            resource_tracker.ensure_running()  # it starts a Python process too
    return _Context()
