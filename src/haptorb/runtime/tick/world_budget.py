"""What the step of a world with memory may take of a tick, and what is done about one that takes more."""

from __future__ import annotations

from typing import Protocol, final

from haptorb.worlds.bound_world import BoundWorld

__all__ = ["StepWatch", "WorldBudget"]

_SHARE = 0.4  #: of a tick that a world may take; the rest of the tick needs about 0.2 ms
_EASY = 0.15  #: of a tick: below, there is time for more
_AGAIN = 8  #: ticks within which a second one over the budget counts: a single one may be the computer's
_CALM = 1.0  #: without a longer step, before one level of detail comes back [s]
_MOST = 64.0  #: by so much that time grows with every return that did not last


class StepWatch(Protocol):
    """What receives the time of each step of a world."""

    def watch(self, bound: BoundWorld, took: float) -> None:
        """One step of `bound` took so long [s]."""


@final
class WorldBudget:
    """Watches the time of a world's steps in ticks of `dt` [s] and makes it reduce its detail, or restore it.

    A step cannot be interrupted: the budget leaves more than half of a tick, so that a scene which grows heavier sheds
    detail before a tick is late.
    """

    def __init__(self, dt: float) -> None:
        self._budget, self._easy = _SHARE * dt, _EASY * dt
        self._wait = round(_CALM / dt)
        self._since, self._calm, self._patience = _AGAIN, 0, 1.0

    def watch(self, bound: BoundWorld, took: float) -> None:
        """One step of `bound` took so long [s]."""
        self._since += 1
        if took > self._budget:
            if self._since < _AGAIN:  # safety: overrun-sheds-detail
                bound.world.lighten(bound.memory)
                self._patience = min(2.0 * self._patience, _MOST)
                self._since = _AGAIN
            else:
                self._since = 0
            self._calm = 0
        elif took > self._easy:
            self._calm = 0
        else:
            self._calm += 1
            if self._calm >= self._wait * self._patience:
                bound.world.restore(bound.memory)
                self._calm = 0
