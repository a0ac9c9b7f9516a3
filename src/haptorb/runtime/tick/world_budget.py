"""What the step of a world with memory may take of a tick, and what is done about one that takes more."""

from __future__ import annotations

from time import thread_time
from typing import Protocol, final

from haptorb.runtime.tick.tick_log import TickFailure
from haptorb.worlds.bound_world import BoundWorld

__all__ = ["StepWatch", "WorldBudget"]

_SHARE = 0.4  #: of a tick that a world may take, on average; the rest of the tick needs about 0.2 ms
_EASY = 0.15  #: of a tick: below, there is time for more
_MEAN = 8.0  #: steps in the average
_MOST_OF_ONE = 2.0  #: ticks that a single step counts at most: the computer may have interrupted it
_CALM = 1.0  #: with such an average, before one level of detail returns [s]
_MOST = 64.0  #: by so much that time grows with every return that did not last
_NOTHING = TickFailure(0)


class StepWatch(Protocol):
    """What receives the begin and end of each step of a world, and changes its detail."""

    def begin(self) -> None:
        """A step begins."""

    def end(self, bound: BoundWorld) -> TickFailure:
        """A step of `bound` is over. LESS_DETAIL or MORE_DETAIL if its detail was changed, else 0."""


@final
class WorldBudget:
    """Watches the time of a world's steps in ticks of `dt` [s] and makes it reduce its detail, or restore it.

    A step cannot be interrupted: the budget leaves more than half of a tick, so that a scene which takes longer reduces
    detail before ticks are late. Processor time counts, on average: a step that waits because the computer is busy with
    other work is no faster with less detail, and the hand would feel the scene change without need.
    """

    def __init__(self, dt: float) -> None:
        self._budget, self._easy, self._most = _SHARE * dt, _EASY * dt, _MOST_OF_ONE * dt
        self._wait = round(_CALM / dt)
        self._mean, self._calm, self._patience = 0.0, 0, 1.0
        self._start = 0.0

    def begin(self) -> None:
        """A step begins."""
        self._start = thread_time()

    def end(self, bound: BoundWorld) -> TickFailure:
        """A step of `bound`, begun on this thread, is over."""
        return self.judge(bound, thread_time() - self._start)

    def judge(self, bound: BoundWorld, took: float) -> TickFailure:
        """Change the detail of `bound` after a step that took so much processor time [s], if it must."""
        self._mean += (min(took, self._most) - self._mean) / _MEAN
        if self._mean > self._budget:
            self._mean, self._calm = 0.0, 0
            self._patience = min(2.0 * self._patience, _MOST)
            before = bound.numbers.copy()
            bound.world.lighten(bound.memory)  # safety: overrun-sheds-detail
            return TickFailure.LESS_DETAIL if (bound.numbers != before).any() else _NOTHING
        if self._mean > self._easy:
            self._calm = 0
            return _NOTHING
        self._calm += 1
        if self._calm < self._wait * self._patience:
            return _NOTHING
        self._calm = 0
        before = bound.numbers.copy()
        bound.world.restore(bound.memory)
        return TickFailure.MORE_DETAIL if (bound.numbers != before).any() else _NOTHING
