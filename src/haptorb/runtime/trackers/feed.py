"""Where poses come from: the abstract feed, one per kind of tracker, and what it hears."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import NamedTuple

__all__ = ["Feed", "RawPose", "RejectedPose"]


class RawPose(NamedTuple):
    """One pose as it was heard, judged by nobody yet.

    p and q are as sent: three and four numbers that may be anything. `valid` False: the tracker says that it lost the
    tool; then they do not matter. `stamp` [s] is the computer's monotonic clock when it was measured; `arrival` when
    it came.
    """

    p: tuple[float, ...]
    q: tuple[float, ...]
    stamp: float
    arrival: float
    valid: bool = True


class RejectedPose(NamedTuple):
    """Something that is no pose; `why` is the name under which it is counted."""

    why: str


class Feed(ABC):
    """A source of poses, in a process of its own: it may wait, and it may fail.

    `one_tool` False: what it says is where a hand once wanted the tool, and that may jump.
    """

    one_tool = True

    @abstractmethod
    def receive(self, patience: float) -> Iterator[RawPose | RejectedPose]:
        """What has come, in the order of arrival; waits at most `patience` [s] for the first.

        Raises HaptorbError if nothing can ever come again.
        """

    @abstractmethod
    def close(self) -> None:
        """Let go of sockets. May be called twice."""
