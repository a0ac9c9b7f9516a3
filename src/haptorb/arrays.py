"""Array types of the whole package, checks of arrays from outside, and small numerical tools."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from math import prod
from typing import Any, ClassVar, TypeAlias, TypeVar, dataclass_transform

import numpy as np
from numpy.typing import ArrayLike, NDArray

from haptorb.errors import InputError, quote

__all__ = [
    "Array",
    "Record",
    "Records",
    "StateArray",
    "Stateful",
    "cap_directions",
    "check_finite",
    "choose",
    "cubic_spline",
    "fields",
    "make_block",
    "make_numbers",
    "one_block",
    "record",
    "rotation",
    "state_zeros",
    "vectors",
]


# --------------------------------------------------------------------------------------------------
# The array types of the whole package, and the checks that every public door makes.


Array: TypeAlias = NDArray[np.float64]
#: a structured array: records with named fields, what compiled code remembers
Records: TypeAlias = NDArray[np.void]
#: one record of it; compiled code hands it on, Python should not (that is slow)
Record: TypeAlias = Any


def fields(*named: tuple[Any, ...]) -> np.dtype[np.void]:
    """The dtype of a record with these fields, (name, type) or (name, type, shape), laid out as compiled code likes it.

    >>> fields(("valid", "?"), ("place", "f8", (3,))).names
    ('valid', 'place')
    """
    return np.dtype(list(named), align=True)


def check_finite(value: ArrayLike, what: str) -> Array:
    """`value` as a float64 array, or InputError naming `what` if a number in it is not finite.

    Any shape (...); the unit [SI] is the caller's.

    >>> check_finite([1, 2], "currents")
    array([1., 2.])
    """
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as cause:
        raise InputError(f"{what} must be numbers; got {quote(value)}") from cause
    if not np.isfinite(array).all():
        raise InputError(f"{what} must be finite; got {quote(value)}")
    return array


def vectors(value: ArrayLike, what: str) -> Array:
    """`value` as an array of 3-vectors, shape (..., 3).

    Raises InputError for another shape or what is not finite.

    >>> vectors([0, 0, 1], "points").shape
    (3,)
    """
    array = check_finite(value, what)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise InputError(f"{what} must be 3-vectors, shape (..., 3); got shape {array.shape}")
    return array


def rotation(value: ArrayLike, what: str, tolerance: float = 1e-6) -> Array:
    """`value` as rotation matrices, shape (..., 3, 3), or InputError saying how far it is from one.

    >>> rotation(np.eye(3), "R_SR").shape
    (3, 3)
    """
    array = check_finite(value, what)
    if array.shape[-2:] != (3, 3):
        raise InputError(f"{what} must be rotation matrices, shape (..., 3, 3); got shape {array.shape}")
    gap = np.abs(array @ np.swapaxes(array, -1, -2) - np.eye(3)).max()
    if gap > tolerance:
        raise InputError(f"{what} is not a rotation: R Rᵀ differs from the identity by {gap:.2g}")
    if (np.linalg.det(array) < 0).any():
        raise InputError(f"{what} is a reflection (determinant −1), not a rotation")
    return array


# --------------------------------------------------------------------------------------------------
# Values that every tick creates: read-only to the type checker, and fast to create.
#
# Python freezes a dataclass by setting each field through a slow door: 0.3 µs a field, and a tick makes fifty. A
# `record` has the same words (`slots`, comparison, `dataclasses.replace`), is made four times faster, and a write to
# one of its fields is an error of the type checker instead of the interpreter.


T = TypeVar("T")


@dataclass_transform(frozen_default=True)
def record(cls: type[T]) -> type[T]:
    """Make `cls` a dataclass with slots that is read-only once it is made.

    >>> @record
    ... class Place:
    ...     x: float  #: [m]
    >>> Place(1.0)
    Place(x=1.0)
    """
    return dataclass(slots=True)(cls)


# --------------------------------------------------------------------------------------------------
# Directions spread evenly over a part of the sphere.


def cap_directions(half_angle: float, points: int) -> Array:
    """(points, 3) unit vectors spread evenly (a Fibonacci spiral) over the cap of `half_angle` [rad] about +z.

    >>> bool((cap_directions(0.5, 20)[:, 2] > np.cos(0.5)).all())
    True
    """
    n = np.arange(points) + 0.5
    z = 1 - n / points * (1 - np.cos(half_angle))
    turn = np.pi * (1 + np.sqrt(5)) * n
    s = np.sqrt(1 - z * z)
    return np.column_stack([s * np.cos(turn), s * np.sin(turn), z])


# --------------------------------------------------------------------------------------------------
# A cubic spline through evenly spaced values, where loading scipy for one would be most of a program's start.


_MIN_SPLINE_PLACES = 4  #: with fewer places there is no cubic of the first three intervals


def cubic_spline(values: Array, step: float) -> Array:
    """(n - 1, 4) coefficients of the cubics between `values` (n,), one per `step`; highest power first.

    The value t beyond place k is c[k, 0] t³ + c[k, 1] t² + c[k, 2] t + c[k, 3]. First and second derivative are
    continuous, and the third at the second place from either end ("not a knot"): with h = step and the slopes s,
    s[k-1] + 4 s[k] + s[k+1] = 3 (m[k-1] + m[k]), where m[k] = (y[k+1] - y[k])/h.

    >>> cubic_spline(np.arange(6.0) ** 3, 1.0)[2].round(12).tolist()
    [1.0, 6.0, 12.0, 8.0]
    """
    y = np.asarray(values, dtype=float)
    if y.ndim != 1 or len(y) < _MIN_SPLINE_PLACES:
        raise InputError(f"a cubic spline needs a list of at least {_MIN_SPLINE_PLACES} values; got shape {y.shape}")
    m = np.diff(y) / step
    right = np.concatenate(([(5 * m[0] + m[1]) / 2], 3 * (m[:-1] + m[1:]), [(5 * m[-1] + m[-2]) / 2]))
    slopes = _solve(right.tolist())
    bend = (slopes[:-1] + slopes[1:] - 2 * m) / step
    return np.stack((bend / step, (m - slopes[:-1]) / step - bend, slopes[:-1], y[:-1]), axis=1)


def _solve(right: list[float]) -> Array:
    """Slopes from the right sides: rows (1, 2), (1, 4, 1) ..., (2, 1), by elimination from above."""
    diagonals, upper = [1.0], [2.0]
    for k in range(1, len(right)):
        last = k == len(right) - 1
        share = (2.0 if last else 1.0) / diagonals[-1]
        diagonals.append((1.0 if last else 4.0) - share * upper[-1])
        upper.append(1.0)
        right[k] -= share * right[k - 1]
    slopes = np.empty(len(right))
    slopes[-1] = right[-1] / diagonals[-1]
    for k in range(len(right) - 2, -1, -1):
        slopes[k] = (right[k] - upper[k] * slopes[k + 1]) / diagonals[k]
    return slopes


# --------------------------------------------------------------------------------------------------
# What a part of the chain remembers from tick to tick, as arrays of fixed size: the interface of all such parts.
#
# A snapshot copies these arrays into memory that exists already (`haptorb.runtime.tick_state`), so that a loop may take
# one between two ticks. Most parts change their arrays in place, and there is nothing else to do. What a part holds
# elsewhere, such as the last estimate, it brings into its arrays in `gather_state`, and takes back in `apply_state`.


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


class _Block:
    """Memory that is given out piece after piece."""

    def __init__(self) -> None:
        self._memory = np.zeros(0, dtype=np.uint8)
        self._given = 0  # bytes

    def take(self, size: int) -> NDArray[np.uint8]:
        """(size,) bytes, zero; after those of the last call, unless they do not fit there."""
        if self._given + size > self._memory.size:
            memory = np.zeros(max(_BLOCK, size) + _LINE, dtype=np.uint8)
            self._memory = memory[-memory.__array_interface__["data"][0] % _LINE :]
            self._given = 0
        first, self._given = self._given, self._given + -(-size // _ALIGNED) * _ALIGNED
        return self._memory[first : first + size]


_BLOCK = 1 << 16  #: bytes; all that the chain of a device of this package remembers is less
_LINE = 64  #: bytes of a line of the processor's cache
_ALIGNED = 8  #: bytes
_block: ContextVar[_Block | None] = ContextVar("block", default=None)


@contextmanager
def one_block() -> Iterator[None]:
    """The arrays that `state_zeros` makes within lie side by side in one block of memory: a snapshot copies them at
    once, three times faster than one by one.

    >>> with one_block():
    ...     place, time = state_zeros(3), state_zeros(1)
    >>> np.shares_memory(place.base, time.base)
    True
    """
    before = _block.set(_Block())
    try:
        yield
    finally:
        _block.reset(before)


def state_zeros(shape: int | tuple[int, ...], dtype: Any = np.float64) -> NDArray[Any]:
    """An array of zeros for `state_arrays`; within `one_block`, beside the others that are made there.

    >>> state_zeros((2, 3)).shape
    (2, 3)
    """
    block = _block.get()
    if block is None:
        return np.zeros(shape, dtype)
    kind, lengths = np.dtype(dtype), (shape,) if isinstance(shape, int) else shape
    return np.ndarray(lengths, kind, block.take(kind.itemsize * prod(lengths)))


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
    block = state_zeros(width + sum(map(prod, shapes.values())))
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
