"""Commands of the host to a running loop: stop, engage, another mode, another world; its base has those of the hand."""

from __future__ import annotations

import json
import threading
from abc import abstractmethod
from collections.abc import Collection, Mapping
from itertools import count
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from haptorb.control.clutch.modes import MODES
from haptorb.errors import InputError, ServoError, UnknownName, quote
from haptorb.runtime.exchange.hand_commands import HandCommands
from haptorb.runtime.exchange.plan import pack
from haptorb.runtime.exchange.shared_memory import SharedMemory, Word, engage_request
from haptorb.runtime.exchange.world_change import name_of, parse_answer, parse_postponement, request, values_of
from haptorb.worlds import CATALOGUE
from haptorb.worlds.dynamic.remote_sum import split_remote
from haptorb.worlds.world import World

__all__ = ["BUTTONS", "LARGEST_SCALE", "Commands"]

BUTTONS = ("a", "b", "c")  #: of the tool, as programs that are connected see them
LARGEST_SCALE = 100.0  #: of a motor's torques

_ANSWER = 2.0  #: longest wait for the servo's answer [s]
_LOADED = 30.0  #: where it loads a world, which may be compiled there [s]
_COMPILED = 150.0  #: where that waits for code that another process compiles [s]


class Commands(HandCommands):
    """Commands for `device` with its `modes` and `models`, written into memory that the loop reads in every tick.

    `first` is the first world.
    """

    models: tuple[str, ...]
    _model: str  # that is inverted until another is set

    def __init__(self, first: World) -> None:
        HandCommands.__init__(self)
        self._first = first
        name, (plain, _) = name_of(first), split_remote(first)
        #: worlds beside the catalogue's that `set_world` knows, by name: the first one, if it is none of those
        self.own_worlds = {} if type(plain) is CATALOGUE.get(name) else {name: plain}
        self._requests = 0
        self._requesting = threading.Lock()
        self.world_ahead = ""  #: world that was chosen, and whose code is being compiled, once on this computer
        self._stop_numbers = count(1)
        self._stopped = 0  # number of the last stop

    @abstractmethod
    def check(self) -> None:
        """Raise ServoError if the loop no longer runs."""

    @abstractmethod
    def _compile_world(self, name: str) -> None:
        """Have the code of the catalogue's world `name` compiled next, beside the loop."""

    @abstractmethod
    def _check_compiler(self) -> None:
        """Raise ServoError if what compiles beside the loop hangs."""

    @property
    def stops(self) -> int:
        """Number of calls of `stop`. Read it when a person requests to engage, and pass it to `engage`."""
        shared = self._memory_or_none
        return self._stopped if shared is None else int(shared.words[Word.STOP])

    def stop(self) -> None:
        """Coils off within a tick, and off until `engage`. Before or during the start, it takes effect from the
        first tick. May be called from any thread."""
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
        """Engage after a stop or a trip, from zero force. The guard refuses while the reason persists.

        `stops` is the value of `stops` when the person requested to engage; None: now. The servo refuses if `stop`
        was called since then.
        """
        words = self._memory.words
        words[Word.ENGAGE] = engage_request(words[Word.ENGAGE], self.stops if stops is None else stops)

    def cool(self) -> None:
        """Set simulated coils to the ambient temperature, from the next tick on. Raises InputError for a real
        device."""
        if self.driver != "sim":
            raise InputError(f"only simulated coils can be cooled at once; driver '{self.driver}' drives a real device")
        self._memory.words[Word.COOL] += 1

    def press(self, buttons: Collection[str]) -> None:
        """Press these `buttons`, of "a", "b", "c", and release the others, for connected programs.

        Raises UnknownName for another button.
        """
        for name in buttons:
            if name not in BUTTONS:
                raise UnknownName("button", str(name), BUTTONS)
        self._memory.words[Word.BUTTONS] = sum(1 << i for i, name in enumerate(BUTTONS) if name in buttons)

    def set_mode(self, mode: str) -> None:
        """Change to `mode`, "translate" or "rotate", without a step of the target's pose or of torque.

        Raises UnknownName for a mode that the device does not have.
        """
        if mode not in self.modes:
            raise UnknownName(f"mode of device '{self.device.name}'", str(mode), self.modes)
        self._memory.words[Word.MODE] = 1 + MODES.index(mode)

    def clutch(self, engaged: bool) -> None:
        """Release the clutch (False), to turn the handle back and reach further, or engage it (True).

        Raises InputError for a device without modes: it has no clutch.
        """
        if not self.modes:
            raise InputError(f"device '{self.device.name}' has no clutch; its mover acts directly")
        self._memory.words[Word.CLUTCH] = 1 if engaged else 2

    def set_torque_scale(self, scale: float) -> None:
        """Multiply all torques of a motor's handle by `scale`, above 0 and up to 100, without a step.

        The motion does not change, so the wrench on the target feels weaker or stronger. 1: the gains only. Raises
        InputError for another number, or a device without modes.
        """
        if not self.modes:
            raise InputError(f"device '{self.device.name}' has no torque scale; its mover acts directly")
        if isinstance(scale, bool) or not isinstance(scale, int | float) or not 1e-6 <= scale <= LARGEST_SCALE:
            raise InputError(f"torque scale must be above 0 and at most {LARGEST_SCALE:g}; got {quote(scale)}")
        self._memory.words[Word.SCALE] = round(scale * 1e6)

    def pause_recording(self, paused: bool) -> None:
        """Leave rows out of the recording from now on, or no longer; the gap's rows are counted in the file."""
        self._memory.words[Word.RECORDING_PAUSED] = int(paused)

    @property
    def model(self) -> str:
        """The controller model, or the one to which it is changing."""
        shared = self._memory_or_none
        number = 0 if shared is None else int(shared.words[Word.MODEL])
        return self.device.models[number - 1] if number else self._model

    def set_model(self, name: str) -> None:
        """Change the controller model to `name`, without a step of the force: the currents change within 50 ms.

        Raises UnknownName for an unknown model, InputError for one that takes too long for a tick.
        """
        self._memory.words[Word.MODEL] = 1 + self.device.models.index(self.device.check_tick_model(name))

    @property
    def world(self) -> tuple[str, dict[str, Any]]:
        """Name and parameters of the current world."""
        shared = self._memory_or_none
        if shared is None or not (known := shared.words[Word.WORLD]):
            return name_of(self._first), dict(values_of(self._first))
        world = json.loads(shared.worlds_since(known - 1)[-1][1])
        return world["name"], world["values"]

    def add_world(self, world: World, name: str = "") -> None:
        """Make `world` available to `set_world` by `name`, or by its own name. Raises ServoError after the start."""
        if self._memory_or_none is not None:
            raise ServoError("call add_world before the start: the servo's process receives all worlds at once")
        self.own_worlds[name or world.name] = world

    def set_world(self, name: str, values: Mapping[str, Any] | None = None) -> None:
        """Render the world `name` with `values` from the next tick on; values not given stay the same, or are the
        defaults of a new world. After a first start its code may have to be compiled first; `world_ahead` then
        has its name. Raises UnknownName or InputError if the servo refuses; then nothing changes."""
        self._request(name, values or {})

    def replace_own_world(self, world: World, values: Mapping[str, Any], folder: Path) -> None:
        """Render `world` with `values` instead of the own world of its name, as soon as the servo has loaded it.

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
            try:
                self._await_answer(shared, name, _ANSWER if file is None else _LOADED)
            finally:
                self.world_ahead = ""

    def _await_answer(self, shared: SharedMemory, name: str, longest: float) -> None:
        """Return when the request for the world `name` is fulfilled, after at most `longest` [s]."""
        patience = monotonic() + longest
        while True:
            text = shared.answer.read()[1]
            number, error = parse_answer(text)
            if number == self._requests:
                if error is not None:
                    raise error
                return
            if not self.world_ahead and parse_postponement(text) == self._requests:
                self.world_ahead, longest = name, _COMPILED
                patience = monotonic() + longest
                self._compile_world(name)
            self.check()
            if self.world_ahead:
                self._check_compiler()
            if monotonic() > patience:
                raise ServoError(f"the servo did not respond within {longest:g} s; close other programs, and try again")
            sleep(0.0005)
