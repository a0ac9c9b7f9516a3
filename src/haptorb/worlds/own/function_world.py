"""A world from a plain function of a state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from haptorb.devices.state import State
from haptorb.errors import InputError, quote
from haptorb.numerics.arrays import Array
from haptorb.worlds.world import World

__all__ = ["FunctionWorld", "make_world"]


@dataclass(frozen=True)
class FunctionWorld(World):
    """The wrench is `function(state)`: an array (6,), force [N] and torque [N·m]. It is assumed to be passive.

    >>> import numpy as np
    >>> pull = FunctionWorld(lambda state: np.append(-20 * state.p, np.zeros(3)))
    >>> pull.wrench(State.at((0, 0, 0.05))).tolist()
    [-0.0, -0.0, -1.0, 0.0, 0.0, 0.0]
    """

    function: Callable[[State], Array] | None = None

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise InputError(f"FunctionWorld needs a function of a State; got {quote(self.function)}")

    @property
    def name(self) -> str:
        """The function's name in lower case; `function` for a lambda."""
        name = str(getattr(self.function, "__name__", "")).lower()
        return name if name.isidentifier() else "function"

    @property
    def wrench_code(self) -> Callable[..., Any]:
        """The function."""
        assert self.function is not None
        return self.function

    def _summarize(self) -> str:
        return f"FunctionWorld({self.name})"

    def wrench(self, state: State) -> Array:
        """(6,) what the function returns [N, N·m]."""
        assert self.function is not None
        return self.function(state)


def make_world(given: object, where: str = "world") -> World:
    """A World from user code: a World, a World class without required arguments, or a function of a State.

    Raises InputError for anything else, and for a class that requires arguments.
    """
    if isinstance(given, World):
        return given
    if isinstance(given, type):
        if not issubclass(given, World):
            raise InputError(f"{where}: class {given.__name__} must derive from haptorb.worlds.World")
        try:
            return given()
        except TypeError as cause:
            raise InputError(
                f"{where}: {given.__name__}() cannot be created ({cause}); a world needs a default for every field, "
                "and "
                "a method wrench(self, state)"
            ) from cause
    if callable(given):
        return FunctionWorld(given)
    raise InputError(
        f"{where} must be the name of a world, FILE.py:NAME, a World, or a function of a State that returns an array "
        f"(6,) of force and torque; got {quote(given)}"
    )
