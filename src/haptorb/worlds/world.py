"""The abstract world: it maps the state of the mover to a wrench. Worlds add."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from haptorb.devices.device import Device
from haptorb.devices.state import State
from haptorb.display.html import table_html
from haptorb.display.presentable import Presentable
from haptorb.display.quantity_text import format_number
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.worlds import parameter as _parameter
from haptorb.worlds.wrench_part import WrenchPart, join_parts

__all__ = ["Sum", "TargetWorld", "World"]

_LONGEST = 160  #: characters of a `repr`


def _cut(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"


def _format_value(value: float | tuple[float, ...]) -> str:
    return f"({', '.join(f'{x:g}' for x in value)})" if isinstance(value, tuple) else f"{value:g}"


def _to_tuple(value: Any) -> Any:
    """Arrays and lists as tuples, a number of numpy's as Python's."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    return tuple(value) if isinstance(value, list) else value


@dataclass(frozen=True)
class World(Presentable, ABC):
    """A world renders a wrench (6,) for a state: force [N] and torque about the mover's origin [N·m], frame S.

    It has no clock and no memory: two calls with the same state give the same wrench. A `DynamicWorld` has a memory.
    """

    passive: ClassVar[bool] = True  #: no closed path can take energy out of it
    continuous: ClassVar[bool] = True  #: no jumps: a small step of the state is a small step of the wrench
    #: acts on a target that a device moves through modes, whose frame is not the stator's
    needs_target: ClassVar[bool] = False
    #: part of the wrench that it asks of a tool; None: every part that is not zero
    asks: ClassVar[WrenchPart | None] = None
    remembers: ClassVar[bool] = False  #: a `DynamicWorld`: it has a memory, and renders more than a state

    def __post_init__(self) -> None:
        _parameter.check(self)

    @property
    def name(self) -> str:
        """Its name in lists of worlds: the class name in lower case."""
        return type(self).__name__.lower()

    @property
    def wrench_code(self) -> Callable[..., Any]:
        """The code that computes the wrench, for messages about it."""
        return type(self).wrench

    @abstractmethod
    def wrench(self, state: State) -> Array:
        """(6,) the wrench on the mover at `state`."""

    @property
    def bound(self) -> float:
        """Largest force that it can ask [N], anywhere a mover can be; inf if no bound is known."""
        return float("inf")

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks about the world with its current parameters, such as the stress in a hook."""
        return ()

    def _summarize(self) -> str:
        """As a call: all parameters, or, where that is long, those that are not at their defaults."""
        known, now = _parameter.parameters(type(self)), _parameter.values(self)
        name = type(self).__name__
        whole = f"{name}({', '.join(f'{key}={_format_value(value)}' for key, value in now.items())})"
        if len(whole) <= _LONGEST:
            return whole
        other = [f"{key}={_format_value(value)}" for key, value in now.items() if value != known[key].default]
        return _cut(f"{name}({', '.join(other)})")

    def _list_facts(self) -> list[tuple[str, str]]:
        bound = f"{format_number(self.bound)} N" if np.isfinite(self.bound) else "no bound is known"
        yes = {True: "yes", False: "no"}
        facts = [("largest force", bound), ("passive", yes[self.passive]), ("continuous", yes[self.continuous])]
        facts += [("asks", self.asks.replace("both", "force and torque"))] if self.asks else []
        return facts + [("remark", remark) for remark in self.remarks]

    def _picture_html(self) -> str:
        """Every parameter: value, unit, range and meaning."""
        now = _parameter.values(self)
        rows = [
            [
                f"{one.name}: {one.about}",
                _format_value(now[one.name]) + (f" {one.unit}" if one.unit not in ("", "1") else ""),
                f"{one.low:g} to {one.high:g}",
            ]
            for one in _parameter.parameters(type(self)).values()
        ]  # fmt: skip
        return table_html(["parameter", "value", "range"], rows) if rows else ""

    def for_device(self, device: Device) -> World:
        """This world adapted to `device`; by default the world itself.

        Raises InputError for a device without a target, if this world needs one.
        """
        if self.needs_target and not device.kind.modes:
            raise InputError(
                f"world {type(self).__name__} acts on a target that a device moves in two modes; device "
                f"'{device.name}' ({device.kind.title}) has none: choose another world, or a "
                "device with modes, such as pmsm"
            )
        return self

    def replace(self, **values: Any) -> Self:
        """A copy with some parameters changed; UnknownName and InputError as in the constructor."""
        _parameter.check_names(type(self), values)
        tuples = {key: _to_tuple(value) for key, value in values.items()}
        return replace(self, **tuples)

    def __add__(self, other: World) -> Sum:
        """Both at once."""
        if other.remembers:
            return NotImplemented  # `DynamicWorld` adds both kinds
        parts = [part for world in (self, other) for part in (world.parts if isinstance(world, Sum) else (world,))]
        return Sum(tuple(parts))


@dataclass(frozen=True)
class TargetWorld(World):
    """A world that acts on a target that a device moves in two modes, such as a plug in its socket.

    Its states and wrenches are the target's, in a frame that is not the stator's: a device on whose tool the world
    would act directly refuses it.
    """

    needs_target: ClassVar[bool] = True


@dataclass(frozen=True)
class Sum(World):
    """Several worlds together: their wrenches add."""

    parts: tuple[World, ...] = ()

    def __post_init__(self) -> None:
        World.__post_init__(self)
        for promise in ("passive", "continuous"):  # of the class, but a sum keeps only what all of its parts keep
            object.__setattr__(self, promise, all(getattr(part, promise) for part in self.parts))
        object.__setattr__(self, "asks", join_parts(part.asks for part in self.parts))

    @property
    def bound(self) -> float:
        """The sum of the parts' bounds [N]."""
        return sum(part.bound for part in self.parts)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Those of all parts."""
        return tuple(remark for part in self.parts for remark in part.remarks)

    def _summarize(self) -> str:
        return _cut(" + ".join(map(repr, self.parts)) or "Sum()")

    def _picture_html(self) -> str:
        """The parameters of all parts."""
        return "".join(part._repr_html_() for part in self.parts)

    def wrench(self, state: State) -> Array:
        """(6,) the sum over the parts [N, N·m]."""
        total = np.zeros(6)
        for part in self.parts:
            total += part.wrench(state)
        return total

    def for_device(self, device: Device) -> Self:
        """Every part adapted to `device`."""
        return replace(self, parts=tuple(part.for_device(device) for part in self.parts))
