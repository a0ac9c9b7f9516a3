"""Where a run is recorded to: a named file, a temporary one that its holder removes, or nowhere."""

from __future__ import annotations

import weakref
from pathlib import Path
from typing import TYPE_CHECKING, Literal, final

from haptorb.errors import RecordingError
from haptorb.runtime.realtime.stale_files import FileLock
from haptorb.runtime.recording import recording_file

if TYPE_CHECKING:
    from haptorb.runtime.recording.recording import Recording

__all__ = ["RunRecording"]


@final
class RunRecording:
    """`where`: the file; None: a temporary one; False: nowhere. `overwrite`: whether the file may be replaced."""

    def __init__(self, where: str | Path | Literal[False] | None, *, overwrite: bool) -> None:
        self._where, self._overwrite = where, overwrite
        self._path: Path | None = None
        self._claim: FileLock | None = None

    @property
    def user_path(self) -> str | None:
        """The named file, once it exists; None for a temporary one or none."""
        return str(self._path) if self._where and self._path else None

    @property
    def temporary_path(self) -> Path | None:
        """The temporary file, once it is there."""
        return self._path if self._where is None else None

    def open(self) -> int | None:
        """A descriptor of the new, empty file; None for nowhere. Raises RecordingError."""
        if self._where is False:
            return None
        if self._where is None:
            self._path, descriptor, self._claim = recording_file.create_temporary()
            weakref.finalize(self, self._path.unlink, missing_ok=True)
            return descriptor
        path = Path(self._where).expanduser().absolute()
        descriptor = recording_file.create_recording(path, overwrite=self._overwrite)
        self._path = path
        return descriptor

    def discard(self) -> None:
        """Nothing ran: leave no file."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)

    def read(self) -> Recording:
        """What was recorded up to now. Raises RecordingError if nothing was recorded, or if the file cannot be read."""
        from haptorb.runtime.recording.recording import Recording

        if self._path is None:
            raise RecordingError("nothing was recorded: the servo was not started, or recording was off")
        return Recording(self._path)
