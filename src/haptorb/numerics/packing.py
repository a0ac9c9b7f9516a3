"""Arrays laid end to end in one: compiled code that is handed one array for a dozen begins a microsecond sooner.

Every array that Python passes is inspected in every call, and is somewhere else in memory.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel

__all__ = ["pack", "part"]

_HEAD = 3  #: numbers about each: where it begins, rows, columns


def pack(*parts: ArrayLike) -> Array:
    """(n,) all `parts` (…, columns), each as rows of its last axis, behind a table of where they are. Units are kept.

    >>> part(pack([1.0, 2.0], [[3.0], [4.0]]), 1).tolist()
    [[3.0], [4.0]]
    """
    arrays = [np.atleast_2d(np.asarray(item, dtype=np.float64)) for item in parts]
    rows = [array.reshape(-1, array.shape[-1]) for array in arrays]
    starts = _HEAD * len(rows) + np.cumsum([0, *(array.size for array in rows)])
    head = [(start, *array.shape) for start, array in zip(starts.tolist(), rows, strict=False)]
    return np.concatenate([np.ravel(np.array(head, dtype=np.float64)), *(array.ravel() for array in rows)])


@kernel
def part(blob: Array, number: int) -> Array:
    """(rows, columns) part `number` of what `pack` made: a view, in the part's own unit."""
    start, rows, columns = int(blob[3 * number]), int(blob[3 * number + 1]), int(blob[3 * number + 2])
    view: Array = blob[start : start + rows * columns].reshape((rows, columns))
    return view
