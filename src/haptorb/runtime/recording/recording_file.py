"""The file that a recording goes to, opened before anything starts: refused now, or never."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from haptorb.errors import RecordingError
from haptorb.runtime.realtime.stale_files import RECORDING, FileLock

__all__ = ["complete", "create_recording", "create_temporary"]

_FLAGS = os.O_WRONLY | os.O_CREAT | os.O_EXCL


def create_recording(path: Path, *, overwrite: bool) -> int:
    """A descriptor of the new, empty file `path`, write-protected for others until the recording is complete.

    Raises RecordingError if it exists and `overwrite` is not set, or if it cannot be written.
    """
    try:
        if path.is_dir():
            raise RecordingError(f"cannot record to {path}: it is a folder; name a file in it")
        if path.exists() and not overwrite:
            text = f"{path} exists; choose another name, or replace it"
            raise RecordingError(f"{text} with overwrite=True", command=f"{text} with --force")
        if overwrite and path.exists():
            if not path.is_file():
                raise RecordingError(f"cannot record to {path}: it is not a regular file")
            path.unlink()
        return os.open(path, _FLAGS, 0o444)
    except OSError as cause:
        raise RecordingError(f"cannot record to {path}: {cause.strerror}; choose another folder") from cause
    except ValueError as cause:  # a zero byte in its name
        raise RecordingError(f"cannot record to {str(path)!r}: not the name of a file; choose another") from cause


def complete(descriptor: int, *, temporary: bool) -> None:
    """Lift the write protection of a recording that is whole: as any file that the user makes, and no more than that.

    What others may read is for the user's umask to say; a `create_temporary` file stays its owner's alone.
    """
    mask = os.umask(0o077)
    os.umask(mask)
    os.fchmod(descriptor, 0o600 if temporary else 0o666 & ~mask)  # safety: recording-mode


def create_temporary() -> tuple[Path, int, FileLock]:
    """(path, descriptor, claim) of a new file in the system's temporary folder, which is ours while the claim is held.

    Raises RecordingError if none can be made there.
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
