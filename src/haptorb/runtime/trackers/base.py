"""Base classes of trackers: feeds that receive poses, and trackers that supply a pose or goal in every tick."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple, final

from haptorb.estimation.types import HandGoal, Pose

if TYPE_CHECKING:
    from haptorb.estimation.tracker_frame import TrackerFrame

__all__ = [
    "Feed",
    "FramedFeed",
    "RawPose",
    "RejectedPose",
    "Tracker",
    "TransformedFeed",
]


class RawPose(NamedTuple):
    """Pose as received from a tracker, not yet checked.

    Parameters
    ----------
    p : tuple of float
        Position as sent: three numbers [m], or whatever the sender sent.
    q : tuple of float
        Quaternion (x, y, z, w) as sent, from the tool's frame to the tracker's.
    stamp : float
        Time of measurement on the computer's monotonic clock [s].
    arrival : float
        Time of arrival on the same clock [s].
    valid : bool
        False: the tracker reports that it lost the tool; p and q are ignored.
    """

    p: tuple[float, ...]
    q: tuple[float, ...]
    stamp: float
    arrival: float
    valid: bool = True


class RejectedPose(NamedTuple):
    """A message that is not a valid pose; `why` is the name of its counter."""

    why: str


class Feed(ABC):
    """Source of poses in its own process, where it may wait and may fail; the base class of every tracker.

    A subclass implements `receive` and `close`. haptorb checks the poses, computes velocities and counts what it
    rejects.

    Attributes
    ----------
    one_tool : bool
        False: the poses are hand goals, which may jump; a jump then does not count as a loss.
    """

    one_tool = True

    @property
    def remark(self) -> str:
        """Remark for the user on unusual messages; empty if there is none."""
        return ""

    @abstractmethod
    def receive(self, timeout: float) -> Iterator[RawPose | RejectedPose]:
        """Receive poses, in order of arrival.

        Parameters
        ----------
        timeout : float
            Longest time to wait for the first pose [s].

        Yields
        ------
        RawPose or RejectedPose
            Each pose, or each message that is not a pose.

        Raises
        ------
        HaptorbError
            If no more poses are possible.
        """

    @abstractmethod
    def close(self) -> None:
        """Close sockets. May be called twice."""


class TransformedFeed(Feed):
    """A feed whose poses are transformed one by one; a loss has no pose, and times are not changed."""

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self.one_tool = feed.one_tool

    @abstractmethod
    def transform(self, pose: RawPose) -> RawPose:
        """Return the transformed pose; an impossible one is passed on unchanged, for the filter to reject."""

    def receive(self, timeout: float) -> Iterator[RawPose | RejectedPose]:
        """Receive poses from the feed, and transform them."""
        for one in self._feed.receive(timeout):
            yield one if isinstance(one, RejectedPose) or not one.valid else self.transform(one)

    @property
    def remark(self) -> str:
        """That of the feed."""
        return self._feed.remark

    def close(self) -> None:
        """Close the feed."""
        self._feed.close()


@final
class FramedFeed(TransformedFeed):
    """A feed in its tracker's frame, transformed into the stator's frame.

    Velocities follow from the poses, so they are in the stator's frame too.
    """

    def __init__(self, feed: Feed, frame: TrackerFrame) -> None:
        super().__init__(feed)
        self._frame = frame

    def transform(self, pose: RawPose) -> RawPose:
        """The pose in the stator's frame."""
        p, q = self._frame.transform_pose(pose.p, pose.q)
        return pose._replace(p=p, q=q)


# --------------------------------------------------------------------------------------------------
# The interface of every tracker, with one method for simulated and one for real devices.
#
# For a simulated device the tracker supplies the goal of the simulated hand (`goal`), for a real device the pose of the
# real tool (`pose`). Both have a timestamp, and both may be unknown: no tracker ever makes one up.


class Tracker(ABC):
    """Base class of trackers, which are read in every tick: all methods are non-blocking.

    `origin` is the computer's monotonic time [s] at zero of the loop's clock.
    """

    origin: float = 0.0

    @abstractmethod
    def goal(self, now: float) -> HandGoal:
        """The hand's goal for the mover at `now` [s] on the loop's clock; a stamp that is not finite: unknown."""

    @abstractmethod
    def pose(self, now: float) -> Pose:
        """The tool's pose at `now` [s] on the loop's clock, when it was measured, and whether it is valid."""
