"""Series connection of a motor's coils: groups and winding sense from positions and magnets, and wiring errors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.motor_layout import Layout

if TYPE_CHECKING:
    pass

__all__ = ["FACING", "grouping", "list_not_facing", "match_winding", "measure_facing", "pair_opposite"]


FACING = np.radians(0.5)  #: how far from opposite a pair of coils may be and still count as opposite


def measure_facing(first: Array, second: Array) -> float:
    """Angle [rad] between the unit vector `first` (3,) and the opposite of `second` (3,)."""
    return float(np.pi - np.arccos(np.clip(first @ second, -1.0, 1.0)))


def pair_opposite(layout: Layout) -> tuple[tuple[int, ...], ...]:
    """Numbers from 1 of opposite parts, in pairs; a part without an opposite one is alone.

    >>> pair_opposite(Layout(1.0, np.array([[1.0, 0, 0], [0, 1.0, 0], [-1.0, 0, 0]])))
    ((1, 3), (2,))
    """
    left = list(range(len(layout)))
    pairs: list[tuple[int, ...]] = []
    while left:
        first = left.pop(0)
        away = [measure_facing(layout.directions[first], layout.directions[other]) for other in left]
        if left and min(away) <= FACING:
            pairs.append((first + 1, left.pop(int(np.argmin(away))) + 1))
        else:
            pairs.append((first + 1,))
    return tuple(pairs)


def match_winding(groups: Array, single: Array) -> Array:
    """`groups` (k, m) of coils all wound alike, with those reversed that act against the first of their group.

    single  (n, 3, k) torque per ampere of every coil, in orientations throughout the workspace [N·m/A]

    >>> match_winding(np.array([[1.0], [1.0]]), np.array([[[1.0, -2.0], [0, 0], [0, 0]]])).tolist()
    [[1.0], [-1.0]]
    """
    out = groups.copy()
    for channel in range(groups.shape[1]):
        members = np.flatnonzero(groups[:, channel])
        together = np.einsum("nak,na->k", single[:, :, members], single[:, :, members[0]])
        out[members, channel] = np.where(together < 0.0, -1.0, 1.0)
    return out


def grouping(groups: Sequence[Sequence[int]], count: int, winding: str) -> tuple[Array, list[str]]:
    """(count, m) current of every coil per ampere of every channel, and what is wrong with the groups.

    "series-opposed": every second coil of a group is wound the other way; otherwise all are wound alike.

    >>> grouping([[1, 2]], 2, "series-opposed")[0].tolist()
    [[1.0], [-1.0]]
    >>> grouping([[1, 5]], 2, "series-aiding")[1]
    ['groups.coils: group 1 names EM5, but there are only 2 electromagnets', 'groups.coils: EM2 is in no group']
    """
    matrix = np.zeros((count, len(groups)))
    wrong = []
    for channel, members in enumerate(groups):
        for place, coil in enumerate(members):
            if not 1 <= coil <= count:
                wrong.append(
                    f"groups.coils: group {channel + 1} names EM{coil}, but there are only {count} electromagnets"
                )
                continue
            matrix[coil - 1, channel] = -1.0 if winding == "series-opposed" and place % 2 else 1.0
    used = Counter(coil for members in groups for coil in members)
    wrong += [f"groups.coils: EM{coil} appears {many} times" for coil, many in sorted(used.items()) if many > 1]
    wrong += [f"groups.coils: EM{coil} is in no group" for coil in range(1, count + 1) if coil not in used]
    return matrix, wrong


def list_not_facing(layout: Layout, groups: Sequence[Sequence[int]]) -> list[str]:
    """Sentences about pairs of `groups` whose coils do not face each other; an empty list is a pass."""
    pairs = []
    for members in groups:
        if len(members) != 2:
            continue
        i, j = members
        away = measure_facing(layout.directions[i - 1], layout.directions[j - 1])
        if away > FACING:
            pairs.append(f"EM{i} and EM{j} ({np.degrees(away):.1f}° off)")
    if not pairs:
        return []
    return [f"groups.coils: pairs that do not face each other across the centre: {', '.join(pairs)}"]
