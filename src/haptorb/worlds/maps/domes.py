"""Several domes at once, separated by their cut-offs: Zárate 2020's combined force maps."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from haptorb.errors import InputError
from haptorb.worlds.maps.dome import Dome
from haptorb.worlds.world import Sum

__all__ = ["domes_apart", "overlaps"]


def overlaps(domes: Sequence[Dome]) -> list[tuple[int, int, float]]:
    """Pairs (i, j) of domes whose cut-offs overlap, and the overlap [deg].

    >>> overlaps([Dome(), Dome(summit=(1, 0, 0))])
    [(0, 1, 18.0)]
    """
    found = []
    for (i, a), (j, b) in combinations(enumerate(domes), 2):
        p, q = np.asarray(a.summit), np.asarray(b.summit)
        cosine = float(p @ q / np.linalg.norm(p) / np.linalg.norm(q))
        apart = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
        excess = a.cut_off_deg + b.cut_off_deg - apart
        if excess > 1e-9:
            found.append((i, j, round(float(excess), 9)))
    return found


def domes_apart(domes: Sequence[Dome]) -> Sum:
    """All `domes` at once; InputError names the first two whose cut-offs overlap.

    To let domes overlap, add them: `Dome(...) + Dome(...)`.
    """
    if not domes:
        raise InputError("domes_apart needs at least one dome")
    for i, j, excess in overlaps(domes):
        raise InputError(
            f"domes {i} and {j} overlap by {excess:.1f} deg: make their cut_off_deg smaller or move their summits "
            "apart; to let them overlap, add them with +"
        )
    return Sum(tuple(domes))
