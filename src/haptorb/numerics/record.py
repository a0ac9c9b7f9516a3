"""Values that every tick creates: read-only to the type checker, and fast to create.

Python freezes a dataclass by setting each field through a slow door: 0.3 µs a field, and a tick makes fifty. A `record`
has the same words (`slots`, comparison, `dataclasses.replace`), is made four times faster, and a write to one of its
fields is an error of the type checker instead of the interpreter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar, dataclass_transform

__all__ = ["record"]

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
