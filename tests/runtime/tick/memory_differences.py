"""Comparison of two objects of haptorb, attribute by attribute, down to the last number."""

from __future__ import annotations

from collections.abc import Iterator, Set
from typing import Any

import numpy as np

_PLAIN = (bool, int, float, str, bytes, type(None))


def list_differences(a: Any, b: Any, left_out: Set[str] = frozenset()) -> list[str]:
    """Where `b` is not as `a`, as paths; attributes whose names are `left_out` are not looked at."""
    return list(_compare(a, b, "", left_out, set()))


def _compare(a: Any, b: Any, path: str, left_out: Set[str], seen: set[int]) -> Iterator[str]:
    if type(a) is not type(b):
        yield f"{path}: {type(a).__name__}, {type(b).__name__}"
    elif isinstance(a, np.ndarray):
        if not _is_same_array(a, b):
            yield path
    elif isinstance(a, _PLAIN):
        if a != b and not (a != a and b != b):
            yield f"{path}: {a!r}, {b!r}"
    elif isinstance(a, list | tuple | dict):
        one, other = ((x if isinstance(x, dict) else dict(enumerate(x))) for x in (a, b))
        if one.keys() != other.keys():
            yield f"{path}: {list(one)}, {list(other)}"
            return
        for key, value in one.items():
            yield from _compare(value, other[key], f"{path}[{key}]", left_out, seen)
    elif type(a).__module__.startswith("haptorb.") and id(a) not in seen:
        seen.add(id(a))
        slots = [name for kind in type(a).__mro__ for name in getattr(kind, "__slots__", ())]
        for name in (*getattr(a, "__dict__", ()), *slots):
            if name not in left_out:
                there = getattr(b, name, None)
                yield from _compare(getattr(a, name, None), there, f"{path}.{name}", left_out, seen)


def _is_same_array(a: Any, b: Any) -> bool:
    """Also as compiled code sees them: another layout is another kernel."""
    if (a.shape, a.dtype, a.strides, a.flags.writeable) != (b.shape, b.dtype, b.strides, b.flags.writeable):
        return False
    if a.dtype.names:
        return all(_is_same_array(a[name], b[name]) for name in a.dtype.names)
    return np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
