"""Destination of a recording: a named file, a temporary one that is deleted afterwards, or none."""

from __future__ import annotations

import os
import platform
import tempfile
import weakref
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Literal, final

from haptorb.errors import RecordingError
from haptorb.files import RECORDING, FileLock
from haptorb.version import __version__

if TYPE_CHECKING:
    from haptorb.recording.recording import Recording

__all__ = ["RunRecording", "complete", "create_recording", "create_temporary", "describe_machine", "list_versions"]


# --------------------------------------------------------------------------------------------------
# File of a recording. It is created before the servo starts, so that a file error occurs before the run.


_FLAGS = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
_MODE = 0o444 if os.name == "posix" else 0o666  # Windows: the recorder reopens the file by its name


def create_recording(path: Path, *, overwrite: Path | None) -> int:
    """Create the empty file `path`, write-protected until the recording is complete; return its descriptor.

    An existing file is moved to `overwrite`. Raises RecordingError if it exists and `overwrite` is None, or if it
    cannot be written; the existing file is then where it was.
    """
    try:
        if path.is_dir():
            raise RecordingError(f"cannot record to {path}: it is a folder; name a file in it")
        if path.exists() and overwrite is None:
            text = f"{path} exists; choose another name, or replace it"
            raise RecordingError(f"{text} with overwrite=True", command=f"{text} with --force")
        if overwrite is None or not path.exists():
            return os.open(path, _FLAGS, _MODE)
        if not path.is_file():
            raise RecordingError(f"cannot record to {path}: it is not a regular file")
        os.replace(path, overwrite)
        try:
            return os.open(path, _FLAGS, _MODE)
        except BaseException:
            os.replace(overwrite, path)
            raise
    except OSError as cause:
        raise RecordingError(f"cannot record to {path}: {cause.strerror}; choose another folder") from cause
    except ValueError as cause:  # a zero byte in its name
        raise RecordingError(f"cannot record to {str(path)!r}: not the name of a file; choose another") from cause


def complete(descriptor: int, *, temporary: bool) -> None:
    """Remove the write protection of a complete recording: set the permissions of an ordinary new file.

    The user's umask determines them; a file from `create_temporary` remains accessible to its owner only.
    """
    mask = os.umask(0o077)
    os.umask(mask)
    if not hasattr(os, "fchmod") or os.name != "posix":  # the file was never protected
        return
    os.fchmod(descriptor, 0o600 if temporary else 0o666 & ~mask)  # safety: recording-mode


def create_temporary() -> tuple[Path, int, FileLock]:
    """Create a file in the system's temporary folder; return (path, descriptor, lock).

    `haptorb.files.sweep` does not delete the file while the lock is held. Raises RecordingError if creation fails.
    """
    folder = Path(tempfile.gettempdir())
    while True:
        try:
            descriptor, name = tempfile.mkstemp(prefix="haptorb-", suffix=RECORDING, dir=folder)
        except OSError as cause:
            raise RecordingError(f"cannot record to {folder}: {cause.strerror}; name a file to record to") from cause
        claim = FileLock(name)
        if claim.there:
            return Path(name), descriptor, claim
        os.close(descriptor)  # another process removed it first


@final
class RunRecording:
    """Recording file of one run.

    where      path of the file; None: a temporary file; False: no recording
    overwrite  whether an existing file may be replaced
    """

    def __init__(self, where: str | Path | Literal[False] | None, *, overwrite: bool) -> None:
        self._where, self._overwrite = where, overwrite
        self._path: Path | None = None
        self._replaced: Path | None = None  #: the file of the same name from before, until the run has started
        self._claim: FileLock | None = None

    @property
    def user_path(self) -> str | None:
        """Path of the named file, once it exists; None for a temporary file or no recording."""
        return str(self._path) if self._where and self._path else None

    @property
    def temporary_path(self) -> Path | None:
        """Path of the temporary file, once it exists; None for a named file or no recording."""
        return self._path if self._where is None else None

    def open(self) -> int | None:
        """Create the file and return its descriptor; None for no recording. Raises RecordingError."""
        if self._where is False:
            return None
        if self._where is None:
            self._path, descriptor, self._claim = create_temporary()
            weakref.finalize(self, _remove, self._path)
            return descriptor
        path = Path(self._where).expanduser().absolute()
        aside = path.with_name(f".haptorb-{os.urandom(4).hex()}.old") if self._overwrite else None
        descriptor = create_recording(path, overwrite=aside)
        self._path, self._replaced = path, aside
        return descriptor

    @property
    def path(self) -> Path | None:
        """Path of the file, once it exists."""
        return self._path

    def keep(self) -> None:
        """The run has started: delete the file that this one replaces."""
        if self._replaced is not None:
            _remove(self._replaced)
            self._replaced = None

    def discard(self) -> None:
        """Delete the file of a run that failed to start; the file that it was to replace is back."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)
            if self._replaced is not None and self._replaced.exists():
                os.replace(self._replaced, self._path)
            self._replaced = None

    def read(self) -> Recording:
        """Read the recording so far. Raises RecordingError if nothing was recorded, or if the file cannot be read."""
        from haptorb.recording.recording import Recording

        if self._path is None:
            raise RecordingError("nothing was recorded: the servo was not started, or recording was off")
        return Recording(self._path)


def _remove(path: Path) -> None:
    with suppress(OSError):  # Windows: the file is still open
        path.unlink(missing_ok=True)


# --------------------------------------------------------------------------------------------------
# Software versions and processor, for the metadata of a recording.


_COMPUTING = ("numpy", "numba", "llvmlite", "mujoco")


@cache
def list_versions() -> dict[str, str]:
    """Versions of haptorb, Python and the installed numerical packages, by name.

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
    """Processor model, because kernels are compiled for the processor of the computer."""
    model = ""
    with suppress(OSError), open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
        model = next((line.partition(":")[2].strip() for line in file if line.startswith("model name")), "")
    return {"processor": model or platform.processor() or platform.machine()}
