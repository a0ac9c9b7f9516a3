"""Loads worlds beside the loop: new code must not run for the first time in a tick.

A user's file was saved: a thread unpickles what the host has written into the servo's folder, and calls the world once.
Or a world of the catalogue was chosen whose code was compiled only after the start, by another process: the thread
waits for that and loads it. The loop only takes what is ready. Between two of Python's instructions the thread gives
way to the loop.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from time import monotonic, sleep
from typing import final

from haptorb.devices.device import Device
from haptorb.errors import HaptorbError, InputError
from haptorb.runtime.exchange.plan import unpack
from haptorb.runtime.exchange.world_change import name_of
from haptorb.runtime.processes.prestart import code_note
from haptorb.runtime.row import RowLayout
from haptorb.runtime.tick.chain import Chain
from haptorb.runtime.tick.compilation import find_uncompiled, list_companions
from haptorb.worlds.own.failure import keep_source, try_world
from haptorb.worlds.world import World

__all__ = ["LoadedWorld", "WorldLoader"]

_SWITCH = 2e-4  #: after which a thread that computes gives way [s]
_LOOK = 0.05  #: between two looks for compiled code [s]
_COMPILED = 120.0  #: longest wait for it [s]


@dataclass(frozen=True)
class LoadedWorld:
    """What became of request `number`: the world `name`, or why there is none."""

    number: int
    name: str
    own: bool  #: another version of an own world; else one of the catalogue
    world: World | None
    error: HaptorbError | None = None


@final
class WorldLoader:
    """For `device`. Made before the loop asks for its real-time priority, which the thread must not have.

    chain       of its own, in which nothing happens: worlds are loaded by a step of it
    folder      the servo's own, where the process that compiles notes which world's code is there
    uncompiled  names of the catalogue's worlds whose code was not there at the start
    """

    def __init__(self, device: Device, chain: Chain, folder: Path, uncompiled: Iterable[str] = ()) -> None:
        self.ready: LoadedWorld | None = None  #: set by the thread, taken and cleared by the loop
        self._device, self._chain, self._row = device, chain, RowLayout.of(device).empty()
        self._folder, self._uncompiled, self._steps = folder, set(uncompiled), 0
        self._wanted: SimpleQueue[tuple[int, str, bool, Callable[[], World]]] = SimpleQueue()
        sys.setswitchinterval(_SWITCH)
        Thread(target=self._serve, name="haptorb-worlds", daemon=True).start()

    def is_code_missing(self, name: str) -> bool:
        """Whether the code of the catalogue's world `name` was not there at the start, and was not loaded since."""
        return name in self._uncompiled

    def load(self, number: int, name: str, path: Path) -> None:
        """Begin to load the own world `name` from `path`, for request `number`; returns at once."""
        self._wanted.put((number, name, True, partial(self._read, path)))

    def prepare(self, number: int, name: str, make: Callable[[], World]) -> None:
        """Begin to wait for the code of the catalogue's world `name`, which `make` returns; returns at once."""
        self._wanted.put((number, name, False, make))

    def _serve(self) -> None:
        while True:
            self.ready = self._load(*self._wanted.get())

    def _read(self, path: Path) -> World:
        world: World = unpack(path.read_bytes())
        keep_source(world)
        return try_world(world, self._device)

    def _load(self, number: int, name: str, own: bool, make: Callable[[], World]) -> LoadedWorld:
        try:
            world = make()
            if self._uncompiled:
                for one in (*list_companions(self._device, world), world):
                    self._load_code(name_of(one), one)
            self._uncompiled.discard(name)
            return LoadedWorld(number, name, own, world)
        except HaptorbError as cause:
            return LoadedWorld(number, name, own, None, cause)
        except BaseException as cause:  # the user's code, and all that it imports
            return LoadedWorld(number, name, own, None, HaptorbError(f"{type(cause).__name__}: {cause}"))

    def _load_code(self, name: str, world: World) -> None:
        """Return when the code of `world` is loaded. Raises InputError if it is not compiled in time."""
        if not self._find_uncompiled(world):
            return
        note, patience = code_note(self._folder, name), monotonic() + _COMPILED
        while not note.exists() and monotonic() < patience:
            sleep(_LOOK)
        if missing := self._find_uncompiled(world):
            raise InputError(
                f"world '{name}' cannot be rendered yet: kernel '{missing[0]}' is not compiled; end the servo and "
                "start it with this world"
            )

    def _find_uncompiled(self, world: World) -> list[str]:
        self._steps += 1
        return find_uncompiled(self._chain, world, self._row, 1e-3 * self._steps)
