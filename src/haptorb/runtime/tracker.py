"""Who knows where the tool is: the one interface of every tracker, in two words for the two kinds of device.

A simulated device has a simulated hand, and the tracker says where that hand wants the tool (`goal`). A real device has
a real tool, and the tracker says where it is (`pose`). Both carry the time at which they were so, and both may be
unknown: no tracker ever invents one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

from haptorb.sensing.sample import Pose

if TYPE_CHECKING:
    from haptorb.runtime.pointer import Goal

__all__ = ["Tracker"]


class Tracker(ABC):
    """What every tracker answers, in every tick: nothing in here waits, opens or asks.

    `origin` is the computer's monotonic time [s] at which the loop's clock showed zero.
    """

    origin: float = 0.0

    @abstractmethod
    def goal(self, now: float) -> Goal:
        """Where the hand wants the mover at `now` [s] on the loop's clock; a stamp that is not finite: nobody knows."""

    @abstractmethod
    def pose(self, now: float) -> Pose:
        """Where the tool is at `now` [s] on the loop's clock, when that was measured, and whether to believe it."""
