"""Who knows where the tool is: the one interface of every tracker, in two words for the two kinds of device.

A simulated device has a simulated hand, and the tracker says where that hand wants the tool (`goal`). A real device has
a real tool, and the tracker says where it is (`pose`). Both carry the time at which they were so, and both may be
unknown: no tracker ever invents one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

from haptorb.numerics.arrays import Array
from haptorb.numerics.record import record
from haptorb.sensing.sample import Pose

__all__ = ["Goal", "Tracker"]


@record
class Goal:
    """Where the hand wants the tool, and since when that is known.

    p      (3,) tool's magnet centre [m], frame S
    q      (4,) quaternion (x, y, z, w) of R_SR
    stamp  time of this wish on the loop's clock [s]: a pointer that is no longer refreshed grows old
    held   a person holds the pointer; False: the guided motion
    still  the guided motion is over, and the hand rests: it gives way to what pushes it
    """

    p: Array
    q: Array
    stamp: float
    held: bool
    still: bool = False


class Tracker(ABC):
    """What every tracker answers, in every tick: nothing in here waits, opens or asks.

    `origin` is the computer's monotonic time [s] at which the loop's clock showed zero.
    """

    origin: float = 0.0

    @abstractmethod
    def goal(self, now: float) -> Goal:
        """The hand's goal for the mover at `now` [s] on the loop's clock; a stamp that is not finite: unknown."""

    @abstractmethod
    def pose(self, now: float) -> Pose:
        """The tool's pose at `now` [s] on the loop's clock, when it was measured, and whether it is valid."""
