"""How kernels are compiled: one decorator, and a cache that notices changed sources.

A kernel is compiled once per machine and kept under the user's cache folder. numba looks only at the file that holds
a kernel, not at the kernels that it calls; so the cache folder is named after the state of all the package's sources.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

__all__ = ["cache_folder", "kernel"]

_PACKAGE = Path(__file__).resolve().parent.parent
_KEPT = 4  #: compiled versions kept beside each other, for people who switch branches

Function = TypeVar("Function", bound=Callable[..., Any])


def cache_folder() -> Path:
    """Folder for everything that can be computed again: $XDG_CACHE_HOME/haptorb, else ~/.cache/haptorb."""
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return Path(home) / "haptorb"


def _sources_key() -> str:
    digest = hashlib.sha256(f"{numba.__version__}".encode())
    for room in ("physics", "devices", "sensing", "control", "worlds", "simulation", "runtime"):
        for path in sorted((_PACKAGE / room).glob("*.py")):
            stat = path.stat()
            digest.update(f"{path.name} {stat.st_size} {stat.st_mtime_ns}".encode())
    return digest.hexdigest()[:16]


def _choose_folder() -> None:
    if os.environ.get("NUMBA_CACHE_DIR"):
        return
    root = cache_folder() / "kernels"
    folder = root / _sources_key()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        folder.touch()
        old = sorted(root.iterdir(), key=lambda path: path.stat().st_mtime)[:-_KEPT]
    except OSError:
        return  # a read-only home: numba falls back to its own choice
    for path in old:
        shutil.rmtree(path, ignore_errors=True)
    setattr(numba.config, "CACHE_DIR", str(folder))  # noqa: B010 (set by numba itself at run time)


_choose_folder()


def kernel(function: Function) -> Function:
    """Compile `function` for numbers only: no Python objects, no interpreter lock, sums may be reordered.

    Reordering and fused multiply-add are allowed; assuming away NaN is not: the guard must see every NaN.
    """
    compile = numba.njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
    return cast(Function, compile(function))
