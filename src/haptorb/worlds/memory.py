"""The memory of a world: named numbers with units, in a structured array of one record.

Every field is float64, a flag is 0 or 1: so a memory is also a plain row of numbers, which is recorded, sent to the
console and checked for non-finite numbers without a loop over fields.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from math import prod
from typing import Any

import numpy as np

from haptorb.errors import InputError, quote
from haptorb.numerics.arrays import Array, Records

__all__ = ["MemoryField", "check_memory", "count_numbers", "find_number", "make_memory", "memory_dtype", "numbers_of"]


@dataclass(frozen=True)
class MemoryField:
    """One named part of a world's memory: a number, or an array of `shape`, in `unit`.

    >>> MemoryField("place", "m", "of the ball, stator frame", (3,)).size
    3
    """

    name: str
    unit: str
    about: str
    shape: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if not (isinstance(self.name, str) and self.name.isidentifier()):
            raise InputError(f"a memory field needs a name like 'place'; got {quote(self.name)}")
        if not isinstance(self.shape, tuple) or any(type(n) is not int or n < 1 for n in self.shape):
            raise InputError(
                f"memory field '{self.name}': its shape must be a tuple of whole numbers above 0, () for a single "
                f"number; got {quote(self.shape)}"
            )

    @property
    def size(self) -> int:
        """Number of elements."""
        return prod(self.shape)


@cache
def memory_dtype(fields: tuple[MemoryField, ...]) -> np.dtype[Any]:
    """The dtype of a memory with these `fields`: all float64, contiguous.

    Raises InputError for no fields, and for two fields of the same name.
    """
    names = [field.name for field in fields]
    if not names or len(set(names)) != len(names):
        raise InputError(f"a memory needs fields, each with its own name; got {quote(names)}")
    return np.dtype([(field.name, np.float64, field.shape) for field in fields])


def make_memory(fields: tuple[MemoryField, ...]) -> Records:
    """(1,) a record with these `fields`, all zero, in their units.

    >>> memory = make_memory((MemoryField("speed", "m/s", "of the fluid"),))
    >>> memory["speed"].tolist()
    [0.0]
    """
    return np.zeros(1, dtype=memory_dtype(tuple(fields)))


def numbers_of(memory: Records) -> Array:
    """(n,) all numbers of `memory` (1,) in the order of its fields, each in the unit [..] of its field: a view."""
    return memory.view(np.float64)


def count_numbers(fields: Sequence[MemoryField]) -> int:
    """How many numbers a memory with these `fields` has."""
    return sum(field.size for field in fields)


def find_number(fields: Sequence[MemoryField], name: str, row: int = 0) -> int:
    """The index of the first number of the field `name`, or of its `row`, among all numbers of the memory.

    Raises InputError if there is no such field or row.
    """
    start = 0
    for field in fields:
        if field.name == name:
            if not 0 <= row < (field.shape[0] if len(field.shape) > 1 else 1):
                raise InputError(f"memory field '{name}' has no row {row}; its shape is {field.shape}")
            return start + row * (prod(field.shape[1:]) if len(field.shape) > 1 else 0)
        start += field.size
    raise InputError(f"the memory has no field '{name}'; it has {', '.join(field.name for field in fields)}")


def check_memory(memory: object, name: str) -> Records:
    """`memory` itself, (1,) a record of float64 fields in their own units.

    Raises InputError, naming the world `name`, for anything else and for numbers that are not finite.
    """
    if not isinstance(memory, np.ndarray) or memory.dtype.names is None:
        raise InputError(
            f"world '{name}': begin must return a structured array of one record, such as from make_memory(fields); "
            "got "
            f"{quote(memory)}"
        )
    if memory.shape != (1,) or not memory.flags.writeable:
        raise InputError(
            f"world '{name}': begin must return one record, shape (1,), that may be written to; got shape "
            f"{memory.shape}"
        )
    others = [path for path, kind in _leaves(memory.dtype) if kind != np.float64]
    if others or memory.dtype.itemsize != 8 * _size(memory.dtype):
        raise InputError(
            f"world '{name}': every field of a memory must be float64 (a flag is 0.0 or 1.0), without gaps; "
            f"{', '.join(others) or 'its fields'} is not: use make_memory(fields)"
        )
    if not np.isfinite(numbers_of(memory)).all():
        raise InputError(f"world '{name}': its memory begins with a number that is not finite")
    return memory


def _leaves(dtype: np.dtype[Any], path: str = "") -> Iterator[tuple[str, Any]]:
    for name in dtype.names or ():
        kind = dtype[name]
        base = kind.subdtype[0] if kind.subdtype else kind
        if base.names is None:
            yield f"{path}{name}", base
        else:
            yield from _leaves(base, f"{path}{name}.")


def _size(dtype: np.dtype[Any]) -> int:
    total = 0
    for name in dtype.names or ():
        kind = dtype[name]
        base, shape = kind.subdtype if kind.subdtype else (kind, ())
        total += prod(shape) * (_size(base) if base.names else 1)
    return total
