"""The forecast of a session, printed before it begins; and the settings with which a study continues."""

from __future__ import annotations

from typing import TYPE_CHECKING

from haptorb.apps.terminal import say

if TYPE_CHECKING:
    from sqlalchemy.engine import Engine

    from haptorb.apps.study.model.study_file import Study

__all__ = ["keep_begun_study", "print_forecast"]


def print_forecast(known: Study) -> bool:
    """Say what a session will be like; whether the thermal budget holds and every trial has something to feel."""
    from haptorb.apps.study.simulated.forecast import find_unfelt, forecast, overlap

    found = forecast(known)
    say(("" if found.holds else "warning: ") + found.sentence)
    reach = overlap(known)
    if reach is not None:
        say("note: " + reach.sentence)
    unfelt = find_unfelt(known)
    for one in unfelt:
        say("warning: " + one.sentence)
    return found.holds and not unfelt


def keep_begun_study(engine: Engine, known: Study) -> Study:
    """`known`, or as the database holds it from an older version, with its order and layout; said to people."""
    from haptorb.apps.study.store.columns import keep_older

    study = keep_older(engine, known)
    if known.order_version and not study.order_version:
        say("this study was begun with an older haptorb and keeps the order of that version")
    if study.published_layout != known.published_layout:
        say("this study was begun with 1 + 8 + 8 + 8 set-points and keeps them (erratum E17, withdrawn)")
    return study
