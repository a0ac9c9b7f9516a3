"""The part of a wrench that a world defines, and the part that is rendered: force, torque, or both."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, Literal

from haptorb.errors import UnknownName
from haptorb.numerics.arrays import Array

__all__ = ["PARTS", "WrenchPart", "check_part", "find_part", "join_parts"]

WrenchPart = Literal["force", "torque", "both"]

PARTS: Final[tuple[WrenchPart, ...]] = ("force", "torque", "both")  #: their places are the numbers in recordings


def check_part(name: str) -> WrenchPart:
    """`name` itself. Raises UnknownName with the most similar name.

    >>> check_part("torque")
    'torque'
    """
    for part in PARTS:
        if part == name:
            return part
    raise UnknownName("part of a wrench to render", name, PARTS)


def join_parts(parts: Iterable[WrenchPart | None]) -> WrenchPart | None:
    """The part that worlds with these `parts` define together; None if one of them does not declare it.

    >>> join_parts(["force", "torque"]), join_parts(["force", None]), join_parts([])
    ('both', None, 'force')
    """
    whole = set(parts)
    if None in whole and "both" not in whole:
        return None
    named = whole - {None}
    if len(named) > 1:
        return "both"
    return named.pop() if named else "force"


def find_part(wrench: Array) -> WrenchPart | None:
    """The part of a `wrench` (6,) [N, N·m] that is not zero; None for a zero wrench.

    >>> import numpy as np
    >>> find_part(np.array([0, 0, 0, 0, 0.01, 0])), find_part(np.array([1.0, 0, 0, 0, 0, 1e-3])), find_part(np.zeros(6))
    ('torque', 'both', None)
    """
    pushes, turns = bool(wrench[:3].any()), bool(wrench[3:].any())
    if pushes and turns:
        return "both"
    return "force" if pushes else "torque" if turns else None
