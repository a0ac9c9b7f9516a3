"""One experimenter per session."""

from __future__ import annotations

from sqlalchemy.engine import Engine

from haptorb.apps.study.store.database import FAMILY
from haptorb.errors import RecordingError
from haptorb.files.program_lock import ProgramLock

__all__ = ["lock_session"]


def lock_session(engine: Engine, session: int) -> ProgramLock:
    """The session's lock, held until it is released; RecordingError if another program holds it."""
    conflict = RecordingError(
        f"session {session} is being run by another experimenter (or another window): end that one first"
    )
    return ProgramLock(engine, FAMILY, session, f".session-{session}.lock", conflict)
