"""Candidates stored as they are computed, with a bar: the best so far, the refused share, the time left."""

from __future__ import annotations

import time
from collections.abc import Iterable

from haptorb.apps.design.tally import Tally
from haptorb.apps.terminal import make_progress
from haptorb.design.design import Design
from haptorb.design.evaluation import Evaluation
from haptorb.design.store import ResultsWriter

__all__ = ["keep_candidates"]

_BATCH = 200  #: candidates that are stored together at most
_PERIOD = 1.0  #: between two times of storing [s]


def keep_candidates(writer: ResultsWriter, found: Iterable[Evaluation], design: Design, total: int) -> Tally:
    """Store the candidates `found` in a run of `total`; returns the tally, together with what was stored before.

    If it ends early, also by ^C, what was computed until then is stored.
    """
    known = [one for number, one in writer.list_known().items() if number < total]
    tally = Tally(design, known)
    waiting: list[Evaluation] = []
    last = time.monotonic()
    with make_progress() as bar:
        task = bar.add_task(tally.short or "first designs", total=total, completed=len(known))
        try:
            for one in found:
                waiting.append(one)
                tally.add(one)
                now = time.monotonic()
                if now - last >= _PERIOD or len(waiting) >= _BATCH:
                    writer.add(waiting)
                    waiting.clear()
                    last = now
                bar.update(task, completed=tally.count, description=tally.short)
        finally:
            writer.add(waiting)
    return tally
