"""One field of a recording: an array that is read when its numbers are asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, final

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from haptorb.numerics.arrays import Array

__all__ = ["FieldColumn"]

Read = Callable[[int, int], Array]  #: (last − first, width) rows `first` up to `last` of the field


@final
class FieldColumn(NDArrayOperatorsMixin):
    """A field of all ticks, shape (n, width), or (n,) where the width is 1.

    `column[a:b]` reads those ticks only. In arithmetic, in functions of NumPy and where one of an array's methods is
    called, it is the whole array.

    >>> column = FieldColumn(lambda a, b: np.arange(a, b, dtype=float)[:, None], 1000, 1)
    >>> column[10:13].tolist(), float(column[-1]), column.shape, float((column + 1).max())
    ([10.0, 11.0, 12.0], 999.0, (1000,), 1000.0)
    """

    def __init__(self, read: Read, rows: int, width: int) -> None:
        self._read, self._rows, self._width = read, rows, width

    @property
    def shape(self) -> tuple[int, ...]:
        """As of the whole array."""
        return (self._rows,) if self._width == 1 else (self._rows, self._width)

    @property
    def ndim(self) -> int:
        """1 for single numbers, else 2."""
        return len(self.shape)

    @property
    def size(self) -> int:
        """Numbers in all."""
        return self._rows * self._width

    @property
    def dtype(self) -> np.dtype[np.float64]:
        """Always float64."""
        return np.dtype(np.float64)

    def __len__(self) -> int:
        """Ticks."""
        return self._rows

    def __getitem__(self, key: Any) -> Any:
        """As of the whole array; a number or a slice of ticks reads no more than those between its ends."""
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
        """Over ticks; the whole array is read once."""
        return iter(self._load(0, self._rows))

    def __reduce__(self) -> tuple[Any, ...]:
        """Sent elsewhere, it is the whole array: the file stays here."""
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
        """A method or property of the whole array."""
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(np.asarray(self), name)

    def __repr__(self) -> str:
        """Its shape, and the first and last ticks."""
        ends = np.concatenate((self[:2], self[-2:])) if self._rows else np.empty(0)
        shown = np.array2string(ends, threshold=12, precision=4)
        return f"<FieldColumn of shape {self.shape}, first and last ticks: {shown}>"

    def _load(self, first: int, last: int) -> Array:
        rows = self._read(first, last)
        return rows[:, 0] if self._width == 1 else rows
