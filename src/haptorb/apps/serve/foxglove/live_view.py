"""Everything that viewers get: rows as messages when they are due, the device's shape, and what happened."""

from __future__ import annotations

from collections import deque
from time import monotonic_ns, time_ns
from typing import final

from foxglove.messages import Log, LogLevel, SceneUpdate

from haptorb.apps.serve.foxglove.device_shape import make_shape
from haptorb.apps.serve.foxglove.row_messages import RowMessages, make_stamp, name_code
from haptorb.apps.serve.foxglove.topics import Topic, make_topic
from haptorb.apps.serve.foxglove.viewer_connection import ViewerConnection
from haptorb.apps.serve.served_device import ServedDevice
from haptorb.control.protection.trip import GuardState, Trip
from haptorb.numerics.arrays import Array
from haptorb.runtime.trackers.pose_source import describe_trip

__all__ = ["LiveView"]

_REMEMBERED = 50  #: log messages that a new viewer gets
_NAME = "haptorb"


@final
class LiveView:
    """The topics of `served`, and the viewers that look at them."""

    def __init__(self, served: ServedDevice) -> None:
        self._served = served
        self._rows = RowMessages(served.device, served.layout).topics
        self._due = [float("-inf")] * len(self._rows)
        self._utc = time_ns() - monotonic_ns()
        shape, log = make_topic("/shape", SceneUpdate), make_topic("/log", Log)
        #: in the order of their numbers, which begin with 1
        self.topics: tuple[Topic, ...] = (*(one.topic for one in self._rows), shape, log)
        self._shape, self._log = len(self.topics) - 1, len(self.topics)
        self._happened: deque[tuple[int, bytes]] = deque(maxlen=_REMEMBERED)
        self._before: tuple[float, float, float] | None = None  # guard, trip and world of the row before
        self.viewers: set[ViewerConnection] = set()

    def welcome(self, viewer: ViewerConnection, topics: list[int]) -> None:
        """Give `viewer` what belongs to its new `topics` and is not sent again: the shape, and what happened before."""
        stamp = time_ns()
        if self._shape in topics:
            viewer.offer(self._shape, make_shape(self._served.device, make_stamp(stamp)).encode(), stamp)
        if self._log in topics:
            for earlier, data in self._happened:
                viewer.offer(self._log, data, earlier)

    def show(self, rows: Array) -> None:
        """Offer `rows` (n, width), oldest first, to the viewers that listen, each topic at its own rate."""
        t, wall = self._served.layout["t"].start, self._served.layout["wall"].start
        for row in rows:
            moment, stamp = float(row[t]), int(row[wall] * 1e9) + self._utc
            self._note(row, stamp)
            for i, one in enumerate(self._rows):
                if moment < self._due[i] - 1e-6:
                    continue
                gap = 1.0 / one.rate
                self._due[i] = (self._due[i] if moment - self._due[i] < gap else moment) + gap
                listening = [viewer for viewer in self.viewers if viewer.is_subscribed(i + 1)]
                if listening:
                    data = one.encode(row, stamp)
                    for viewer in listening:
                        viewer.offer(i + 1, data, stamp)

    def _note(self, row: Array, stamp: int) -> None:
        """Log a trip, another state of the guard, another world."""
        layout = self._served.layout
        guard, trip, world = (float(row[layout[name].start]) for name in ("guard", "trip", "world"))
        now, before = (guard, trip, world), self._before
        if now == before:
            return
        self._before = now
        if before is None or guard != before[0]:
            level = LogLevel.Error if guard == GuardState.TRIPPED else LogLevel.Info
            reason = next((one for one in Trip if one == trip), Trip.NONE)
            tripped = guard == GuardState.TRIPPED and reason is not Trip.NONE
            text = describe_trip(reason, self._served.facts["tracker"]) if tripped else name_code(GuardState, guard)
            self._tell(level, f"trip {reason.name}: {text}" if tripped else f"guard: {text}", stamp)
        if before is None or world != before[2]:
            name = self._served.world.get("name", "")
            self._tell(LogLevel.Info, f"world: {name}", stamp)

    def _tell(self, level: LogLevel, text: str, stamp: int) -> None:
        data = Log(timestamp=make_stamp(stamp), level=level, message=text, name=_NAME).encode()
        self._happened.append((stamp, data))
        for viewer in self.viewers:
            viewer.offer(self._log, data, stamp)
