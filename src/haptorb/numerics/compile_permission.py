"""Whether kernels may be compiled: where they may not, one that lies in no cache is named instead.

A servo that runs must not compile; it may load what another process has compiled.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import local
from typing import Any

__all__ = ["UncompiledKernelError", "forbid_compiling", "tell_compiling", "watch_compiling"]

_thread = local()  # `missing`: names of kernels, where compiling is forbidden
_listeners: list[Callable[[], object]] = []


class UncompiledKernelError(Exception):
    """A kernel lies in no cache, where `forbid_compiling` holds."""


def tell_compiling(tell: Callable[[], object]) -> None:
    """Have `tell` called whenever this process begins to compile a kernel that lies in no cache."""
    _listeners.append(tell)


@contextmanager
def forbid_compiling() -> Iterator[list[str]]:
    """In this thread a kernel comes out of the cache, or raises UncompiledKernelError when it is called.

    Yields the names of those that did: who catches everything, as a tick does, swallows the exception.
    """
    before, _thread.missing = getattr(_thread, "missing", None), list[str]()
    try:
        yield _thread.missing
    finally:
        _thread.missing = before


def watch_compiling(compiled: Any) -> None:
    """Have `compiled`, a dispatcher, ask first whether it may compile. What lies in the cache it loads as ever."""
    compiler = compiled._compiler
    compile_now, name = compiler.compile, f"{compiled.py_func.__module__}.{compiled.py_func.__qualname__}"

    def compile_if_allowed(args: Any, return_type: Any) -> Any:
        missing: list[str] | None = getattr(_thread, "missing", None)
        if missing is not None:
            missing.append(name)
            raise UncompiledKernelError(f"kernel '{name}' is not compiled yet")
        for tell in _listeners:
            tell()
        return compile_now(args, return_type)

    compiler.compile = compile_if_allowed
