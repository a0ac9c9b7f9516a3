"""The array types of the whole package, and the checks that every public door makes."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from haptorb.errors import InputError, quote

__all__ = ["Array", "Record", "Records", "check_finite", "fields", "rotation", "vectors"]

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
