"""The codes that are taken in a study's database, and one that is free, for the experimenter's page."""

from __future__ import annotations

from typing import Any, final

from sqlalchemy.engine import Engine

from haptorb.apps.study.model.codes import next_code
from haptorb.apps.study.model.study_file import Study
from haptorb.apps.study.store.people import list_participants

__all__ = ["CodeList"]


@final
class CodeList:
    """What was known when `refresh` last ran; the pages read it, the sessions' thread refreshes it."""

    def __init__(self, engine: Engine, study: Study) -> None:
        self._engine, self._study = engine, study
        self.taken: tuple[dict[str, Any], ...] = ()  #: code, state, answered; people only
        self.free = ""  #: a code that is free; empty: not known

    def refresh(self) -> None:
        """Ask the database."""
        people = list_participants(self._engine, self._study)
        self.taken = tuple(
            {"code": one.code, "state": one.state, "answered": one.answered} for one in people if not one.simulated
        )
        self.free = next_code(one.code for one in people)
