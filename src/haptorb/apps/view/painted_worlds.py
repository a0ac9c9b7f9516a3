"""The force maps of a recording's worlds, computed once each by the device that made it."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Callable
from typing import final

from haptorb.apps.console.force_map import ForceMapSource
from haptorb.apps.console.shell import shell
from haptorb.apps.console.wire import encode_force_frame
from haptorb.apps.view.played_recording import PlayedRecording
from haptorb.worlds import CATALOGUE

__all__ = ["PaintedWorlds"]

_MOST = 32  #: maps


@final
class PaintedWorlds:
    """Paints worlds of `recording`, whose device must have a dome, with `force_map`; `end` ends what computes it."""

    def __init__(
        self, recording: PlayedRecording, force_map: ForceMapSource, end: Callable[[], None] = lambda: None
    ) -> None:
        self._recording, self._force_map, self.close = recording, force_map, end
        self.directions, self.triangles = shell()
        self._points = self.directions * recording.device.shell.contact_distance if recording.device.shell else None
        self._frames: OrderedDict[tuple[str, str, str], bytes] = OrderedDict()

    async def paint(self, change: int, model: str) -> bytes | None:
        """The frame of the force map after `change`, as a controller gives it that inverts `model`; None for a world
        that is not noted, or not one of the catalogue.

        Raises HaptorbError where it cannot be computed.
        """
        found = self._recording.find_world(change)
        if found is None or self._points is None or found[0] not in CATALOGUE:
            return None  # what the page says of such a world is a remark
        name, values = found
        key = name, repr(sorted(values.items())), model
        if key not in self._frames:
            force, saturated = await asyncio.to_thread(self._force_map, name, values, model, self._points)
            self._frames[key] = encode_force_frame(force, saturated, change)
            while len(self._frames) > _MOST:
                self._frames.popitem(last=False)
        return self._frames[key]
