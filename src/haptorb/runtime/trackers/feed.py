"""Sources of poses: the abstract feed, one class per kind of tracker, and the poses that it receives."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import NamedTuple

__all__ = ["Feed", "RawPose", "RejectedPose"]


class RawPose(NamedTuple):
    """One pose as received, not yet checked.

    p and q are as sent: three and four numbers that may be anything. `valid` False: the tracker reports that it
    lost the tool; then they are ignored. `stamp` [s] is the time of measurement on the computer's monotonic
    clock; `arrival` the time of arrival.
    """

    p: tuple[float, ...]
    q: tuple[float, ...]
    stamp: float
    arrival: float
    valid: bool = True


class RejectedPose(NamedTuple):
    """A message that is not a valid pose; `why` is the name under which it is counted."""

    why: str


class Feed(ABC):
    """A source of poses, in its own process: it may wait, and it may fail.

    `one_tool` False: its poses are pointer targets, which may jump.
    """

    one_tool = True

    @abstractmethod
    def receive(self, patience: float) -> Iterator[RawPose | RejectedPose]:
        """The received poses, in order of arrival; waits at most `patience` [s] for the first.

        Raises HaptorbError if no more poses are possible.
        """

    @abstractmethod
    def close(self) -> None:
        """Close sockets. May be called twice."""
