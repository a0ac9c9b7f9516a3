"""One experimenter per session: a claim that the operating system, or PostgreSQL, takes back from whoever dies."""

from __future__ import annotations

import os
import sqlite3
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self, final

from sqlalchemy import text
from sqlalchemy.engine import Connection, Engine

from haptorb.apps.study.store.database import FAMILY
from haptorb.errors import RecordingError

__all__ = ["SessionLock"]


@final
class SessionLock:
    """Held in a `with` block, or until `release`; RecordingError if somebody else holds it.

    A killed process loses it at once, so that the session can be resumed without waiting for anything.
    """

    def __init__(self, engine: Engine, session: int) -> None:
        self._file: sqlite3.Connection | None = None
        self._connection: Connection | None = None
        conflict = RecordingError(
            f"session {session} is being run by another experimenter (or another window): end that one first"
        )
        if engine.dialect.name == "sqlite":
            self._file = _lock_file(Path(f"{engine.url.database}.session-{session}.lock"), conflict)
        else:
            self._connection = engine.connect()
            lock = text("SELECT pg_try_advisory_lock(:family, :session)")
            held = self._connection.execute(lock, {"family": FAMILY, "session": session}).scalar_one()
            self._connection.commit()
            if not held:
                self._connection.close()
                raise conflict

    def release(self) -> None:
        """Give it back; may be called twice. The empty file stays: removing it would race with the next claim."""
        if self._file is not None:
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
    file = None
    try:
        with suppress(FileExistsError):  # no more than this: who closes the file loses what it locked in it
            os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600))
        file = sqlite3.connect(path, timeout=0.0, isolation_level=None, check_same_thread=False)
        file.execute("BEGIN EXCLUSIVE")
    except (OSError, sqlite3.Error) as cause:
        if file is not None:
            file.close()
        if isinstance(cause, sqlite3.Error) and cause.sqlite_errorcode == sqlite3.SQLITE_BUSY:
            raise conflict from cause
        raise RecordingError(f"{path} cannot be locked for this session: {cause}") from cause
    return file
