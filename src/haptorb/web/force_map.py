"""Force map on the dome: the achievable force at every point, recomputed when the world's parameters change."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, final

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.base import Device
from haptorb.errors import InputError

__all__ = ["Flags", "ForceMapSource", "ForceMapWorker", "shell"]


# --------------------------------------------------------------------------------------------------
# Mesh of the dome: rings of vertices around the zenith, evenly spaced, for colours per vertex.


@lru_cache(maxsize=4)
def shell(rings: int = 45, reach: float = 90.0) -> tuple[Array, Array]:
    """Mesh of the dome: unit vectors (n, 3) from the zenith down to `reach` [deg], and triangles (m, 3).

    Ring i has 6 i vertices, so that neighbours are about `reach`/`rings` degrees apart. Triangles face outward.

    >>> directions, triangles = shell(2)
    >>> directions.shape, triangles.shape
    ((19, 3), (24, 3))
    """
    tilt = np.radians(reach) * np.arange(rings + 1) / rings
    directions = [np.array([[0.0, 0.0, 1.0]])]
    for i in range(1, rings + 1):
        azimuth = 2 * np.pi * np.arange(6 * i) / (6 * i)
        level = np.full_like(azimuth, np.cos(tilt[i]))
        directions.append(np.stack([np.sin(tilt[i]) * np.cos(azimuth), np.sin(tilt[i]) * np.sin(azimuth), level], 1))
    triangles = []
    for i in range(1, rings + 1):
        inner, outer = (1 + 3 * (i - 1) * (i - 2) if i > 1 else 0), 1 + 3 * i * (i - 1)
        for side in range(6):
            for k in range(i):
                # The inner ring has one vertex fewer on each of the six sides.
                here, there = side * i + k, (side * i + k + 1) % (6 * i)
                below = inner + (side * (i - 1) + k) % max(6 * (i - 1), 1)
                triangles.append((below, outer + here, outer + there))
                if k < i - 1:
                    beside = inner + (side * (i - 1) + k + 1) % (6 * (i - 1))
                    triangles.append((below, outer + there, beside))
    return np.concatenate(directions), np.array(triangles)


#: boolean array of shape (n,)
Flags = np.ndarray[tuple[int], np.dtype[np.bool_]]

#: (name and values of the world, model inverted by the controller, points (n, 3) [m]) → radial force (n,) [N] and
#: whether the device is at its limit
ForceMapSource = Callable[[str, Mapping[str, Any], str, Array], tuple[Array, Flags]]


@final
class ForceMapWorker:
    """Computes the force map of the current world in a thread; of several requests only the newest is computed."""

    def __init__(self, device: Device, force_map: ForceMapSource) -> None:
        if device.shell is None:
            raise InputError(f"device '{device.name}' has no dome, so it has no force map")
        self.directions, self.triangles = shell()
        self._points = self.directions * device.shell.contact_distance
        self._force_map = force_map
        self._pending: tuple[str, Mapping[str, Any], str, int] | None = None
        self._task: asyncio.Task[None] | None = None
        self.force = np.zeros(len(self.directions))
        self.saturated: Flags = np.zeros(len(self.directions), dtype=np.bool_)
        self.version = -1  #: number of the request that `force` answers; −1: not computed yet

    def request(
        self,
        name: str,
        values: Mapping[str, Any],
        model: str,
        version: int,
        painted: Callable[[], None],
        failed: Callable[[str], None],
    ) -> None:
        """Request the map of this world for a controller that inverts `model`; replaces a pending request.

        `painted` or `failed` is called in the event loop when it is done.
        """
        self._pending = (name, values, model, version)
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._paint(painted, failed))

    async def _paint(self, painted: Callable[[], None], failed: Callable[[str], None]) -> None:
        while self._pending is not None:
            (name, values, model, version), self._pending = self._pending, None
            try:
                self.force, self.saturated = await asyncio.to_thread(self._force_map, name, values, model, self._points)
            except Exception as mistake:  # any exception in the code of a world: the page shows it, the loop continues
                failed(f"the force map of '{name}' cannot be computed: {mistake}")
            else:
                self.version = version
                painted()
