"""Loads worlds in a thread beside the loop: new code must not run for the first time in a tick.

When a user's file was saved, the thread unpickles the world that the host has written to the servo's folder, and
calls it once. When a world of the catalogue was chosen whose code is compiled after the start, by another process,
the thread waits for the code and loads it. The loop only receives loaded worlds. Between two of Python's instructions
the thread yields to the loop.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from time import monotonic, sleep
from typing import Any, final

from haptorb.child_process import unpack
from haptorb.devices.base import Device
from haptorb.errors import HaptorbError, InputError, UnknownName
from haptorb.recording.row import RowLayout
from haptorb.runtime.prestart import code_note
from haptorb.runtime.tick import Chain
from haptorb.runtime.warm_up import find_uncompiled, list_companions
from haptorb.runtime.world_output import show
from haptorb.runtime.world_requests import name_of
from haptorb.worlds.base import World, parameters
from haptorb.worlds.base import values as parameter_values
from haptorb.worlds.client_force import split_remote
from haptorb.worlds.scene import SceneFile
from haptorb.worlds.user_world import (
    WorldFile,
    keep_source,
    try_world,
)

__all__ = ["LoadedWorld", "WorldLoader", "WorldWatcher", "select_changes"]


_SWITCH_INTERVAL_S = 2e-4  #: longest time for which a thread holds the interpreter lock when another waits
_CODE_CHECK_INTERVAL_S = 0.05  #: between two checks for compiled code
_COMPILE_TIMEOUT_S = 120.0  #: longest wait for it


@dataclass(frozen=True)
class LoadedWorld:
    """Result of request `number`: the world `name`, or the error."""

    number: int
    name: str
    own: bool  #: True: new version of a user's world; False: a world of the catalogue
    world: World | None
    error: HaptorbError | None = None


@final
class WorldLoader:
    """Loader thread for worlds on `device`; created before the loop gets real-time priority, which it must not inherit.

    chain       separate chain with a stub driver: a step of it loads a world
    folder      the servo's folder, where the compiler process marks the worlds whose code is available
    uncompiled  names of the catalogue's worlds whose code was not available at the start
    """

    def __init__(self, device: Device, chain: Chain, folder: Path, uncompiled: Iterable[str] = ()) -> None:
        self.ready: LoadedWorld | None = None  #: set by the thread, read and cleared by the loop
        self._device, self._chain, self._row = device, chain, RowLayout.of(device).empty()
        self._folder, self._uncompiled, self._steps = folder, set(uncompiled), 0
        self._wanted: SimpleQueue[tuple[int, str, bool, Callable[[], World]]] = SimpleQueue()
        sys.setswitchinterval(_SWITCH_INTERVAL_S)
        Thread(target=self._serve, name="haptorb-worlds", daemon=True).start()

    def is_code_missing(self, name: str) -> bool:
        """Whether the code of the catalogue's world `name` was not available at the start, and not loaded since."""
        return name in self._uncompiled

    def load(self, number: int, name: str, path: Path) -> None:
        """Start loading the user's world `name` from `path`, for request `number`; returns at once."""
        self._wanted.put((number, name, True, partial(self._read, path)))

    def prepare(self, number: int, name: str, make: Callable[[], World]) -> None:
        """Start waiting for the code of the catalogue's world `name`, which `make` returns; returns at once."""
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
        except BaseException as cause:  # user code, and all that it imports
            return LoadedWorld(number, name, own, None, HaptorbError(f"{type(cause).__name__}: {cause}"))

    def _load_code(self, name: str, world: World) -> None:
        """Wait for the code of `world` and load it. Raises InputError if it is not compiled in time."""
        if not self._find_uncompiled(world):
            return
        note, deadline = code_note(self._folder, name), monotonic() + _COMPILE_TIMEOUT_S
        while not note.exists() and monotonic() < deadline:
            sleep(_CODE_CHECK_INTERVAL_S)
        if missing := self._find_uncompiled(world):
            raise InputError(
                f"world '{name}' cannot be rendered yet: kernel '{missing[0]}' is not compiled; end the servo and "
                "start it with this world"
            )

    def _find_uncompiled(self, world: World) -> list[str]:
        self._steps += 1
        return find_uncompiled(self._chain, world, self._row, 1e-3 * self._steps)


# --------------------------------------------------------------------------------------------------
# A world in a user's file, reloaded whenever the file is saved; after an error the old world continues.


_FILE_CHECK_INTERVAL_S = 0.2  #: between two checks of the file
_SLOW_S = 2.0  #: time to load a file and call it once after which a message is printed
_SETTLING_TIME_S = 0.03  #: time for which a saved file must be unchanged before it is loaded


def _to_json(value: Any) -> Any:
    """Convert a value as a round trip through JSON does."""
    return list(value) if isinstance(value, tuple) else value


def select_changes(old: World, values: dict[str, Any], new: World) -> dict[str, Any]:
    """Select those of `values` that differ from the `old` world's and that `new` still accepts."""
    before, changes = parameter_values(old), {}
    for name, value in values.items():
        if name in before and value != _to_json(before[name]) and name in parameters(type(new)):
            with suppress(HaptorbError):
                new.replace(**{name: value})
                changes[name] = value
    return changes


@final
class WorldWatcher:
    """Thread that checks the file of `world` five times a second and passes every new version to `replace`.

    world     as loaded from the file, without clients' force
    replace   (world, values that the user has changed) → in effect; raises HaptorbError if the servo refuses
    """

    def __init__(
        self,
        file: WorldFile | SceneFile,
        world: World,
        device: Device,
        replace: Callable[[World, dict[str, Any]], None],
        current: Callable[[], tuple[str, dict[str, Any]]],
    ) -> None:
        self.trouble = ""  #: why the newest version of the file is not used; empty while it is
        self._file, (self._world, _), self._device = file, split_remote(world), device
        self._replace, self._current = replace, current
        self._stamp = file.stamp
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="haptorb-world-file", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Stop checking, without waiting for a file that is being loaded."""
        self._ending.set()

    def _watch(self) -> None:
        while not self._ending.wait(_FILE_CHECK_INTERVAL_S):
            stamp = self._file.stamp
            if stamp is None or stamp == self._stamp:
                continue
            while self._ending.wait(_SETTLING_TIME_S) or stamp != self._file.stamp:
                if self._ending.is_set():
                    return
                stamp = self._file.stamp
            self._stamp = stamp
            self._load()

    def _load(self) -> None:
        path = self._file.path.name
        hint = threading.Timer(_SLOW_S, self._explain_wait, [path])
        hint.daemon = True
        hint.start()
        try:
            new = self._file.load()
            if new.name != self._world.name:
                raise UnknownName(f"world in {path}", new.name, [self._world.name])
            try_world(new, self._device)
            name, values = self._current()
            self._replace(new, select_changes(self._world, values, new) if name == new.name else {})
        except HaptorbError as cause:
            if not self._ending.is_set():
                self.trouble = f"{path} was saved, but the previous world continues: {cause}"
                show(f"{self.trouble}\n")
            return
        finally:
            hint.cancel()
            hint.join()  # its message is printed before the following ones
        self._world = new
        show(f"{path} was saved: world '{new.name}' is reloaded\n")
        self.trouble = ""  # last: for a waiting thread the message has been printed by then

    def _explain_wait(self, path: str) -> None:
        """Report that the new code does not return, and that nothing else is loaded while it runs."""
        self.trouble = (
            f"{path} was saved, but has not returned from loading or its first call for {_SLOW_S:g} s; the previous "
            "world continues. If it never returns, correct the file and restart"
        )
        if not self._ending.is_set():
            show(f"{self.trouble}\n")
