"""Parameters of the present world that programs set: checked as the console checks them, and asked for together.

A fader sends a hundred values a second. The newest of each parameter is asked for, at most twenty times a second.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias, final

from haptorb.apps.serve.served_device import ServedDevice
from haptorb.errors import InputError, UnknownName, quote
from haptorb.worlds import CATALOGUE, find_world
from haptorb.worlds.parameter import Parameter, parameters

__all__ = ["WorldRequests"]

_EVERY = 0.05  #: between two requests [s]
_PATIENCE = 2.0  #: a request that was not met until then is forgotten [s]

Value: TypeAlias = float | tuple[float, ...]


@final
class WorldRequests:
    """What programs want of the world of `served`."""

    def __init__(self, served: ServedDevice) -> None:
        self._served = served
        self._name, self._values = "", dict[str, Value]()
        self._sent: object = None
        self._next, self._until = 0.0, 0.0

    @property
    def name(self) -> str:
        """Name of the world: of the requested one, until it is there."""
        return self._name or str(self._served.world.get("name", ""))

    def list_parameters(self) -> list[tuple[Parameter, Value]]:
        """The parameters of the present world with their values, in their own units."""
        world = self._served.world
        known = CATALOGUE.get(world.get("name", ""))
        values = world.get("values", {})
        if known is None:  # a person's own world: the range is known to the loop's process only
            return [(_describe_own(name, value), _to_value(value)) for name, value in values.items()]
        return [(one, _to_value(values.get(name, one.default))) for name, one in parameters(known).items()]

    def set(self, name: str, value: Value, now: float) -> None:
        """Wish for the parameter `name` to be `value`, in its own unit. Raises UnknownName or InputError if it cannot
        be."""
        world = self.name
        if world in CATALOGUE:
            find_world(world)().replace(**{name: value}).for_device(self._served.device)
        else:
            known = self._served.world.get("values", {})
            if name not in known:
                raise UnknownName(f"parameter of world '{world}'", name, known)
            if isinstance(value, tuple) is not isinstance(known[name], list):
                raise InputError(f"parameter {name} has another number of values; got {quote(value)}")
        self._name = world
        self._values[name] = value
        self._until = now + _PATIENCE

    def change(self, name: str, now: float) -> None:
        """Wish for the world `name` with its default values. Raises UnknownName or InputError if there is none, or
        none for this device."""
        if name != self._served.world.get("name"):
            find_world(name)().for_device(self._served.device)
        self._name, self._values, self._until = name, {}, now + _PATIENCE

    def tell(self, now: float) -> None:
        """Pass on what is requested and not there yet, if it is time."""
        if not self._name or now < self._next:
            return
        if now > self._until or self._is_true():
            self._name, self._values, self._sent = "", {}, None
            return
        request = (self._name, dict(self._values))
        if request != self._sent:
            self._served.request_world(*request)
            self._sent, self._next = request, now + _EVERY

    def _is_true(self) -> bool:
        world = self._served.world
        values: Mapping[str, Any] = world.get("values", {})
        return world.get("name") == self._name and all(
            _to_value(values.get(name)) == value for name, value in self._values.items()
        )


def _to_value(value: Any) -> Value:
    return tuple(value) if isinstance(value, list) else value


def _describe_own(name: str, value: Any) -> Parameter:
    return Parameter(name, "", float("-inf"), float("inf"), "", _to_value(value))
