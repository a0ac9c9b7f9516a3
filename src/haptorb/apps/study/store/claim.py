"""One experimenter per session: a claim that the operating system, or PostgreSQL, takes back from whoever dies."""

from __future__ import annotations

import fcntl
import os
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
        self._descriptor: int | None = None
        self._connection: Connection | None = None
        taken = RecordingError(
            f"session {session} is being run by another experimenter (or another window): end that one first"
        )
        if engine.dialect.name == "sqlite":
            path = Path(f"{engine.url.database}.session-{session}.lock")
            self._descriptor = os.open(path, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
            try:
                fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as cause:
                os.close(self._descriptor)
                raise taken from cause
        else:
            self._connection = engine.connect()
            lock = text("SELECT pg_try_advisory_lock(:family, :session)")
            held = self._connection.execute(lock, {"family": FAMILY, "session": session}).scalar_one()
            self._connection.commit()
            if not held:
                self._connection.close()
                raise taken

    def release(self) -> None:
        """Give it back; may be called twice. The empty file stays: removing it would race with the next claim."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None
        if self._connection is not None:
            self._connection.invalidate()  # the lock belongs to the connection, which a pool would keep
            self._connection.close()
            self._connection = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.release()
