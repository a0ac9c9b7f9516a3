"""What made a recording: versions of everything that computes, and the processor."""

from __future__ import annotations

import platform
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version

from haptorb.version import __version__

__all__ = ["describe_machine", "list_versions"]

_COMPUTING = ("numpy", "numba", "llvmlite", "mujoco")


@cache
def list_versions() -> dict[str, str]:
    """Package → version, of those that are there.

    >>> list_versions()["haptorb"] == __version__
    True
    """
    found = {"haptorb": __version__, "python": platform.python_version()}
    for name in _COMPUTING:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


@cache
def describe_machine() -> dict[str, str]:
    """The processor: kernels are compiled for the one that is there."""
    model = ""
    with suppress(OSError), open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
        model = next((line.partition(":")[2].strip() for line in file if line.startswith("model name")), "")
    return {"processor": model or platform.processor() or platform.machine()}
