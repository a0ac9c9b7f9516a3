"""Array types of the whole package, checks of arrays from outside, and small numerical tools."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import lru_cache
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
    "gauss_legendre",
    "make_block",
    "make_numbers",
    "one_block",
    "record",
    "rotation",
    "state_zeros",
    "vectors",
    "whole_number",
]


# --------------------------------------------------------------------------------------------------
# Array types of the whole package, and the checks of every public function's arguments.


Array: TypeAlias = NDArray[np.float64]
#: structured array: records with named fields, the state of compiled code
Records: TypeAlias = NDArray[np.void]
#: one record of it; compiled code passes it on, Python should not (slow)
Record: TypeAlias = Any


def fields(*named: tuple[Any, ...]) -> np.dtype[np.void]:
    """Dtype of a record with these fields, (name, type) or (name, type, shape), in the memory layout for compiled code.

    >>> fields(("valid", "?"), ("place", "f8", (3,))).names
    ('valid', 'place')
    """
    return np.dtype(list(named), align=True)


def check_finite(value: ArrayLike, what: str) -> Array:
    """Return `value` as a float64 array; InputError naming `what` if a number in it is not finite.

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
    """Return `value` as an array of 3-vectors, shape (..., 3).

    Raises InputError for another shape or what is not finite.

    >>> vectors([0, 0, 1], "points").shape
    (3,)
    """
    array = check_finite(value, what)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise InputError(f"{what} must be 3-vectors, shape (..., 3); got shape {array.shape}")
    return array


def rotation(value: ArrayLike, what: str, tolerance: float = 1e-6) -> Array:
    """Return `value` as rotation matrices, shape (..., 3, 3); InputError with its distance from a rotation.

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
# Values created in every tick: read-only to the type checker, and fast to create.
#
# Python freezes a dataclass by setting each field through `object.__setattr__`: 0.3 µs a field, and a tick creates
# fifty. A `record` has the same features (`slots`, comparison, `dataclasses.replace`), is created four times faster,
# and a write to one of its fields is an error of the type checker instead of the interpreter.


T = TypeVar("T")


@dataclass_transform(frozen_default=True)
def record(cls: type[T]) -> type[T]:
    """Make `cls` a dataclass with slots that is read-only to the type checker.

    >>> @record
    ... class Place:
    ...     x: float  #: [m]
    >>> Place(1.0)
    Place(x=1.0)
    """
    return dataclass(slots=True)(cls)


# --------------------------------------------------------------------------------------------------
# Directions distributed uniformly over a part of the sphere.


def cap_directions(half_angle: float, points: int) -> Array:
    """Return (points, 3) unit vectors spread uniformly (Fibonacci spiral) over the cap of `half_angle` [rad] about +z.

    >>> bool((cap_directions(0.5, 20)[:, 2] > np.cos(0.5)).all())
    True
    """
    n = np.arange(points) + 0.5
    z = 1 - n / points * (1 - np.cos(half_angle))
    turn = np.pi * (1 + np.sqrt(5)) * n
    s = np.sqrt(1 - z * z)
    return np.column_stack([s * np.cos(turn), s * np.sin(turn), z])


def gauss_legendre(count: int) -> tuple[Array, Array]:
    """Return nodes (count,) from -1 to 1 and weights (count,) of Gauss and Legendre's rule of integration.

    >>> nodes, weights = gauss_legendre(2)
    >>> bool(abs(weights @ nodes**2 - 2 / 3) < 1e-15)
    True
    """
    nodes, weights = _find_gauss_legendre(count)
    return nodes.copy(), weights.copy()


@lru_cache(maxsize=256)  # the rule takes 1 ms; a simulated electromagnet asks 70 times for a few of them
def _find_gauss_legendre(count: int) -> tuple[Array, Array]:
    return np.polynomial.legendre.leggauss(count)


# --------------------------------------------------------------------------------------------------
# Cubic spline through uniformly spaced values, because importing scipy for it would dominate a program's start.


_MIN_SPLINE_PLACES = 4  #: fewer values do not determine a cubic over the first three intervals


def cubic_spline(values: Array, step: float) -> Array:
    """Return (n - 1, 4) coefficients of the cubics between `values` (n,), one per `step`; highest power first.

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
    """Solve for the slopes: rows (1, 2), (1, 4, 1) ..., (2, 1) with these right-hand sides, by forward elimination."""
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
# State of a component from tick to tick, as arrays of fixed size: interface of all stateful components.
#
# A snapshot copies these arrays into preallocated memory (`haptorb.runtime.tick_state`), so that a loop may take one
# between two ticks. Most components change their arrays in place, which needs no further action. State stored
# elsewhere, such as the last estimate, is copied into the arrays in `gather_state`, and restored in `apply_state`.


StateArray: TypeAlias = NDArray[Any]
_NOTHING: Mapping[str, Any] = {}


class Stateful:
    """Component with state; by default it is stateless.

    state_kind  which of several kinds of part this is, in the names of a recording; empty where there is one only
    """

    state_kind: ClassVar[str] = ""

    def state_arrays(self) -> Mapping[str, StateArray]:
        """Name → array of float64, int64 or bool, or of records of these; the same arrays in each call, of the same
        shapes for the same device: its complete state, in its own units."""
        return _NOTHING

    def state_parts(self) -> Mapping[str, Stateful]:
        """Name → its own stateful components; the same in each call."""
        return _NOTHING

    def gather_state(self) -> None:
        """Copy state stored elsewhere into the arrays. Must not allocate: it runs within a tick."""

    def apply_state(self) -> None:
        """Restore state stored elsewhere from the arrays. Raises ValueError for invalid state."""


class _Block:
    """Memory block with sequential allocation."""

    def __init__(self) -> None:
        self._memory = np.zeros(0, dtype=np.uint8)
        self._given = 0  # allocated bytes

    def allocate(self, size: int) -> NDArray[np.uint8]:
        """Allocate (size,) bytes, zero; directly after those of the last call if they fit."""
        if self._given + size > self._memory.size:
            memory = np.zeros(max(_BLOCK, size) + _LINE, dtype=np.uint8)
            self._memory = memory[-memory.__array_interface__["data"][0] % _LINE :]
            self._given = 0
        first, self._given = self._given, self._given + -(-size // _ALIGNED) * _ALIGNED
        return self._memory[first : first + size]


_BLOCK = 1 << 16  #: bytes; more than the state of any device of this package
_LINE = 64  #: bytes of a cache line
_ALIGNED = 8  #: alignment in bytes
_block: ContextVar[_Block | None] = ContextVar("block", default=None)


@contextmanager
def one_block() -> Iterator[None]:
    """Allocate the arrays of `state_zeros` within it in one contiguous block: a snapshot copies them at
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
    """Return an array of zeros for `state_arrays`; within `one_block`, contiguous with the others allocated there.

    >>> state_zeros((2, 3)).shape
    (2, 3)
    """
    block = _block.get()
    if block is None:
        return np.zeros(shape, dtype)
    kind, lengths = np.dtype(dtype), (shape,) if isinstance(shape, int) else shape
    return np.ndarray(lengths, kind, block.allocate(kind.itemsize * prod(lengths)))


def make_block(
    shapes: Mapping[str, tuple[int, ...]], **numbers: tuple[str, ...]
) -> tuple[dict[str, NDArray[Any]], Any]:
    """Arrays of float64 of these shapes, and a record (1,) of float64 for each of `numbers`, name → its fields; and all
    numbers of the records in turn. All are in one contiguous block of memory, which a snapshot copies at once.

    Writing a number through the memoryview is three times faster than through its record.

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
    """Return a (1,) record of float64 with these names, and its numbers in order, as `make_block` does."""
    arrays, cells = make_block({}, numbers=names)
    return arrays["numbers"], cells


def whole_number(text: str, digits: int = 9) -> int | None:
    """Return the whole number that `text` is, of at most so many decimal digits; None for anything else.

    Python refuses to convert thousands of digits, and converts those of other scripts: a foreign text may have both.

    >>> whole_number("042"), whole_number("9" * 5000), whole_number("-1"), whole_number("\\u0663")
    (42, None, None, None)
    """
    return int(text) if text.isascii() and text.isdecimal() and len(text) <= digits else None


def choose(number: float, count: int) -> int:
    """Return `number` as an index below `count`. Raises ValueError if it is invalid."""
    if not (0.0 <= number < count and number == int(number)):
        raise ValueError(f"{number!r} is not a whole number below {count}")
    return int(number)
