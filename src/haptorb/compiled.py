"""Compilation of kernels: one decorator, and a cache that detects changed sources.

A kernel is compiled once per machine and kept under the user's cache folder. numba looks only at the file that holds
a kernel, not at the kernels that it calls; so each file's kernels are stored in a folder named after the digest of that
file and of all files of the package that it imports, directly or indirectly. A change elsewhere causes no
recompilation.

Loading numba takes most of a second, and reading a device file does not need it. Until the first call, every kernel is
a `PostponedKernel`; that call loads numba and replaces all of them by compiled functions. A process with deadlines
calls `load_compiler` before it starts.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, update_wrapper
from pathlib import Path
from threading import local
from typing import Any, TypeVar, cast, final

import numpy as np
from numpy.typing import ArrayLike

from haptorb._numba_patches import compile_function, find_version, is_patched, load_numba
from haptorb.arrays import Array
from haptorb.cache_folder import explain_shared, private_folder

__all__ = [
    "PostponedKernel",
    "UncompiledKernelError",
    "exact_kernel",
    "forbid_compiling",
    "has_cached_code",
    "kernel",
    "load_compiler",
    "on_compiling",
    "pack",
    "part",
    "tick_kernel",
    "vector_kernel",
]


# --------------------------------------------------------------------------------------------------
# Control of compilation: where it is forbidden, a kernel missing in the cache is reported instead.
#
# A running servo must not compile; it may load kernels that another process has compiled.


_thread = local()  # `missing`: names of kernels, where compilation is forbidden
_listeners: list[Callable[[], object]] = []


class UncompiledKernelError(Exception):
    """A kernel is not in the cache while `forbid_compiling` is active."""


def on_compiling(callback: Callable[[], object]) -> None:
    """Register `callback`, called whenever this process begins to compile a kernel that is not in the cache."""
    _listeners.append(callback)


@contextmanager
def forbid_compiling() -> Iterator[list[str]]:
    """In this thread, load kernels from the cache only; a missing one raises UncompiledKernelError when called.

    Yields the names of the missing kernels: a caller that catches all exceptions, as a tick does, hides the error.
    """
    before, _thread.missing = getattr(_thread, "missing", None), list[str]()
    try:
        yield _thread.missing
    finally:
        _thread.missing = before


@cache
def _watch_compiling() -> None:
    """Check the permission of every kernel of the package before compilation. Kernels in the cache are loaded."""
    from numba.core.event import Event, Listener, register

    class Permission(Listener):  # type: ignore[misc]
        def on_start(self, event: Event) -> None:
            function = getattr(event.data["dispatcher"], "py_func", None)  # a loop lifted by numba has none
            if function is None or not _is_ours(function):
                return
            missing: list[str] | None = getattr(_thread, "missing", None)
            if missing is not None:
                name = f"{function.__module__}.{function.__qualname__}"
                missing.append(name)
                raise UncompiledKernelError(f"kernel '{name}' is not compiled yet")
            for callback in _listeners:
                callback()

        def on_end(self, event: Event) -> None:
            pass

    register("numba:compile", Permission())


_PACKAGE = Path(__file__).resolve().parent
_MAX_KEPT_VERSIONS = 4  #: number of compiled versions of a file in the cache, for users who switch branches
_IMPORT = re.compile(r"^\s*from haptorb((?:\.\w+)*) import (\([^)]*\)|[^\n]*)", re.MULTILINE)

Function = TypeVar("Function", bound=Callable[..., Any])


def _trace_imports(source: str) -> Iterator[Path]:
    for dotted, names in _IMPORT.findall(source):
        place = _PACKAGE.joinpath(*dotted.split(".")[1:])
        if place.with_suffix(".py").is_file():
            yield place.with_suffix(".py")
            continue
        yield place / "__init__.py"
        for name in re.findall(r"\w+", names):
            if (place / f"{name}.py").is_file():
                yield place / f"{name}.py"


@cache
def _neighbours(path: Path) -> tuple[bytes, tuple[Path, ...]]:
    source = path.read_bytes()
    return hashlib.sha256(source).digest(), tuple(_trace_imports(source.decode("utf-8")))


@cache
def _digest_sources(path: Path) -> bytes:
    """Return a digest of `path` and of all files of the package that it imports; empty for other files.

    Computed when the file's first kernel is declared: a source edited between that and the first call must not be
    mistaken for the compiled one.
    """
    if not path.is_relative_to(_PACKAGE):
        return b""
    digests: dict[Path, bytes] = {}
    waiting = [path]
    while waiting:
        file = waiting.pop()
        if file not in digests:
            digests[file], others = _neighbours(file)
            waiting.extend(others)
    digest = hashlib.sha256()
    for file in sorted(digests):
        digest.update(file.relative_to(_PACKAGE).as_posix().encode() + digests[file])
    return digest.digest()


@cache
def _folder(path: Path) -> str:
    """Cache folder of the kernels of the file `path`, private to this account; "" if there is none.

    numba would use the folder of the file: whoever can write there could have code executed.
    """
    try:
        chosen = _chosen_folder()
        if chosen:
            return chosen
        if path.is_relative_to(_PACKAGE):
            parts = (".".join(path.relative_to(_PACKAGE).with_suffix("").parts), _name_state(path))
        else:
            parts = ("other", hashlib.sha256(str(path).encode()).hexdigest()[:16])
        folder = private_folder("kernels", *parts)
        folder.touch()
        old = sorted(folder.parent.iterdir(), key=lambda entry: entry.stat().st_mtime)[:-_MAX_KEPT_VERSIONS]
    except OSError:
        return ""
    if path.is_relative_to(_PACKAGE):
        for entry in old:
            shutil.rmtree(entry, ignore_errors=True)
    return str(folder)


def has_cached_code(function: Callable[..., Any]) -> bool:
    """Whether the cache has code of the kernel `function`, or of another one in its file, in its present state.

    True without a cache: nobody can put code there.
    """
    folder = _folder(_find_source(getattr(function, "__wrapped__", function)))
    return not folder or any(Path(folder).rglob("*.nbi"))


def _name_state(path: Path) -> str:
    version = find_version()
    plain = b"" if is_patched(version) else b"plain"
    return hashlib.sha256(version.encode() + plain + _digest_sources(path)).hexdigest()[:16]


@cache
def _chosen_folder() -> str:
    """NUMBA_CACHE_DIR of the user; "" if it is not set, or if others can write there."""
    chosen = os.environ.get("NUMBA_CACHE_DIR", "")
    if not chosen:
        return ""
    with suppress(OSError):
        Path(chosen).mkdir(mode=0o700, parents=True, exist_ok=True)
    shared = explain_shared(Path(chosen))
    if shared:
        os.environ.pop("NUMBA_CACHE_DIR")  # numba would also execute it for other programs' kernels, in child processes
        print(f"haptorb: NUMBA_CACHE_DIR {chosen} is not used: it {shared}", file=sys.stderr)
        return ""
    return chosen


def _find_source(function: Callable[..., Any]) -> Path:
    return Path(function.__code__.co_filename).resolve()


def _is_ours(function: Callable[..., Any]) -> bool:
    source = Path(function.__code__.co_filename)  # interactive code has no file: "<stdin>"
    return source.is_absolute() and source.resolve().is_relative_to(_PACKAGE)


def _dispatcher(function: Callable[..., Any], options: dict[str, bool]) -> Any:
    """Return numba's dispatcher, which compiles `function` for each new combination of types."""
    load_numba()
    _watch_compiling()
    return compile_function(function, _folder(_find_source(function)), **options)


@final
class PostponedKernel:
    """Placeholder of a kernel until the first call. Other kernels may call it: numba receives the compiled function."""

    def __init__(self, function: Callable[..., Any], options: dict[str, bool] | None = None) -> None:
        update_wrapper(self, function)
        self._function, self._options = function, options or {}
        self._compiled: Any = None
        with suppress(OSError):
            _digest_sources(_find_source(function))

    @property
    def compiled(self) -> Any:
        """numba's dispatcher of the function, created at the first use."""
        if self._compiled is None:
            self._compiled = _dispatcher(self._function, self._options)
        return self._compiled

    @property
    def _numba_type_(self) -> Any:
        """The type of the compiled function, which numba asks each global of a kernel for, undocumented.

        So it is in every version, patched or not; without it, numba would be loaded and every kernel made as soon as a
        module is imported.
        """
        return self.compiled._numba_type_

    def __call__(self, *args: Any) -> Any:
        """Load numba for all kernels, and call this one. Shapes and units [1] are the function's own."""
        load_compiler()
        return self.compiled(*args)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # inspection of the object must not load a compiler
            raise AttributeError(name)
        return getattr(self.compiled, name)

    def __reduce__(self) -> Any:
        return self.compiled.__reduce__()


_POSTPONED: list[PostponedKernel] = []


def load_compiler() -> None:
    """Load numba, and replace the placeholders in every module of haptorb by compiled functions."""
    load_numba()
    if not _POSTPONED:
        return
    holders = {postponed.__module__ for postponed in _POSTPONED}
    _POSTPONED.clear()  # modules imported from here on receive compiled functions at once
    for name, module in list(sys.modules.items()):
        if name not in holders and name.partition(".")[0] != "haptorb":
            continue
        for key, value in list(vars(module).items()):
            if type(value) is PostponedKernel:
                setattr(module, key, value.compiled)


def _compile(function: Function, **options: bool) -> Function:
    if "numba" in sys.modules:
        return cast(Function, _dispatcher(function, options))
    postponed = PostponedKernel(function, options)
    _POSTPONED.append(postponed)
    return cast(Function, postponed)


def kernel(function: Function) -> Function:
    """Compile `function` for numbers only: no Python objects, no interpreter lock, sums may be reordered.

    Reordering and fused multiply-add are allowed; assuming away NaN is not: the guard must see every NaN.
    """
    return _compile(function)


def vector_kernel(function: Function) -> Function:
    """Compile a `kernel` with vectorised loops: for loops over many numbers, as compilation takes longer."""
    return _compile(function, vectors=True)


def exact_kernel(function: Function) -> Function:
    """Compile a `kernel` in which operations are neither reordered nor fused: the same bits on every processor.

    For iterations whose number of steps depends on rounding: reordering may change more than the last digit.
    """
    return _compile(function, exact=True)


def tick_kernel(function: Function) -> Function:
    """Compile a `kernel` that Python calls in every tick: it creates and returns no array, and takes microseconds.

    Therefore references are not counted, which halves the time of a call, and the interpreter lock is kept: reacquiring
    it may take longer than the kernel.
    """
    return _compile(function, brief=True)


# --------------------------------------------------------------------------------------------------
# Packing of arrays into one: a call into compiled code with one array instead of a dozen is a microsecond faster.
#
# numba inspects every array that Python passes in every call, and each is at another memory address.


_HEAD = 3  #: header entries per array: offset, rows, columns


def pack(*parts: ArrayLike) -> Array:
    """Pack all `parts` (…, columns) into one array (n,), each as rows of its last axis, after a table of their offsets.
    Units are unchanged.

    >>> part(pack([1.0, 2.0], [[3.0], [4.0]]), 1).tolist()
    [[3.0], [4.0]]
    """
    arrays = [np.atleast_2d(np.asarray(item, dtype=np.float64)) for item in parts]
    rows = [array.reshape(-1, array.shape[-1]) for array in arrays]
    starts = _HEAD * len(rows) + np.cumsum([0, *(array.size for array in rows)])
    head = [(start, *array.shape) for start, array in zip(starts.tolist(), rows, strict=False)]
    return np.concatenate([np.ravel(np.array(head, dtype=np.float64)), *(array.ravel() for array in rows)])


@kernel
def part(blob: Array, number: int) -> Array:
    """Return part `number` (rows, columns) of a packed array: a view, in the part's own unit."""
    start, rows, columns = int(blob[3 * number]), int(blob[3 * number + 1]), int(blob[3 * number + 2])
    view: Array = blob[start : start + rows * columns].reshape((rows, columns))
    return view
