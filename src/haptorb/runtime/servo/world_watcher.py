"""A world in a user's file, reloaded whenever the file is saved; after an error the old world keeps running."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, final

from haptorb import worlds
from haptorb.devices.device import Device
from haptorb.devices.state import State
from haptorb.errors import HaptorbError, UnknownName
from haptorb.numerics.arrays import Array
from haptorb.runtime.servo.output_reader import show
from haptorb.worlds.dynamic.remote_sum import split_remote
from haptorb.worlds.own.failure import try_world
from haptorb.worlds.own.file_with_remote import FileWithRemote
from haptorb.worlds.own.function_world import make_world
from haptorb.worlds.own.world_file import WorldFile, is_world_file, parse_world_file
from haptorb.worlds.parameter import parameters
from haptorb.worlds.parameter import values as parameter_values
from haptorb.worlds.scene.scene_file import SceneFile
from haptorb.worlds.world import World

__all__ = ["WorldWatcher", "choose_world", "keep_changes"]

_EVERY = 0.2  #: between two looks at the file [s]
_SLOW = 2.0  #: a file that takes longer to load and to be called once is reported [s]
_SETTLED = 0.03  #: for which a file that is being written must stay as it is [s]


def choose_world(
    given: str | World | WorldFile | SceneFile | FileWithRemote | Callable[[State], Array],
) -> tuple[World, WorldFile | SceneFile | None]:
    """The world `given` by name or object, and the file to watch if it comes from one.

    A function as a world returns (6,) [N, N·m].

    Raises UnknownName or InputError as `find_world`, `make_world` and `WorldFile.load` do.
    """
    if isinstance(given, str) and is_world_file(given):
        given = parse_world_file(given)
    if isinstance(given, WorldFile | SceneFile | FileWithRemote):
        return given.load(), given.file if isinstance(given, FileWithRemote) else given
    return (worlds.find_world(given)() if isinstance(given, str) else make_world(given)), None


def _to_json(value: Any) -> Any:
    """As JSON brings it back."""
    return list(value) if isinstance(value, tuple) else value


def keep_changes(old: World, values: dict[str, Any], new: World) -> dict[str, Any]:
    """Those of `values` that differ from the `old` world's and that `new` still allows."""
    before, changes = parameter_values(old), {}
    for name, value in values.items():
        if name in before and value != _to_json(before[name]) and name in parameters(type(new)):
            with suppress(HaptorbError):
                new.replace(**{name: value})
                changes[name] = value
    return changes


@final
class WorldWatcher:
    """Checks the file of `world` five times a second and passes every new version to `replace`, in a thread.

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
        while not self._ending.wait(_EVERY):
            stamp = self._file.stamp
            if stamp is None or stamp == self._stamp:
                continue
            while self._ending.wait(_SETTLED) or stamp != self._file.stamp:
                if self._ending.is_set():
                    return
                stamp = self._file.stamp
            self._stamp = stamp
            self._load()

    def _load(self) -> None:
        path = self._file.path.name
        hint = threading.Timer(_SLOW, self._explain_wait, [path])
        hint.daemon = True
        hint.start()
        try:
            new = self._file.load()
            if new.name != self._world.name:
                raise UnknownName(f"world in {path}", new.name, [self._world.name])
            try_world(new, self._device)
            name, values = self._current()
            self._replace(new, keep_changes(self._world, values, new) if name == new.name else {})
        except HaptorbError as cause:
            if not self._ending.is_set():
                self.trouble = f"{path} was saved, but the previous world continues: {cause}"
                show(f"{self.trouble}\n")
            return
        finally:
            hint.cancel()
            hint.join()  # what it says comes before what follows
        self._world = new
        show(f"{path} was saved: world '{new.name}' is reloaded\n")
        self.trouble = ""  # last: a waiting thread finds the message shown

    def _explain_wait(self, path: str) -> None:
        """The new code does not return, and while it runs nothing else is loaded."""
        self.trouble = (
            f"{path} was saved, but has not returned from loading or its first call for {_SLOW:g} s; the previous "
            "world continues. If it never returns, correct the file and restart"
        )
        if not self._ending.is_set():
            show(f"{self.trouble}\n")
