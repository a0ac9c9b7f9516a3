"""Layout of one tick as a flat row of float64, shared by servo, recorder, replay and console.

Publishing a flat row takes a third of a microsecond, structured fields seven times that. `RowLayout.fields` is the only
description of the row: code that writes or evaluates rows takes the indices from `RowLayout.places`, recordings store
the fields as their schema, and the documentation generates a table of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from types import MappingProxyType
from typing import Any, final

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import DTypeLike

from haptorb.arrays import Array, Records
from haptorb.control.trip_reasons import CoilState, GuardState, Trip
from haptorb.devices.base import Device
from haptorb.display import facts_html, format_number, format_quantity, format_vector
from haptorb.earlier_names import warn_earlier
from haptorb.errors import UnknownName

__all__ = ["EARLIER_NAMES", "MEMORY_ROOM", "STAGES", "Field", "FieldColumn", "LatestRow", "RowLayout", "resolve_name"]


#: minimum room for a world's memory in a row [numbers]; a servo whose world needs more has longer rows
MEMORY_ROOM = 32

#: stages of a tick, in order; a row contains the time spent in each
STAGES = ("read", "estimate", "world", "allocate", "guard", "write", "record")


#: field names before version 0.2.0 → present names; recordings, layouts and rows accept both
EARLIER_NAMES: Mapping[str, str] = MappingProxyType(
    {
        "target": "hand_goal", "target_q": "hand_goal_q", "asked": "wrench_commanded", "modelled": "wrench_model",
        "given": "wrench_actual", "wanted": "current_commanded", "currents": "current_measured",
        "duties": "duty_applied", "drive": "duty_commanded", "currents_age": "current_age",
        "share": "clutch_share",
    }
)  # fmt: skip


def resolve_name(name: str) -> str:
    """Return the present name of the field `name`, with a remark if it is one of `EARLIER_NAMES`.

    >>> resolve_name("p")
    'p'
    """
    now = EARLIER_NAMES.get(name)
    if now is None:
        return name
    warn_earlier(f"the field '{name}' is now called '{now}'")
    return now


@dataclass(frozen=True)
class Field:
    """One field of a row: `width` numbers in `unit`."""

    name: str
    width: int
    unit: str
    about: str


@dataclass(frozen=True)
class RowLayout:
    """Layout of a row with `channels` coils, `sensors` field sensors, `contacts` contacts, `memory` numbers of memory.

    The memory is the state of a world, in the order of its fields.
    """

    channels: int
    sensors: int
    contacts: int = 0
    memory: int = 0

    @classmethod
    def of(cls, device: Device, memory: int = MEMORY_ROOM) -> RowLayout:
        """Layout for `device`, with room for `memory` numbers of memory, at least `MEMORY_ROOM`."""
        return cls(device.channels, device.sensors, device.kind.contacts, max(memory, MEMORY_ROOM))

    @cached_property
    def fields(self) -> tuple[Field, ...]:
        """All fields in order."""
        m, k = self.channels, self.sensors
        return (
            Field("tick", 1, "1", "number of the tick since the start"),
            Field("t", 1, "s", "time of the sample, on the loop's clock, zero at the start"),
            Field("wall", 1, "s", "monotonic clock of the computer when the tick began"),
            Field("lateness", 1, "s", "lateness: time from the tick's deadline to its start"),
            Field("missed", 1, "1", "deadlines missed before this tick because the tick before overran"),
            Field("stages", len(STAGES), "s", "time spent in each stage; record: of the tick before"),
            Field("ahead", 1, "s", "time that the driver used before the deadline; a simulated device advances there"),
            Field("guard", 1, "1", "state of the guard: 0 off, 1 ramping, 2 running, 3 derated, 4 tripped"),
            Field("trip", 1, "1", "code of the reason for the last trip, 0 for none"),
            Field("coil_state", 1, "1", "whether current can flow: 0 off (confirmed), 1 on, 2 unknown"),
            Field("gain", 1, "1", "share of the world's wrench that the guard passes, 0 to 1"),
            Field("world", 1, "1", "number of changes of the world"),
            Field("valid", 1, "1", "1 if the pose is valid"),
            Field("age", 1, "s", "age of the pose"),
            Field("p", 3, "m", "estimated position of the mover, stator frame"),
            Field("q", 4, "1", "estimated orientation R_SR as a quaternion (x, y, z, w)"),
            Field("v", 3, "m/s", "estimated velocity"),
            Field("w", 3, "rad/s", "estimated angular velocity, stator frame"),
            Field("hand_goal", 3, "m", "where the hand wants the mover: its goal"),
            Field("hand_goal_q", 4, "1", "orientation of the hand's goal, quaternion (x, y, z, w)"),
            Field("wrench_commanded", 6, "N, N·m", "commanded wrench: that of the world, after the guard's limits"),
            Field("wrench_model", 6, "N, N·m", "wrench of the measured currents, by the controller model"),
            Field("wrench_actual", 6, "N, N·m", "actual wrench of coils and core on the mover; NaN where unknown"),
            Field("current_commanded", m, "A", "commanded currents, after the guard"),
            Field("current_measured", m, "A", "measured currents"),
            Field("duty_applied", m, "1", "applied duties"),
            Field("resistance", m, "Ω", "running estimate of each coil's resistance"),
            Field("boundary", m, "K", "boundary temperature of each coil, measured"),
            Field("winding", m, "K", "winding temperature of each coil, estimated by the guard's thermal model"),
            Field("remaining", 1, "s", "time until a winding reaches its derating temperature at the current load"),
            Field(
                "saturated",
                1,
                "1",
                "what limits the wrench: 0 nothing, 1 a coil's current limit, 2 the supply's power, 3 the limit of "
                "the accompanying force or torque, 4 the magnet's own axis, 5 the number of coils",
            ),
            Field("part", 1, "1", "rendered part of the wrench: 0 force, 1 torque, 2 both; −1: no choice"),
            Field("model", 1, "1", "controller model, index in the device's models; NaN: none of them"),
            Field("field", 3 * k, "T", "field sensors, x y z each"),
            Field("mode", 1, "1", "mode of the mover: 0 direct, 1 translate, 2 rotate"),
            Field("engaged", 1, "1", "clutch: 1 the handle moves the object, 0 released to reach further"),
            Field("clutch_share", 2, "1", "clutch shares of translation and rotation, 0 to 1"),
            Field("object", 3, "m", "position of the object: the mover, or what a motor moves (X', Y', Z')"),
            Field("object_q", 4, "1", "orientation of the object as a quaternion (x, y, z, w)"),
            Field("object_wrench", 6, "N, N·m", "wrench of the world on the object, before modes and guard"),
            Field(
                "contacts",
                8 * self.contacts,
                "m, m, m, N",
                "each contact of the object: deflection, distance from the root, point (3), force (3)",
            ),
            Field(
                "energy",
                1,
                "J",
                "energy delivered to the hand by the commanded wrench since the world started; negative: received",
            ),
            Field(
                "balance",
                1,
                "J",
                "energy dissipated by the minimum damping of a hand, minus the energy generated by sampling and delay",
            ),
            Field("injected", 1, "N·s/m", "damping added because the balance was negative"),
            Field("softened", 1, "1", "share of the world's wrench taken away because the loop went on oscillating"),
            # inputs and outputs of the driver, and commands: a replay needs no other fields
            Field(
                "duty_commanded", m, "1", "duties commanded by the drive, before the driver's clipping and quantisation"
            ),
            Field("current_age", 1, "s", "age of the measured currents at the beginning of the tick"),
            Field("field_age", 1, "s", "age of the field sensors' readings at the beginning of the tick"),
            Field("pose_t", 1, "s", "time at which the tracker's pose was measured, on the loop's clock"),
            Field("pose_valid", 1, "1", "1 if the tracker reports its pose as valid"),
            Field("pose_p", 3, "m", "position of the mover, from the tracker"),
            Field("pose_r", 9, "1", "orientation R_SR of the mover, from the tracker, row by row"),
            Field("pose_v", 3, "m/s", "velocity of the mover, from the tracker"),
            Field("pose_w", 3, "rad/s", "angular velocity of the mover, stator frame, from the tracker"),
            Field(
                "commands",
                1,
                "1",
                "commands before the tick, a sum: 1 stop, 2 engage, 4 cool, 8 another world, 16 another "
                "version of it, 32 lateness not counted, 64 torque scale, 128 translate, 256 rotate, 512 hold, 1024 "
                "release, 2048 times the number of a model, from 1; −1: no tick, the coils are off permanently",
            ),
            Field("torque_scale", 1, "1", "last commanded scale of a motor's torques"),
            Field(
                "failures",
                1,
                "1",
                "failures in the tick, a sum: 1 reading, 2 writing, 4 engaging the driver, 8 the world, 16 its "
                "memory, 32 the allocation; 64 its world reduces detail from the next tick on, 128 restores some; 256 "
                "a step of its world that was computed in the background was taken over",
            ),
            Field("buttons", 1, "1", "pressed buttons of the tool, a sum: 1 a, 2 b, 4 c"),
            Field("grip", 1, "m", "goal of a scripted hand's thumb and finger: their opening; NaN: none"),
            Field("hand_t", 1, "s", "time in a scripted hand's motion, from its start; NaN: none, or not begun"),
            Field("gripper", 1, "m", "measured opening of the device's gripper; NaN: it has none"),
            Field("gripper_v", 1, "m/s", "measured rate of that opening"),
            Field("gripper_force", 1, "N", "force of the gripper between thumb and finger, positive to open"),
            # the last field: a shorter row is filled up to its length
            Field("memory", self.memory, "SI", "memory of the world; the metadata of the world have names and units"),
        )

    @cached_property
    def _slices(self) -> dict[str, slice]:
        slices, start = {}, 0
        for field in self.fields:
            slices[field.name] = slice(start, start + field.width)
            start += field.width
        return slices

    @cached_property
    def places(self) -> Records:
        """Index [1] of the first number of each field, as a record array (1,) for compiled code.

        >>> int(RowLayout(channels=3, sensors=0).places["p"][0])
        20
        """
        places = np.zeros(1, dtype=_make_place_type(tuple(field.name for field in self.fields)))
        for field in self.fields:
            places[field.name] = self[field.name].start
        return places

    @cached_property
    def width(self) -> int:
        """Length of a row."""
        return sum(field.width for field in self.fields)

    def __getitem__(self, name: str) -> slice:
        """Slice of the field `name` in a row.

        >>> RowLayout(channels=3, sensors=0)["p"]
        slice(20, 23, None)
        """
        found = self._slices.get(name)
        return self._slices[resolve_name(name)] if found is None else found

    def empty(self) -> Array:
        """A row of NaN, shape (width,); each number has the unit of its field, such as [m] for `p`."""
        return np.full(self.width, np.nan)


@cache
def _make_place_type(names: tuple[str, ...]) -> np.dtype[Any]:
    """Record type of `RowLayout.places`, cached: numba compares an equal but distinct type field by field, in 3 µs."""
    return np.dtype([(name, np.int64) for name in names])


# --------------------------------------------------------------------------------------------------
# One field of a recording, as an array that is read on access.


Read = Callable[[int, int], Array]  #: rows `first` to `last` − 1 of a field, shape (last − first, width)


@final
class FieldColumn(NDArrayOperatorsMixin):
    """A field over all ticks, read on access: shape (n, width), or (n,) if the width is 1.

    `column[a:b]` reads those ticks only. Arithmetic, NumPy functions and array methods read the whole array.

    >>> column = FieldColumn(lambda a, b: np.arange(a, b, dtype=float)[:, None], 1000, 1)
    >>> column[10:13].tolist(), float(column[-1]), column.shape, float((column + 1).max())
    ([10.0, 11.0, 12.0], 999.0, (1000,), 1000.0)
    """

    def __init__(self, read: Read, rows: int, width: int) -> None:
        self._read, self._rows, self._width = read, rows, width

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the whole array."""
        return (self._rows,) if self._width == 1 else (self._rows, self._width)

    @property
    def ndim(self) -> int:
        """1 if the width is 1, else 2."""
        return len(self.shape)

    @property
    def size(self) -> int:
        """Number of elements."""
        return self._rows * self._width

    @property
    def dtype(self) -> np.dtype[np.float64]:
        """Always float64."""
        return np.dtype(np.float64)

    def __len__(self) -> int:
        """Number of ticks."""
        return self._rows

    def __getitem__(self, key: Any) -> Any:
        """Index like the whole array; an integer or a slice of ticks reads only the ticks between its ends."""
        ticks, rest = (key[0], key[1:]) if isinstance(key, tuple) and key else (key, ())
        if isinstance(ticks, int | np.integer) and not isinstance(ticks, bool):
            if not -self._rows <= ticks < self._rows:
                raise IndexError(f"tick {ticks} does not exist; the recording has {self._rows}")
            at = int(ticks) % self._rows
            return self._load(at, at + 1)[(0, *rest)]
        if isinstance(ticks, slice):
            chosen = range(*ticks.indices(self._rows))
            if not chosen:
                return self._load(0, 0)[(slice(None), *rest)]
            low, high = min(chosen[0], chosen[-1]), max(chosen[0], chosen[-1])
            part = self._load(low, high + 1)
            return part[(slice(None), *rest)] if chosen.step == 1 else part[:: chosen.step][(slice(None), *rest)]
        return self._load(0, self._rows)[key]

    def __iter__(self) -> Iterator[Any]:
        """Iterate over ticks; the whole array is read once."""
        return iter(self._load(0, self._rows))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the whole array, because the receiver may not have the file."""
        return np.array, (np.asarray(self),)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        """The whole array."""
        whole = self._load(0, self._rows)
        if dtype is not None and whole.dtype != dtype:
            return whole.astype(dtype)
        return whole.copy() if copy else whole

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **others: Any) -> Any:
        """Arithmetic with the whole array."""
        return getattr(ufunc, method)(*(np.asarray(x) if isinstance(x, FieldColumn) else x for x in inputs), **others)

    def __getattr__(self, name: str) -> Any:
        """Method or property of the whole array."""
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(np.asarray(self), name)

    def __repr__(self) -> str:
        """Shape, and first and last ticks."""
        ends = np.concatenate((self[:2], self[-2:])) if self._rows else np.empty(0)
        shown = np.array2string(ends, threshold=12, precision=4)
        return f"<FieldColumn of shape {self.shape}, first and last ticks: {shown}>"

    def _load(self, first: int, last: int) -> Array:
        rows = self._read(first, last)
        return rows[:, 0] if self._width == 1 else rows


# --------------------------------------------------------------------------------------------------
# One row, by field name, with units.


#: alternative name of a field → its name
_ALSO = {"temperature": "winding"}
_STATES = {"guard": GuardState, "trip": Trip, "coil_state": CoilState}
_ZERO_CELSIUS_K = 273.15  #: 0 °C [K]


@final
class LatestRow:
    """Values of one tick in SI units, such as `row.wrench_actual` or `row["wrench_actual"]`.

    A field with one number is a float, any other an array (width,). `row.units["wrench_actual"]` is the unit.
    `row.temperature` is `row.winding`. `row.numbers` holds all numbers in the order of the layout; slices of the layout
    index it, as in `row[layout["p"]]`. `print(row)` shows every field with its unit.

    >>> layout = RowLayout(channels=1, sensors=0)
    >>> row = LatestRow(layout, np.zeros(layout.width))
    >>> row.gain, row["p"].tolist(), row.units["p"]
    (0.0, [0.0, 0.0, 0.0], 'm')
    >>> row["wrench_actua"]  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    haptorb.errors.UnknownName: unknown field of a row 'wrench_actua'; did you mean 'wrench_actual'? (known: age, ...)
    """

    __slots__ = ("layout", "numbers")

    def __init__(self, layout: RowLayout, numbers: Array) -> None:
        """`numbers` (width,) in the order and the units [..] of `layout`."""
        self.layout = layout
        self.numbers = numbers

    @property
    def units(self) -> MappingProxyType[str, str]:
        """Unit of each field, by name; "N, N·m": three numbers in newtons, three in newton metres."""
        units = {field.name: field.unit for field in self.layout.fields}
        return MappingProxyType(units | {also: units[name] for also, name in _ALSO.items()})

    def __getitem__(self, name: str | slice | int) -> Any:
        """The field `name`, or the numbers at an index or a slice. Raises UnknownName if there is no such field."""
        if not isinstance(name, str):
            return self.numbers[name]
        known = {field.name: field.width for field in self.layout.fields}
        name = _ALSO.get(name, name)
        if name not in known and name in EARLIER_NAMES:
            name = resolve_name(name)
        if name not in known:
            raise UnknownName("field of a row", name, [*known, *_ALSO])
        values = self.numbers[self.layout[name]]
        return float(values[0]) if known[name] == 1 else values

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name in self.__slots__:  # special attributes that Python looks up
            raise AttributeError(name)
        try:
            return self[name]
        except UnknownName as cause:
            raise AttributeError(str(cause)) from None

    def __dir__(self) -> list[str]:
        return sorted([*super().__dir__(), *self.units])

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> Any:
        return np.array(self.numbers, dtype=dtype) if copy else np.asarray(self.numbers, dtype=dtype)

    def __repr__(self) -> str:
        """Time, state of the guard, and the main quantities with their units; two lines."""
        coils = _describe_state("coil_state", self.coil_state)
        warm = f"winding at most {format_number(float(np.max(self.winding)) - _ZERO_CELSIUS_K)} °C"
        main = [f"{name} {self._format(name)}" for name in ("p", "wrench_commanded", "wrench_actual")]
        return (
            f"<LatestRow of tick {format_number(self.tick, 15)}, {self.t:.3f} s: guard "
            f"{_describe_state('guard', self.guard)}, coils {coils}\n  {'; '.join([*main, warm])}>"
        )

    def __str__(self) -> str:
        """Every field: name, value and unit."""
        return "\n".join(f"{name:14} {text}" for name, text in self._list_facts())

    def _repr_html_(self) -> str:
        return facts_html(f"Tick {format_number(self.tick, 15)} at {self.t:.3f} s", self._list_facts())

    def _list_facts(self) -> list[tuple[str, str]]:
        facts = [(field.name, self._format(field.name)) for field in self.layout.fields if field.width]
        used = np.isfinite(self.numbers[self.layout["memory"]]).any()
        return facts if used else [(name, text) for name, text in facts if name != "memory"]

    def _format(self, name: str) -> str:
        """Format the value of a field with its unit; for a state code, with its name."""
        value, unit = self[name], self.units[name]
        if name in _STATES:
            return f"{format_number(value)} ({_describe_state(name, value)})"
        if isinstance(value, float):
            return format_quantity(value, unit.removeprefix("1"), 15 if name == "tick" else 4)
        if unit == "N, N·m":
            return f"{format_vector(value[:3], 'N')}, {format_vector(value[3:], 'N·m')}"
        return format_vector(value, unit.removeprefix("1"), 4)


def _describe_state(name: str, code: float) -> str:
    """Name of the state `code`; `unknown` for an undefined code."""
    kind = _STATES[name]
    found = [one for one in kind if one.value == code]
    return found[0].name.lower().replace("_", " ") if found else "unknown"
