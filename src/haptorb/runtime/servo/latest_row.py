"""The newest tick of a servo, by field name, with units."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any, final

import numpy as np
from numpy.typing import DTypeLike

from haptorb.control.protection.trip import CoilState, GuardState, Trip
from haptorb.display.html import facts_html
from haptorb.display.quantity_text import format_number, format_quantity, format_vector
from haptorb.errors import UnknownName
from haptorb.numerics.arrays import Array
from haptorb.runtime.row import RowLayout

__all__ = ["LatestRow"]

#: what people call a field first → its name
_ALSO = {"temperature": "winding"}
_STATES = {"guard": GuardState, "trip": Trip, "coil_state": CoilState}
_ICE = 273.15  #: [K]


@final
class LatestRow:
    """One tick: `row.given` or `row["given"]`, in SI units; `row.units["given"]` is the unit.

    A field with one number is a float, any other an array (width,). `row.temperature` is `row.winding`. `row.numbers`
    holds all numbers in the order of the layout; a slice of the layout selects from it, as `row[layout["p"]]`.
    `print(row)` shows every field with its unit.

    >>> layout = RowLayout(channels=1, sensors=0)
    >>> row = LatestRow(layout, np.zeros(layout.width))
    >>> row.gain, row["p"].tolist(), row.units["p"]
    (0.0, [0.0, 0.0, 0.0], 'm')
    >>> row["giben"]  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    haptorb.errors.UnknownName: unknown field of a row 'giben'; did you mean 'given'? (known: age, ...)
    """

    __slots__ = ("layout", "numbers")

    def __init__(self, layout: RowLayout, numbers: Array) -> None:
        """`numbers` (width,) in the order and the units [..] of `layout`."""
        self.layout = layout
        self.numbers = numbers

    @property
    def units(self) -> MappingProxyType[str, str]:
        """The unit of every field by its name; "N, N·m": three numbers in newtons, three in newton metres."""
        units = {field.name: field.unit for field in self.layout.fields}
        return MappingProxyType(units | {also: units[name] for also, name in _ALSO.items()})

    def __getitem__(self, name: str | slice | int) -> Any:
        """The field `name`, or numbers at places of the layout. Raises UnknownName if there is no such field."""
        if not isinstance(name, str):
            return self.numbers[name]
        known = {field.name: field.width for field in self.layout.fields}
        name = _ALSO.get(name, name)
        if name not in known:
            raise UnknownName("field of a row", name, [*known, *_ALSO])
        values = self.numbers[self.layout[name]]
        return float(values[0]) if known[name] == 1 else values

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name in self.__slots__:  # what Python itself looks for
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
        """When it was, what the guard does, and the main quantities with their units; two lines."""
        coils = _describe_state("coil_state", self.coil_state)
        warm = f"winding at most {format_number(float(np.max(self.winding)) - _ICE)} °C"
        main = [f"{name} {self._format(name)}" for name in ("p", "asked", "given")]
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
        """The value of a field with its unit, and in words where it is a code."""
        value, unit = self[name], self.units[name]
        if name in _STATES:
            return f"{format_number(value)} ({_describe_state(name, value)})"
        if isinstance(value, float):
            return format_quantity(value, unit.removeprefix("1"), 15 if name == "tick" else 4)
        if unit == "N, N·m":
            return f"{format_vector(value[:3], 'N')}, {format_vector(value[3:], 'N·m')}"
        return format_vector(value, unit.removeprefix("1"), 4)


def _describe_state(name: str, code: float) -> str:
    """The code's name; `unknown` for a number that is none."""
    kind = _STATES[name]
    found = [one for one in kind if one.value == code]
    return found[0].name.lower().replace("_", " ") if found else "unknown"
