"""What a session will be like, said before it begins; and which set-points a study that has begun goes on with."""

from __future__ import annotations

from typing import TYPE_CHECKING

from haptorb.apps.terminal import say

if TYPE_CHECKING:
    from sqlalchemy.engine import Engine

    from haptorb.apps.study.model.study_file import Study

__all__ = ["keep_stored_layout", "print_forecast"]


def print_forecast(known: Study) -> bool:
    """Say what a session will be like; whether the thermal budget holds."""
    from haptorb.apps.study.simulated.forecast import forecast, overlap

    found = forecast(known)
    say(("" if found.holds else "warning: ") + found.sentence)
    reach = overlap(known)
    if reach is not None:
        say("note: " + reach.sentence)
    return found.holds


def keep_stored_layout(engine: Engine, known: Study) -> Study:
    """`known`, or as the database holds it from a time when another layout was called published; said to people."""
    from haptorb.apps.study.store.columns import keep_layout

    study = keep_layout(engine, known)
    if study is not known:
        say("this study was begun with 1 + 8 + 8 + 8 set-points and goes on with them (erratum E17, withdrawn)")
    return study
