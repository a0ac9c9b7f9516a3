"""What a session will be like, said before it begins."""

from __future__ import annotations

from typing import TYPE_CHECKING

from haptorb.apps.terminal import say

if TYPE_CHECKING:
    from haptorb.apps.study.model.study_file import Study

__all__ = ["print_forecast"]


def print_forecast(known: Study) -> bool:
    """Say what a session will be like; whether the thermal budget holds."""
    from haptorb.apps.study.simulated.forecast import forecast, overlap

    told = forecast(known)
    say(("" if told.holds else "warning: ") + told.sentence)
    reach = overlap(known)
    if reach is not None:
        say("note: " + reach.sentence)
    return told.holds
