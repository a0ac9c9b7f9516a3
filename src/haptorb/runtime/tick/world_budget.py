"""What the step of a world with memory may take of a tick, and what is done about one that takes more."""

from __future__ import annotations

from time import thread_time
from typing import Protocol, final

from haptorb.runtime.tick.tick_log import TickFailure
from haptorb.runtime.tick.work_thread import WorkThread
from haptorb.worlds.bound_world import BoundWorld
from haptorb.worlds.dynamic_world import WorldWork

__all__ = ["StepWatch", "WorldBudget"]

_SHARE = 0.4  #: of a tick that a world may take, on average; the rest of the tick needs about 0.2 ms
_EASY = 0.15  #: of a tick: below, there is time for more
_MEAN = 8.0  #: steps in the average
_MOST_OF_ONE = 2.0  #: ticks that a single step counts at most: the computer may have interrupted it
_CALM = 1.0  #: with such an average, before one level of detail returns [s]
_MOST = 64.0  #: by so much that time grows with every return that did not last
_LONG = 1.9  #: steps longer than a tick, with reduced detail and of late, until it is reduced further: two
_FADE = 0.998  #: by so much of each tick an earlier one counts less
_NOTHING = TickFailure(0)


class StepWatch(Protocol):
    """What receives the begin and end of each step of a world, and changes its detail."""

    def begin(self, bound: BoundWorld) -> None:
        """A step of `bound` begins."""

    def end(self, bound: BoundWorld) -> TickFailure:
        """A step of `bound` is over. LESS_DETAIL or MORE_DETAIL if its detail was changed, and WORK if it began with
        the result of background work; else 0."""


@final
class WorldBudget:
    """Watches the time of a world's steps in ticks of `dt` [s] and makes it reduce its detail, or restore it.

    A step cannot be interrupted: the budget leaves more than half of a tick, so that a scene which takes longer reduces
    detail before ticks are late. If single steps are longer than a tick even so, a background thread computes
    them. Processor time counts, on average: a step that waits because the computer is busy with other work is no
    faster with less detail, and the hand would feel the scene change without need.
    """

    def __init__(self, dt: float) -> None:
        self._budget, self._easy, self._most = _SHARE * dt, _EASY * dt, _MOST_OF_ONE * dt
        self._wait = round(_CALM / dt)
        self._mean, self._calm, self._patience = 0.0, 0, 1.0
        self._start = self._background = 0.0  # processor time of the last background work, while there is any
        self._whole, self._long, self._lighter = dt, 0.0, 0
        self._thread, self._found = WorkThread(), _NOTHING
        self._work: WorldWork | None = None
        self._owner: BoundWorld | None = None

    @property
    def is_computing(self) -> bool:
        """Whether the background thread is at work."""
        return self._work is not None and not self._thread.done

    def begin(self, bound: BoundWorld) -> None:
        """A step of `bound` begins, with the result of background work if that is due and done."""
        self._found = _NOTHING
        if self._work is not None and self._thread.done and not (bound.paused or bound.failed):
            if self._owner is not bound or not self._work.fits(bound.memory):  # another world, or restarted
                self._work = None
            elif bound.world.is_work_due(bound.memory):
                self._work, self._background = None, self._thread.took
                bound.world.take_over(bound.memory, self._thread.take())
                self._found = TickFailure.WORK
        self._start = thread_time()

    def end(self, bound: BoundWorld) -> TickFailure:
        """A step of `bound`, begun on this thread, is over."""
        took = thread_time() - self._start
        if self._work is None:
            self._work = bound.world.find_work(bound.memory)
            if self._work is None:
                self._background = 0.0
            else:
                self._owner = bound
                self._thread.give(self._work)
        return self.judge(bound, max(took, self._background)) | self._found

    def judge(self, bound: BoundWorld, took: float) -> TickFailure:
        """Change the detail of `bound` after a step that took so much processor time [s], if it must."""
        self._mean += (min(took, self._most) - self._mean) / _MEAN
        self._long = _FADE * self._long + (self._lighter > 0 and took > self._whole and not self._background)
        if self._mean > self._budget or self._long >= _LONG:
            self._mean, self._calm, self._long = 0.0, 0, 0.0
            before = bound.numbers.copy()
            bound.world.lighten(bound.memory)  # safety: overrun-sheds-detail
            if (bound.numbers == before).all():
                return _NOTHING
            self._lighter += 1
            self._patience = min(2.0 * self._patience, _MOST)
            return TickFailure.LESS_DETAIL
        if self._mean > self._easy:
            self._calm = 0
            return _NOTHING
        self._calm += 1
        if self._calm < self._wait * self._patience:
            return _NOTHING
        self._calm = 0
        before = bound.numbers.copy()
        bound.world.restore(bound.memory)
        if (bound.numbers == before).all():
            return _NOTHING
        self._lighter -= 1
        return TickFailure.MORE_DETAIL
