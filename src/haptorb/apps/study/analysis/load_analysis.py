"""From a database to its analysis, in one call."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from haptorb.apps.study.analysis.analysis import Analysis, analyse
from haptorb.apps.study.store.columns import read_study, tidy
from haptorb.apps.study.store.database import database

__all__ = ["analysis_of"]


def analysis_of(
    place: str | Path, name: str | None = None, progress: Callable[[int, int], None] | None = None
) -> Analysis:
    """The analysis of the study called `name` (the only one, if there is one) in the database at `place`.

    `progress` is told (people fitted, people in all), where something is fitted.
    """
    engine = database(place, make=False)
    study = read_study(engine, name)
    return analyse(study, tidy(engine, study), progress)
