"""The values of a sweep, by number: the same seed gives the same values for the same number."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.stats import qmc

from haptorb.design.design import Design
from haptorb.design.evaluation import Value
from haptorb.design.sampling.values import count_levels, make_values, pick_level
from haptorb.errors import InputError, UnknownName

__all__ = ["METHODS", "sample"]

#: method → what it is
METHODS = {
    "sobol": "Scrambled Sobol sequence: even coverage from the first candidate; a larger count continues a smaller one",
    "latin-hypercube": (
        "Latin hypercube: every range divided into as many equal parts as there are candidates, each used once"
    ),
    "grid": "Every combination of steps and choices; continuous ranges in as many equal steps as the count allows",
}
_MOST = 10_000_000


def sample(design: Design, method: str, count: int, seed: int) -> Sequence[dict[str, Value]]:
    """The values of candidates 0 to `count` - 1; a grid may have fewer.

    Scrambled Sobol sequence after Owen (1998), Latin hypercube after McKay et al. (1979), both of SciPy. Raises
    UnknownName for another method, InputError for a count that cannot be, or that a grid does not fit in.
    """
    if method not in METHODS:
        raise UnknownName("sampling method", method, METHODS)
    if not 1 <= count <= _MOST:
        raise InputError(f"count must be between 1 and {_MOST}; got {count}")
    if not 0 <= seed < 2**31:
        raise InputError(f"seed must be between 0 and {2**31 - 1}; got {seed}")
    if method == "grid":
        return _list_grid(design, count)
    dimensions = len(design.parameters)
    if method == "sobol":
        points = qmc.Sobol(dimensions, rng=np.random.default_rng(seed)).random_base2(math.ceil(math.log2(count)))[
            :count
        ]
    else:
        points = qmc.LatinHypercube(dimensions, rng=np.random.default_rng(seed)).random(count)
    return [make_values(design, point) for point in points]


def _list_grid(design: Design, count: int) -> list[dict[str, Value]]:
    levels = [count_levels(one) for one in design.parameters]
    free = levels.count(0)
    own = math.prod(level for level in levels if level)
    each = int((count / own) ** (1 / free) + 1e-9) if free else 1
    if own > count or (free and each < 2):
        least = own * 2**free
        raise InputError(
            f"a grid of design '{design.name}' has at least {least} candidates: use at least that --count, or "
            "another method"
        )
    shape = [level or each for level in levels]
    return [
        {
            one.name: pick_level(one, level, size)
            for one, level, size in zip(design.parameters, index, shape, strict=True)
        }
        for index in np.ndindex(*shape)
    ]
