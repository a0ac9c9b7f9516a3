"""The map painted on the dome: what the device would really give at every point, kept up with the world's sliders."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any, final

import numpy as np

from haptorb.apps.console.shell import shell
from haptorb.devices.device import Device
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array

__all__ = ["Flags", "ForceMapSource", "ForceMapWorker"]

#: shape (n,)
Flags = np.ndarray[tuple[int], np.dtype[np.bool_]]

#: (name and values of the world, model that is inverted, points (n, 3) [m]) → radial force (n,) [N] and whether the
#: device is at its limit
ForceMapSource = Callable[[str, Mapping[str, Any], str, Array], tuple[Array, Flags]]


@final
class ForceMapWorker:
    """Recomputes the map in a thread whenever the world changes; of several changes only the newest is painted."""

    def __init__(self, device: Device, force_map: ForceMapSource) -> None:
        if device.shell is None:
            raise InputError(f"device '{device.name}' has no dome, so it has no force map")
        self.directions, self.triangles = shell()
        self._points = self.directions * device.shell.contact_distance
        self._force_map = force_map
        self._wanted: tuple[str, Mapping[str, Any], str, int] | None = None
        self._task: asyncio.Task[None] | None = None
        self.force = np.zeros(len(self.directions))
        self.saturated: Flags = np.zeros(len(self.directions), dtype=np.bool_)
        self.version = -1  #: which change of the world `force` belongs to; −1: not painted yet

    def want(
        self,
        name: str,
        values: Mapping[str, Any],
        model: str,
        version: int,
        painted: Callable[[], None],
        failed: Callable[[str], None],
    ) -> None:
        """Paint this world next, as a controller gives it that inverts `model`.

        `painted` or `failed` is called in the event loop when that is done.
        """
        self._wanted = (name, values, model, version)
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._paint(painted, failed))

    async def _paint(self, painted: Callable[[], None], failed: Callable[[str], None]) -> None:
        while self._wanted is not None:
            (name, values, model, version), self._wanted = self._wanted, None
            try:
                self.force, self.saturated = await asyncio.to_thread(self._force_map, name, values, model, self._points)
            except Exception as mistake:  # any exception of a world's own code: the page shows it, the loop continues
                failed(f"the force map of '{name}' cannot be computed: {mistake}")
            else:
                self.version = version
                painted()
