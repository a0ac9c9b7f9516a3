"""What a part of the chain remembers from tick to tick, as arrays of fixed size: the interface of all such parts.

A snapshot copies these arrays into memory that exists already (`haptorb.runtime.tick.tick_state`), so that a loop may
take one between two ticks. Most parts change their arrays in place, and there is nothing else to do. What a part holds
elsewhere, such as the last estimate, it brings into its arrays in `gather_state`, and takes back in `apply_state`.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import prod
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["StateArray", "Stateful", "choose", "make_block", "make_numbers"]

StateArray: TypeAlias = NDArray[Any]
_NOTHING: Mapping[str, Any] = {}


class Stateful:
    """A part that may remember something; by default it remembers nothing.

    state_kind  which of several kinds of part this is, in the names of a recording; empty where there is one only
    """

    state_kind: ClassVar[str] = ""

    def state_arrays(self) -> Mapping[str, StateArray]:
        """Name → array of float64, int64 or bool, or of records of these; the same arrays in each call, of the same
        shapes for the same device: all that it remembers, in its own units."""
        return _NOTHING

    def state_parts(self) -> Mapping[str, Stateful]:
        """Name → its own parts that remember something; the same in each call."""
        return _NOTHING

    def gather_state(self) -> None:
        """Bring into the arrays what is held elsewhere. Within a tick's time: it must not allocate."""

    def apply_state(self) -> None:
        """The arrays were written: take over what is held elsewhere. Raises ValueError for what cannot be."""


def make_block(
    shapes: Mapping[str, tuple[int, ...]], **numbers: tuple[str, ...]
) -> tuple[dict[str, NDArray[Any]], Any]:
    """Arrays of float64 of these shapes, and a record (1,) of float64 for each of `numbers`, name → its fields; and all
    numbers of the records in turn. All lie in one block of memory, which a snapshot copies at once.

    Through the numbers, a memoryview, one is written three times faster than in its record.

    >>> arrays, cells = make_block({"place": (3,)}, counts=("ticks", "trips"))
    >>> cells[1] = 7.0
    >>> arrays["counts"]["trips"].tolist()
    [7.0]
    """
    width = sum(map(len, numbers.values()))
    block = np.zeros(width + sum(map(prod, shapes.values())))
    found: dict[str, NDArray[Any]] = {}
    at = 0
    for name, fields in numbers.items():
        found[name] = block[at : at + len(fields)].view(np.dtype([(field, "f8") for field in fields]))
        at += len(fields)
    for name, shape in shapes.items():
        found[name] = block[at : at + prod(shape)].reshape(shape)
        at += prod(shape)
    return found, block[:width].data


def make_numbers(*names: str) -> tuple[StateArray, Any]:
    """(1,) a record of float64 with these names, and its numbers in turn, as `make_block` has them."""
    arrays, cells = make_block({}, numbers=names)
    return arrays["numbers"], cells


def choose(number: float, count: int) -> int:
    """`number` as an index below `count`. Raises ValueError if it is none."""
    if not (0.0 <= number < count and number == int(number)):
        raise ValueError(f"{number!r} is not a whole number below {count}")
    return int(number)
