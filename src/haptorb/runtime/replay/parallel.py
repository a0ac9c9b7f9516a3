"""A recording in several parts at once, each in a process of its own, from a state that the loop has kept."""

from __future__ import annotations

import multiprocessing
import os
import warnings
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from haptorb.runtime.recording.recording import Recording
from haptorb.runtime.replay.comparison import RunComparison
from haptorb.runtime.replay.kept_states import choose_beginnings
from haptorb.runtime.replay.played_rows import PlayedRows
from haptorb.runtime.replay.replay import Replay

__all__ = ["replay_in_parts"]

_WORTH = 8192  #: ticks of a part: below, a process of its own takes longer than it saves


def replay_in_parts(
    recording: Recording, report: Callable[[int], None] = lambda ticks: None, *, recorded_world: bool = False
) -> Replay:
    """`recording` replayed, on as many processors as this process may use; as `Replay.run` would.

    `report` is told how many ticks are done. Raises RecordingError as `Replay` does.
    """
    rows = PlayedRows(recording)
    ticks = rows.ticks
    most = max(min(len(os.sched_getaffinity(0)), len(ticks) // _WORTH), 1)
    beginnings = choose_beginnings(recording, ticks, most) if most > 1 else [0]
    ends = [*(first + 1 for first in beginnings[1:]), len(ticks)]
    parts = list(zip(beginnings, ends, strict=True))
    main = Replay(recording, recorded_world=recorded_world, part=parts[0] if most > 1 else None, rows=rows)
    # What the first chain has loaded, and has had compiled, is there for the others, too.
    others = [_Worker(recording, part, rows, recorded_world=recorded_world) for part in parts[1:]]
    share = len(ticks) / parts[0][1]
    main.run(lambda done: report(min(round(done * share), len(ticks))))
    for worker in others:
        comparison, remarks = worker.finish()
        main.comparison.merge(comparison)
        main.remarks += [remark for remark in remarks if remark not in main.remarks]
    return main


class _Worker:
    """A process that replays one part. If it dies, its part is replayed here."""

    def __init__(self, recording: Recording, part: tuple[int, int], rows: PlayedRows, *, recorded_world: bool) -> None:
        self._recording, self._part, self._rows, self._recorded_world = recording, part, rows, recorded_world
        context = multiprocessing.get_context("fork")
        self._answer, there = context.Pipe(duplex=False)
        self._process = context.Process(target=self._work, args=(there,), daemon=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # other threads: the child only computes
            self._process.start()
        there.close()

    def _replay(self) -> tuple[RunComparison, list[str]]:
        replay = Replay(self._recording, recorded_world=self._recorded_world, part=self._part, rows=self._rows)
        return replay.run(), replay.remarks

    def _work(self, there: Connection) -> None:
        there.send(self._replay())

    def finish(self) -> tuple[RunComparison, list[str]]:
        """What it has found, when it has."""
        try:
            found: Any = self._answer.recv()
        except EOFError:
            return self._replay()
        self._process.join()
        comparison, remarks = found
        return comparison, remarks
