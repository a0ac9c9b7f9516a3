"""Abstract world: maps the state of the mover to a wrench. Worlds can be added."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from typing import Any, ClassVar, Final, Literal, Self, cast

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.base import Device, State
from haptorb.display import Presentable, format_number, table_html
from haptorb.earlier_names import warn_earlier
from haptorb.errors import InputError, UnknownName, quote

__all__ = [
    "PARTS",
    "SHAPES",
    "ContactWorld",
    "ObjectWorld",
    "Parameter",
    "Shape",
    "Sum",
    "World",
    "WrenchPart",
    "check",
    "check_part",
    "find_part",
    "is_other_world",
    "join_parts",
    "parameter",
    "parameters",
    "values",
]


# --------------------------------------------------------------------------------------------------
# The part of a wrench that a world defines, and the part that is rendered: force, torque, or both.


WrenchPart = Literal["force", "torque", "both"]

PARTS: Final[tuple[WrenchPart, ...]] = ("force", "torque", "both")  #: their positions are the numbers in recordings


def check_part(name: str) -> WrenchPart:
    """Return `name` if it is valid. Raises UnknownName with the most similar name.

    >>> check_part("torque")
    'torque'
    """
    for part in PARTS:
        if part == name:
            return part
    raise UnknownName("part of a wrench to render", name, PARTS)


def join_parts(parts: Iterable[WrenchPart | None]) -> WrenchPart | None:
    """Return the part that worlds with these `parts` define together; None if one of them does not declare it.

    >>> join_parts(["force", "torque"]), join_parts(["force", None]), join_parts([])
    ('both', None, 'force')
    """
    whole = set(parts)
    if None in whole and "both" not in whole:
        return None
    named = whole - {None}
    if len(named) > 1:
        return "both"
    return named.pop() if named else "force"


def find_part(wrench: Array) -> WrenchPart | None:
    """Return the nonzero part of a `wrench` (6,) [N, N·m]; None for a zero wrench.

    >>> import numpy as np
    >>> find_part(np.array([0, 0, 0, 0, 0.01, 0])), find_part(np.array([1.0, 0, 0, 0, 0, 1e-3])), find_part(np.zeros(6))
    ('torque', 'both', None)
    """
    pushes, turns = bool(wrench[:3].any()), bool(wrench[3:].any())
    if pushes and turns:
        return "both"
    return "force" if pushes else "torque" if turns else None


# --------------------------------------------------------------------------------------------------
# The parameters of a world: range, unit and description, checked at every input.
#
# Parameters are the fields of the world's dataclass; those declared with `parameter(...)` get a slider in the console,
# a line in `haptorb worlds NAME` and a check in every constructor.


@dataclass(frozen=True)
class Parameter:
    """A parameter: `size` numbers (1, or 3 for a direction) between `low` and `high` in `unit`."""

    name: str
    unit: str
    low: float
    high: float
    about: str
    default: float | tuple[float, ...]

    @property
    def size(self) -> int:
        """Number of elements."""
        return len(self.default) if isinstance(self.default, tuple) else 1


def parameter(default: float | tuple[float, ...], unit: str, low: float, high: float, about: str) -> Any:
    """Declare a parameter of a world: a dataclass field with unit, range and meaning.

    The console shows a slider for it, `--set` accepts its value in any unit of the same dimension, and every
    constructor checks it.

    Parameters
    ----------
    default : float or tuple of float
        Default value in `unit`, or 3 numbers for a direction.
    unit : str
        Unit of the value, SI, such as "N/m"; "1" for a plain number.
    low : float
        Smallest allowed value in `unit`.
    high : float
        Largest allowed value in `unit`.
    about : str
        Meaning, in a few words.

    Returns
    -------
    dataclasses.Field
        The field, to be assigned in the class body.

    Examples
    --------
    >>> @dataclass(frozen=True)
    ... class Spring:
    ...     stiffness: float = parameter(20.0, "N/m", 0, 200, "stiffness across the groove")
    >>> Spring().stiffness, parameters(Spring)["stiffness"].unit
    (20.0, 'N/m')
    """
    return field(default=default, metadata={"unit": unit, "low": low, "high": high, "about": about})


def parameters(world: type[Any]) -> dict[str, Parameter]:
    """The parameters of a world's class, by name, in the order of declaration."""
    found = {}
    for item in fields(world):
        if "about" in item.metadata and item.default is not MISSING:
            found[item.name] = Parameter(item.name, default=item.default, **item.metadata)
    return found


def values(world: Any) -> dict[str, float | tuple[float, ...]]:
    """The current values of a world's parameters."""
    return {name: getattr(world, name) for name in parameters(type(world))}


def check(world: Any) -> None:
    """Raise InputError if a parameter of `world` is not finite or outside its range; called by every constructor."""
    kind = type(world).__name__
    for name, known in parameters(type(world)).items():
        value = getattr(world, name)
        several = isinstance(value, tuple | list)
        # safety: list-no-number
        if several is not isinstance(known.default, tuple) or (several and len(value) != known.size):
            wanted = f"{known.size} numbers" if isinstance(known.default, tuple) else "a finite number, not a list"
            raise InputError(f"{kind}.{name} must be {wanted}; got {quote(value)}")
        for number in value if several else (value,):
            if isinstance(number, bool) or not isinstance(number, int | float) or not _is_finite(number):
                raise InputError(f"{kind}.{name} must be a finite number; got {quote(value)}")
            if not known.low <= number <= known.high:
                raise InputError(
                    f"{kind}.{name} must lie between {known.low:g} and {known.high:g} {known.unit}; got {number:g}"
                )


def _is_finite(number: float) -> bool:
    try:
        return math.isfinite(number)
    except OverflowError:  # an integer outside the range of a float
        return False


def check_names(world: type[Any], given: Mapping[str, Any]) -> None:
    """Raise UnknownName for the first key of `given` that is not a parameter of `world`."""
    known = parameters(world)
    for name in given:
        if name not in known:
            raise UnknownName(f"parameter of {world.__name__}", name, known)


def is_other_world(one: object, other: object) -> bool:
    """Whether two worlds differ in more than the values of their parameters: in class, function, scene or parts.

    >>> is_other_world(Sum(), Sum())
    False
    """
    if type(one) is not type(other):
        return True
    known = parameters(type(one))
    kept = [item.name for item in fields(cast("World", one)) if item.compare and item.name not in known]
    return any(not _is_equal(getattr(one, name), getattr(other, name)) for name in kept)


def _is_equal(one: Any, other: Any) -> bool:
    """Whether two values of a world's field are the same; of worlds within a world, whether none is another one."""
    if one is other:
        return True
    if type(one) is not type(other):
        return False
    if isinstance(one, World):
        return not is_other_world(one, other)
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(map(_is_equal, one, other))
    if is_dataclass(one):
        return all(_is_equal(getattr(one, item.name), getattr(other, item.name)) for item in fields(one))
    return bool(one == other)


_MAX_REPR_CHARACTERS = 160  #: length of a `repr`


def _cut(text: str) -> str:
    return text if len(text) <= _MAX_REPR_CHARACTERS else f"{text[: _MAX_REPR_CHARACTERS - 1]}…"


def _format_value(value: float | tuple[float, ...]) -> str:
    return f"({', '.join(f'{x:g}' for x in value)})" if isinstance(value, tuple) else f"{value:g}"


def _to_tuple(value: Any) -> Any:
    """Convert arrays and lists to tuples, and a number of numpy to Python's."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    return tuple(value) if isinstance(value, list) else value


@dataclass(frozen=True)
class World(Presentable, ABC):
    """Virtual object or force: renders a wrench for a state; the base class of every world.

    A subclass is a frozen dataclass that implements `wrench`, which returns (6,): force [N], then torque about the
    mover's origin [N·m], in the stator frame. It has no clock and no memory: the same state gives the same wrench. A
    `DynamicWorld` has a memory. Worlds add: `Dome() + Wall()`.

    Attributes
    ----------
    passive : bool
        Whether no closed path can extract energy from it.
    continuous : bool
        Whether the wrench has no jumps.
    needs_object : bool
        Whether it acts on the object that a device moves through modes, whose frame is not the stator's.
    asks : str or None
        Part of the wrench that it defines, "force", "torque" or "both"; None: every part that is not zero.
    remembers : bool
        Whether it has a memory, as a `DynamicWorld` has.

    Examples
    --------
    >>> import numpy as np
    >>> from haptorb import State
    >>> @dataclass(frozen=True)
    ... class Groove(World):
    ...     def wrench(self, state):
    ...         return np.array([0.0, -40.0 * state.p[1], 0.0, 0.0, 0.0, 0.0])
    >>> Groove().wrench(State.at((0, 0.01, 0.05)))[1].item()
    -0.4
    """

    passive: ClassVar[bool] = True
    continuous: ClassVar[bool] = True
    needs_object: ClassVar[bool] = False
    asks: ClassVar[WrenchPart | None] = None
    remembers: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "needs_target" in cls.__dict__:
            warn_earlier(f"{cls.__name__}: a world's `needs_target` is now called `needs_object`")
            cls.needs_object = cls.__dict__["needs_target"]

    def __post_init__(self) -> None:
        check(self)

    @property
    def name(self) -> str:
        """Name in lists of worlds: the class name in lower case."""
        return type(self).__name__.lower()

    @property
    def wrench_code(self) -> Callable[..., Any]:
        """Code that computes the wrench, for messages."""
        return type(self).wrench

    @abstractmethod
    def wrench(self, state: State) -> Array:
        """Render the wrench at a state.

        Parameters
        ----------
        state : State
            Pose and motion of the mover.

        Returns
        -------
        ndarray, shape (6,)
            Force [N], then torque about the mover's origin [N·m], in the stator frame.
        """

    @property
    def bound(self) -> float:
        """Largest force that it can command [N], anywhere a mover can be; inf if no bound is known."""
        return float("inf")

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks about the world with its current parameters, such as the stress in a hook."""
        return ()

    def _summarize(self) -> str:
        """Format as a constructor call: all parameters, or, if that is too long, those with other values than their
        defaults."""
        known, now = parameters(type(self)), values(self)
        name = type(self).__name__
        whole = f"{name}({', '.join(f'{key}={_format_value(value)}' for key, value in now.items())})"
        if len(whole) <= _MAX_REPR_CHARACTERS:
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
        """Table of the parameters: value, unit, range and description."""
        now = values(self)
        rows = [
            [
                f"{one.name}: {one.about}",
                _format_value(now[one.name]) + (f" {one.unit}" if one.unit not in ("", "1") else ""),
                f"{one.low:g} to {one.high:g}",
            ]
            for one in parameters(type(self)).values()
        ]  # fmt: skip
        return table_html(["parameter", "value", "range"], rows) if rows else ""

    def for_device(self, device: Device) -> World:
        """Adapt the world to a device; by default it returns the world itself.

        Parameters
        ----------
        device : Device
            Device that will render it.

        Returns
        -------
        World
            The adapted world.

        Raises
        ------
        InputError
            If the world needs an object, and the device moves none.
        """
        if self.needs_object and not device.kind.modes:
            raise InputError(
                f"world {type(self).__name__} acts on an object that a device moves in two modes; device "
                f"'{device.name}' ({device.kind.title}) has none: choose another world, or a "
                "device with modes, such as pmsm"
            )
        return self

    def replace(self, **values: Any) -> Self:
        """Copy the world with some parameters changed.

        Parameters
        ----------
        **values : float
            New values by name of the parameter, each in the parameter's unit.

        Returns
        -------
        World
            The copy.

        Raises
        ------
        UnknownName
            If there is no such parameter.
        InputError
            If a value is outside its range.
        """
        check_names(type(self), values)
        tuples = {key: _to_tuple(value) for key, value in values.items()}
        return replace(self, **tuples)

    def __add__(self, other: World) -> Sum:
        """Sum of both worlds."""
        if other.remembers:
            return NotImplemented  # `DynamicWorld` adds both kinds
        parts = [part for world in (self, other) for part in (world.parts if isinstance(world, Sum) else (world,))]
        return Sum(tuple(parts))


@dataclass(frozen=True)
class ObjectWorld(World):
    """World that acts on an object that a device moves in two modes, such as a plug in its socket.

    Its states and wrenches are the object's, in a frame that is not the stator's: a device that acts directly rejects
    it.
    """

    needs_object: ClassVar[bool] = True


@dataclass(frozen=True)
class Sum(World):
    """Sum of several worlds: their wrenches add. `first + second` creates one.

    Parameters
    ----------
    parts : tuple of World
        The worlds.
    """

    parts: tuple[World, ...] = ()

    def __post_init__(self) -> None:
        World.__post_init__(self)
        for promise in ("passive", "continuous"):  # class properties; a sum has them only if all its parts do
            object.__setattr__(self, promise, all(getattr(part, promise) for part in self.parts))
        object.__setattr__(self, "asks", join_parts(part.asks for part in self.parts))

    @property
    def bound(self) -> float:
        """Sum of the parts' bounds [N]."""
        return sum(part.bound for part in self.parts)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks of all parts."""
        return tuple(remark for part in self.parts for remark in part.remarks)

    def _summarize(self) -> str:
        return _cut(" + ".join(map(repr, self.parts)) or "Sum()")

    def _picture_html(self) -> str:
        """Parameters of all parts."""
        return "".join(part._repr_html_() for part in self.parts)

    def wrench(self, state: State) -> Array:
        """(6,) sum over the parts [N, N·m]."""
        total = np.zeros(6)
        for part in self.parts:
            total += part.wrench(state)
        return total

    def for_device(self, device: Device) -> Self:
        """Adapt every part to `device`."""
        return replace(self, parts=tuple(part.for_device(device) for part in self.parts))


# --------------------------------------------------------------------------------------------------
# A world that reports its contacts, for drawing and recording.


@dataclass(frozen=True)
class ContactWorld(World):
    """World that computes its wrench from contacts, which are recorded and drawn.

    A subclass implements `render_contacts`. The record of the kind of device states how many contacts its rows have
    (`DeviceKind.contacts`); excess contacts are left out.
    """

    @abstractmethod
    def render_contacts(self, state: State) -> tuple[Array, Array]:
        """Render the wrench at a state, with the contacts that make it.

        Parameters
        ----------
        state : State
            Pose and motion of the mover.

        Returns
        -------
        wrench : ndarray, shape (6,)
            Force [N], then torque about the mover's origin [N·m].
        contacts : ndarray, shape (n, 8)
            Per contact: deflection [m], distance of the contact from the root [m], point [m] (3), force on the object
            [N] (3); zero for an open contact.
        """

    def wrench(self, state: State) -> Array:
        """(6,) wrench on the mover at `state` [N, N·m]."""
        return self.render_contacts(state)[0]

    @property
    def wrench_code(self) -> Callable[..., Any]:
        """Code that computes the wrench, for messages."""
        return type(self).render_contacts


# --------------------------------------------------------------------------------------------------
# Bodies that the console draws for a world with memory, at poses from its memory.


#: kind → number of elements of its `size`, all [m]: sphere radius; capsule and cylinder radius and half length along
#: their own z axis; box half lengths; ellipsoid radii; a mesh has points
SHAPES = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3, "ellipsoid": 3, "mesh": 0}


@dataclass(frozen=True)
class Shape:
    """Body that the console draws at a pose from a world's memory.

    Parameters
    ----------
    name : str
        Name of the body.
    kind : str
        "sphere", "capsule", "cylinder" or "box", see `SHAPES`.
    size : tuple of float
        Dimensions [m].
    place : str
        Memory field with the centre, shape (3,) [m], in the frame of the world's states.
    attitude : str
        Memory field with the orientation, a quaternion (x, y, z, w); empty: along the frame.
    row : int
        Row of these fields, if they are tables of shape (n, 3) and (n, 4).
    at : tuple of float
        Initial centre [m] and quaternion, 7 numbers; without place and attitude the body stays there.
    role : str
        "held", "moves", "fixed" or "path", for the colour; empty: there is only one kind of body.
    points : tuple of float
        Coordinates x, y, z of a mesh's n vertices [m], 3 n numbers.
    corners : tuple of int
        Indices of the vertices of its m triangles, 3 m numbers.
    """

    name: str
    kind: str
    size: tuple[float, ...]
    place: str
    attitude: str = ""
    row: int = 0
    at: tuple[float, ...] = ()
    role: str = ""
    points: tuple[float, ...] = ()
    corners: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.kind not in SHAPES:
            raise UnknownName("shape", self.kind, SHAPES)
        if len(self.size) != SHAPES[self.kind] or not all(0.0 < one < 10.0 for one in self.size):
            raise InputError(
                f"shape '{self.name}': a {self.kind} has {SHAPES[self.kind]} measures above 0 m and below 10 m; got "
                f"{self.size}"
            )
