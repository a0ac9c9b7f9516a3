"""Parallel replay of a recording in parts, each in its own process, from a recorded state of the loop."""

from __future__ import annotations

from collections.abc import Callable
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

from haptorb.recording.recording import Recording
from haptorb.replay.replay import Replay, RunComparison, choose_beginnings
from haptorb.replay.rows import PlayedRows, count_processors, start_child

__all__ = ["replay_in_parts"]

_MIN_TICKS = 8192  #: shortest part for which a separate process saves time [ticks]


def replay_in_parts(
    recording: Recording, report: Callable[[int], None] = lambda ticks: None, *, recorded_world: bool = False
) -> Replay:
    """Replay `recording` on all processors available to this process, with the result of `Replay.run`.

    `report` receives the number of ticks done. Raises RecordingError as `Replay` does.
    """
    rows, count = PlayedRows(recording), len(recording)
    most = max(min(count_processors(), count // _MIN_TICKS), 1)
    if most > 1:
        rows.unpack_beside()
    beginnings = choose_beginnings(recording, most)
    ends = [*(first + 1 for first in beginnings[1:]), count]
    parts = list(zip(beginnings, ends, strict=True))
    main = Replay(recording, recorded_world=recorded_world, part=parts[0] if most > 1 else None, rows=rows)
    # Forked after the first chain is loaded: the workers inherit its loaded and compiled code.
    others = [_Worker(main, recording, part, rows, recorded_world=recorded_world) for part in parts[1:]]
    share = count / parts[0][1]
    main.run(lambda done: report(min(round(done * share), count)))
    for worker in others:
        comparison, remarks = worker.finish()
        main.comparison.merge(comparison)
        main.remarks += [remark for remark in remarks if remark not in main.remarks]
    return main


class _Worker:
    """Child process that replays one part, with the chain of `main` if `skip_to` succeeds. If it ends without a
    result, its part is replayed in this process."""

    def __init__(
        self, main: Replay, recording: Recording, part: tuple[int, int], rows: PlayedRows, *, recorded_world: bool
    ) -> None:
        self._recording, self._part, self._rows, self._recorded_world = recording, part, rows, recorded_world
        self._answer, there = Pipe(duplex=False)
        self._process = start_child(self._work, main, there)
        there.close()

    def _make_replay(self) -> Replay:
        return Replay(self._recording, recorded_world=self._recorded_world, part=self._part, rows=self._rows)

    def _work(self, main: Replay, there: Connection) -> None:
        there.send(_run(main if main.skip_to(*self._part) else self._make_replay()))

    def finish(self) -> tuple[RunComparison, list[str]]:
        """Wait for the comparison and the remarks of this part."""
        try:
            found: Any = self._answer.recv()
        except EOFError:
            return _run(self._make_replay())
        self._process.join()
        comparison, remarks = found
        return comparison, remarks


def _run(replay: Replay) -> tuple[RunComparison, list[str]]:
    return replay.run(), replay.remarks
