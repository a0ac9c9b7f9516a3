"""Recordings of a study: file names by study, session and first trial, and look-up by trial."""

from __future__ import annotations

import os
import re
from pathlib import Path

from haptorb.database_address import path_of
from haptorb_study.stored_session import StoredSession

__all__ = ["find_recording_path", "folder_of", "locate_recording", "name_parts", "name_recording"]

_NAME = re.compile(r"(?P<study>.+)-session-(?P<session>[0-9]+)-trial-(?P<trial>[0-9]+)(-[0-9]+)?")


def folder_of(place: str | Path) -> Path:
    """Folder of the recordings of the database at `place`: beside its file, or for a server the current folder."""
    path = path_of(place)
    return Path() if path is None else path.parent


def name_recording(folder: Path, study: str, session: int, trial: int) -> Path:
    """Unused file name in `folder` for a recording of `session` that begins with `trial`, from 1."""
    path = folder / f"{study}-session-{session}-trial-{trial}.mcap"
    number = 2
    while os.path.lexists(path):  # a link is no free name, wherever it leads
        path = folder / f"{study}-session-{session}-trial-{trial}-{number}.mcap"
        number += 1
    return path


def find_recording_path(place: str | Path, session: StoredSession) -> Path:
    """Unused path for a recording of `session` from its next trial on, for the database at `place`."""
    return name_recording(folder_of(place), session.study.name, session.id, session.number + 1)


def name_parts(recording: Path) -> dict[str, str]:
    """Session and first trial from the name of a recording; empty for other names.

    >>> name_parts(Path("dome-session-3-trial-12.mcap"))
    {'session': '3', 'first_trial': '12'}
    """
    found = _NAME.fullmatch(recording.stem)
    return {} if found is None else {"session": found["session"], "first_trial": found["trial"]}


_GIVEN = re.compile(r"(.+-)?session-[0-9]+(-.*)?\.mcap", re.DOTALL)


def locate_recording(folder: Path, part: str) -> Path | None:
    """File of a trial's `part` (FILE#t=FROM,TO) of a recording, in the `folder` of its database; None for a name that
    haptorb does not give to recordings. It is copied and deleted, and a stranger may have written the database.

    >>> locate_recording(Path("a"), "b/dome-session-3-trial-12.mcap#t=0,1").as_posix()
    'a/dome-session-3-trial-12.mcap'
    >>> locate_recording(Path("a"), "/elsewhere/thesis.tex")
    """
    # Older versions stored the path relative to the folder in which the session was started.
    name = Path(part.partition("#t=")[0]).name
    return folder / name if _GIVEN.fullmatch(name) else None  # safety: recording-own-name
