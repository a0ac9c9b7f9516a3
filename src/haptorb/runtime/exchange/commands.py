"""What the host may say to a running loop: stop, engage, another mode, another world; the hand is in its base."""

from __future__ import annotations

import json
import threading
from abc import abstractmethod
from collections.abc import Mapping
from itertools import count
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from haptorb.control.clutch.modes import MODES
from haptorb.errors import InputError, ServoError, UnknownName
from haptorb.runtime.exchange.hand_commands import HandCommands
from haptorb.runtime.exchange.plan import pack
from haptorb.runtime.exchange.shared_memory import SharedMemory, Word, engage_request
from haptorb.runtime.exchange.world_change import name_of, parse_answer, request
from haptorb.worlds import CATALOGUE
from haptorb.worlds.parameter import values as parameter_values
from haptorb.worlds.world import World

__all__ = ["Commands"]

_ANSWER = 2.0  #: longest wait for the servo's answer [s]
_LOADED = 30.0  #: where it loads a world, which may be compiled there [s]


class Commands(HandCommands):
    """Words for `device` with its `modes` and `models`, written into memory that the loop reads in every tick.

    `first` is the world that is felt until another is set.
    """

    models: tuple[str, ...]
    _model: str  # that is inverted until another is set

    def __init__(self, first: World) -> None:
        HandCommands.__init__(self)
        self._first = first
        name = name_of(first)
        #: worlds beside the catalogue's that `set_world` knows, by name: the first one, if it is none of those
        self.own_worlds = {} if type(first) is CATALOGUE.get(name) else {name: first}
        self._requests = 0
        self._requesting = threading.Lock()
        self._stop_numbers = count(1)
        self._stopped = 0  # number of the last stop

    @abstractmethod
    def check(self) -> None:
        """Raise ServoError if the loop no longer runs."""

    @property
    def stops(self) -> int:
        """How often `stop` was called. Read it when a person asks to engage, and pass it to `engage`."""
        shared = self._memory_or_none
        return self._stopped if shared is None else int(shared.words[Word.STOP])

    def stop(self) -> None:
        """Coils off within a tick, and off until `engage`. Given before or during the start, it holds from the first
        tick on. May be called from any thread."""
        # Every stop has a number of its own: two threads that stop at once cannot hide one's behind the other's.
        self._stopped = number = next(self._stop_numbers)
        shared = self._memory_or_none
        if shared is not None:
            shared.words[Word.STOP] = number

    def _carry_stops(self, shared: SharedMemory) -> None:
        """Tell a loop that is about to start of the earlier stops; `_memory_or_none` is `shared` already."""
        if self._stopped:
            shared.words[Word.STOP] = self._stopped

    def engage(self, stops: int | None = None) -> None:
        """After a stop or a trip: begin again, from zero. Refused by the guard while the reason is still there.

        `stops` is the value of `stops` when the person asked to engage; None: now. The servo refuses to engage when
        `stop` was called since, by whomever.
        """
        words = self._memory.words
        words[Word.ENGAGE] = engage_request(words[Word.ENGAGE], self.stops if stops is None else stops)

    def cool(self) -> None:
        """Put simulated coils at the ambient temperature, from the next tick on; a demonstration need not wait for
        them. Raises InputError for a real device: its coils cool by themselves, with time."""
        if self.driver != "sim":
            raise InputError(f"only simulated coils cool at once; driver '{self.driver}' drives a real device")
        self._memory.words[Word.COOL] += 1

    def set_mode(self, mode: str) -> None:
        """Go over to `mode`, "translate" or "rotate", without a step of the target's pose or of torque.

        Raises UnknownName for a mode that the device does not have.
        """
        if mode not in self.modes:
            raise UnknownName(f"mode of device '{self.device.name}'", str(mode), self.modes)
        self._memory.words[Word.MODE] = 1 + MODES.index(mode)

    def clutch(self, engaged: bool) -> None:
        """Let the target go (False) to turn the handle back and reach further, or take hold of it again (True).

        Raises InputError for a device without modes: it has no clutch.
        """
        if not self.modes:
            raise InputError(f"device '{self.device.name}' has no clutch; its mover acts directly")
        self._memory.words[Word.CLUTCH] = 1 if engaged else 2

    @property
    def model(self) -> str:
        """The model of the device that the controller inverts now, or goes over to."""
        shared = self._memory_or_none
        number = 0 if shared is None else int(shared.words[Word.MODEL])
        return self.device.models[number - 1] if number else self._model

    def set_model(self, name: str) -> None:
        """Invert the device's model `name`, without a step of the force: the currents go over within 50 ms.

        Raises UnknownName for no model of the device, InputError for one that takes too long for a tick.
        """
        self._memory.words[Word.MODEL] = 1 + self.device.models.index(self.device.check_tick_model(name))

    @property
    def world(self) -> tuple[str, dict[str, Any]]:
        """Name and values of the world that is felt now."""
        shared = self._memory_or_none
        if shared is None or not (known := shared.words[Word.WORLD]):
            return name_of(self._first), dict(parameter_values(self._first))
        world = json.loads(shared.worlds_since(known - 1)[-1][1])
        return world["name"], world["values"]

    def add_world(self, world: World) -> None:
        """Let `set_world` know `world` by its own name, beside the catalogue's. Raises ServoError after the start."""
        if self._memory_or_none is not None:
            raise ServoError("add_world comes before the start: the servo's process is given all worlds at once")
        self.own_worlds[world.name] = world

    def set_world(self, name: str, values: Mapping[str, Any] | None = None) -> None:
        """Render the world `name` with `values` from the next tick on; values not given stay as they are, or, in a
        new world, are its defaults. Raises UnknownName or InputError if the servo refuses; then nothing changes."""
        self._request(name, values or {})

    def replace_own_world(self, world: World, values: Mapping[str, Any], folder: Path) -> None:
        """Render `world` with `values` in place of the own world of its name, from when the servo has loaded it.

        `folder` is the servo's own. Raises InputError if the world cannot be sent, or fails there;
        then nothing changes.
        """
        file = folder / f"world-{self._requests + 1}"
        try:
            file.write_bytes(pack(world.replace(**values)))
        except Exception as cause:
            raise InputError(f"world '{world.name}' cannot be sent to the servo's process: {cause}") from cause
        try:
            self._request(world.name, {}, file)
        finally:
            file.unlink(missing_ok=True)
        self.own_worlds = {**self.own_worlds, world.name: world}

    def _request(self, name: str, values: Mapping[str, Any], file: Path | None = None) -> None:
        shared = self._memory
        with self._requesting:
            self.check()
            self._requests += 1
            shared.request.write(request(self._requests, name, values, "" if file is None else str(file)))
            longest = _ANSWER if file is None else _LOADED
            patience = monotonic() + longest
            while True:
                number, error = parse_answer(shared.answer.read()[1])
                if number == self._requests:
                    if error is not None:
                        raise error
                    return
                self.check()
                if monotonic() > patience:
                    raise ServoError(f"the servo did not answer within {longest:g} s")
                sleep(0.0005)
