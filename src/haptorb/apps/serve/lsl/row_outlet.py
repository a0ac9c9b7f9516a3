"""Sends rows to an outlet of the lab streaming layer, each stamped with the time at which its tick began."""

from __future__ import annotations

from collections.abc import Mapping
from time import time
from typing import Any, final

import numpy as np

from haptorb.apps.serve.lsl.clock_offset import ClockOffset, measure_offset
from haptorb.apps.serve.lsl.stream_description import Clocks, make_stream_info
from haptorb.numerics.arrays import Array
from haptorb.runtime.row import RowLayout
from haptorb.runtime.trackers.lsl_feed import THIS_COMPUTER

__all__ = ["BACKLOG", "RowOutlet"]

BACKLOG = 10  #: seconds of samples that the layer keeps for a slow reader; then the oldest go [s]


@final
class RowOutlet:
    """The stream of the rows of `layout`, `rate` a second [Hz]; programs of this computer find it at once.

    facts    what is served, as text, for the stream's description
    """

    def __init__(self, layout: RowLayout, rate: float, facts: Mapping[str, str]) -> None:
        import pylsl  # here, so that only who serves by it needs it

        pylsl.set_config_content(THIS_COMPUTER)
        self._layer: Any = pylsl
        self._offset: ClockOffset = measure_offset(pylsl.local_clock)
        self._wall = layout["wall"].start
        clocks = Clocks(self._offset, measure_offset(time))
        info = make_stream_info(pylsl, layout, rate, facts, clocks)
        self._outlet: Any = pylsl.StreamOutlet(info, 0, BACKLOG)
        self.sent = 0  #: rows that were given to the layer

    @property
    def watched(self) -> bool:
        """Whether a program reads the stream."""
        return bool(self._outlet.have_consumers())

    def send(self, rows: Array) -> None:
        """Send `rows` (n, width), in the units of their layout; the layer copies them and never waits for a reader."""
        if not len(rows):
            return
        stamps = rows[:, self._wall] + self._offset.seconds
        self._outlet.push_chunk(np.ascontiguousarray(rows), stamps.tolist())
        self.sent += len(rows)

    def close(self) -> None:
        """End the stream: readers learn that it is gone."""
        self._outlet = None
