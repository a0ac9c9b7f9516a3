"""One program at a time: a lock that the operating system, or PostgreSQL, releases when its holder ends."""

from __future__ import annotations

import os
import sqlite3
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self, final

from sqlalchemy import text
from sqlalchemy.engine import Connection, Engine

from haptorb.errors import RecordingError

__all__ = ["ProgramLock"]

_TRIES = 20  #: to lock a file that others remove meanwhile


@final
class ProgramLock:
    """Held in a `with` block, or until `release`; `conflict` if another program holds it.

    family, number  what is locked in a PostgreSQL database
    end             what is locked beside a SQLite file: a file whose name is that file's and this end

    A killed process loses it at once, so that its work can be resumed without waiting for anything. The file is
    removed on release; one that a killed process left is removed by the next holder.
    """

    def __init__(self, engine: Engine, family: int, number: int, end: str, conflict: RecordingError) -> None:
        self._file: sqlite3.Connection | None = None
        self._path = Path(f"{engine.url.database}{end}")
        self._connection: Connection | None = None
        if engine.dialect.name == "sqlite":
            self._file = _lock_file(self._path, conflict)
        else:
            self._connection = engine.connect()
            lock = text("SELECT pg_try_advisory_lock(:family, :number)")
            held = self._connection.execute(lock, {"family": family, "number": number}).scalar_one()
            self._connection.commit()
            if not held:
                self._connection.close()
                raise conflict

    def release(self) -> None:
        """Give it back; may be called twice."""
        if self._file is not None:
            with suppress(
                OSError
            ):  # while it is locked: who opened it meanwhile sees that it is another file's name now
                self._path.unlink()
            self._file.close()
            self._file = None
        if self._connection is not None:
            self._connection.invalidate()  # the lock belongs to the connection, which a pool would keep
            self._connection.close()
            self._connection = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.release()


def _lock_file(path: Path, conflict: RecordingError) -> sqlite3.Connection:
    """Holds the empty file `path` until it is closed. Raises `conflict`, or RecordingError if it cannot be made.

    SQLite knows how each operating system locks files.
    """
    if path.is_symlink() or (path.exists() and not path.is_file()):
        raise RecordingError(f"{path} is not a regular file, so nothing can be locked by it: remove it")
    tries = 0
    while True:
        tries += 1
        file = None
        try:
            with suppress(FileExistsError):  # no more than this: who closes the file loses what it locked in it
                os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600))
            before = _identify(path)
            file = sqlite3.connect(path, timeout=0.0, isolation_level=None, check_same_thread=False)
            file.execute("BEGIN EXCLUSIVE")
            if before is not None and before == _identify(path):
                return file
            file.close()  # its last holder removed it between the two: what is locked has no name any more
        except (OSError, sqlite3.Error) as cause:
            if file is not None:
                file.close()
            if isinstance(cause, sqlite3.Error) and cause.sqlite_errorcode == sqlite3.SQLITE_BUSY:
                raise conflict from cause
            if isinstance(cause, sqlite3.Error) and tries < _TRIES:
                continue  # its last holder removed it while SQLite opened it
            raise RecordingError(f"{path} cannot be locked: {cause}") from cause


def _identify(path: Path) -> tuple[int, int, int] | None:
    """Which file has this name now; None: none has."""
    try:
        status = path.stat()
    except FileNotFoundError:
        return None
    return status.st_dev, status.st_ino, status.st_ctime_ns
