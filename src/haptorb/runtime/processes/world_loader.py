"""Loads worlds beside the loop: a user's file was saved, and its new code must not run for the first time in a tick.

A thread unpickles what the host has written into the servo's folder, and calls the world once; the loop only takes what
is ready. Between two of Python's instructions the thread gives way to the loop.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import final

from haptorb.devices.device import Device
from haptorb.errors import HaptorbError
from haptorb.runtime.exchange.plan import unpack
from haptorb.worlds.own.failure import keep_source, try_world
from haptorb.worlds.world import World

__all__ = ["LoadedWorld", "WorldLoader"]

_SWITCH = 2e-4  #: after which a thread that computes gives way [s]


@dataclass(frozen=True)
class LoadedWorld:
    """What became of request `number`: the world `name`, or why there is none."""

    number: int
    name: str
    world: World | None
    error: HaptorbError | None = None


@final
class WorldLoader:
    """For `device`. Made before the loop asks for its real-time priority, which the thread must not have."""

    def __init__(self, device: Device) -> None:
        self.ready: LoadedWorld | None = None  #: set by the thread, taken and cleared by the loop
        self._device = device
        self._wanted: SimpleQueue[tuple[int, str, Path]] = SimpleQueue()
        sys.setswitchinterval(_SWITCH)
        Thread(target=self._serve, name="haptorb-worlds", daemon=True).start()

    def load(self, number: int, name: str, path: Path) -> None:
        """Begin to load the world `name` from `path`, for request `number`; returns at once."""
        self._wanted.put((number, name, path))

    def _serve(self) -> None:
        while True:
            number, name, path = self._wanted.get()
            self.ready = self._load(number, name, path)

    def _load(self, number: int, name: str, path: Path) -> LoadedWorld:
        try:
            world: World = unpack(path.read_bytes())
            keep_source(world)
            return LoadedWorld(number, name, try_world(world, self._device))
        except HaptorbError as cause:
            return LoadedWorld(number, name, None, cause)
        except BaseException as cause:  # the user's code, and whatever it imports
            return LoadedWorld(number, name, None, HaptorbError(f"{type(cause).__name__}: {cause}"))
