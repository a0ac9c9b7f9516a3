"""A feed whose poses are in the tracker's frame, as poses of the tool in the stator's frame."""

from __future__ import annotations

from collections.abc import Iterator
from typing import final

from haptorb.estimation.tracker_frame import TrackerFrame
from haptorb.runtime.trackers.base import Feed, RawPose, RejectedPose

__all__ = ["FramedFeed"]


@final
class FramedFeed(Feed):
    """Wraps `feed`. Times are not touched; velocities follow from the poses, so they are in the stator's frame too."""

    def __init__(self, feed: Feed, frame: TrackerFrame) -> None:
        self._feed, self._frame = feed, frame
        self.one_tool = feed.one_tool

    def receive(self, patience: float) -> Iterator[RawPose | RejectedPose]:
        """As the feed receives it; a loss has no pose, and an impossible pose is left for the filter to refuse."""
        for one in self._feed.receive(patience):
            if isinstance(one, RejectedPose) or not one.valid:
                yield one
                continue
            p, q = self._frame.transform_pose(one.p, one.q)
            yield one._replace(p=p, q=q)

    def close(self) -> None:
        """Close the feed."""
        self._feed.close()
