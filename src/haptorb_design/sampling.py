"""Sampling of a sweep: values by number, reproducible from method and seed."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import qmc

from haptorb.errors import InputError, UnknownName
from haptorb_design.problem import Design, DesignParameter, Evaluation, Value
from haptorb_design.store import check_values

__all__ = ["METHODS", "count_levels", "list_settings", "make_values", "pick_level", "round_value", "sample", "sweep"]


# --------------------------------------------------------------------------------------------------
# From a point of the unit cube to parameter values.


_SIGNIFICANT_DIGITS = 9  #: significant digits of a value


def make_values(design: Design, point: Sequence[float]) -> dict[str, Value]:
    """Parameter → value at `point`, one coordinate of [0, 1) per parameter; steps and choices have equal shares."""
    return {one.name: _find_value(one, float(share)) for one, share in zip(design.parameters, point, strict=True)}


def count_levels(parameter: DesignParameter) -> int:
    """Number of values of a parameter; 0 for a continuous range.

    >>> count_levels(DesignParameter("turns", (), low=10.0, high=20.0, step=5.0))
    3
    """
    if parameter.choices:
        return len(parameter.choices)
    if parameter.step == 0.0:
        return 0
    return 1 + int((parameter.high - parameter.low) / parameter.step + 1e-9)


def pick_level(parameter: DesignParameter, level: int, levels: int) -> Value:
    """Value `level` of a parameter, or of `count` evenly spaced ones from `low` to `high` of a continuous range."""
    if parameter.choices:
        return parameter.labels[level]
    if parameter.step > 0.0:
        return round_value(parameter.low + level * parameter.step)
    share = level / (levels - 1) if levels > 1 else 0.5
    return round_value(parameter.low + share * (parameter.high - parameter.low))


def round_value(number: float) -> float:
    """`number` rounded to the digits of a value."""
    return float(f"{number:.{_SIGNIFICANT_DIGITS}g}")


def _find_value(parameter: DesignParameter, share: float) -> Value:
    levels = count_levels(parameter)
    if levels:
        return pick_level(parameter, min(int(share * levels), levels - 1), levels)
    return round_value(parameter.low + share * (parameter.high - parameter.low))


#: method → description
METHODS = {
    "sobol": "Scrambled Sobol sequence: even coverage from the first candidate; a larger count continues a smaller one",
    "latin-hypercube": (
        "Latin hypercube: every range divided into as many equal parts as there are candidates, each used once"
    ),
    "grid": "Every combination of steps and choices; continuous ranges in as many equal steps as the count allows",
}
_MAX_SAMPLES = 10_000_000


def sample(design: Design, method: str, count: int, seed: int) -> Sequence[dict[str, Value]]:
    """Sample the parameters of a design.

    Parameters
    ----------
    design : Design
        The design.
    method : str
        "sobol", "latin-hypercube" or "grid".
    count : int
        Number of candidates; a grid may have fewer.
    seed : int
        Seed; the same seed gives the same values for the same candidate.

    Returns
    -------
    sequence of dict
        Parameter → value, of candidates 0 to `count` − 1.

    Raises
    ------
    UnknownName
        If there is no such method.
    InputError
        If the count is impossible, or a grid does not fit into it.

    Notes
    -----
    Scrambled Sobol sequence after Owen (1998), Latin hypercube after McKay et al. (1979), both of SciPy.
    """
    if method not in METHODS:
        raise UnknownName("sampling method", method, METHODS)
    if not 1 <= count <= _MAX_SAMPLES:
        raise InputError(f"count must be between 1 and {_MAX_SAMPLES}; got {count}")
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


# --------------------------------------------------------------------------------------------------
# Sweep: evaluation of a sample, without the values stored already.


Evaluate = Callable[[Iterable[tuple[int, Mapping[str, Value]]]], Iterable[Evaluation]]


def sweep(
    values: Sequence[Mapping[str, Value]], evaluate: Evaluate, known: Mapping[int, Evaluation]
) -> Iterator[Evaluation]:
    """Evaluate sampled candidates, except those that are already known.

    Parameters
    ----------
    values : sequence of Mapping
        Parameter → value, of each candidate.
    evaluate : callable
        Evaluates (number, values) pairs in any order: the `evaluate` of `open_workers`.
    known : Mapping
        Number → result of an earlier run of the same sample.

    Yields
    ------
    Evaluation
        Result of a candidate, as soon as it is computed.

    Raises
    ------
    RecordingError
        If a known result does not come from this sample.

    Examples
    --------
    >>> from haptorb_design.problem import Evaluation
    >>> def double(jobs):
    ...     return (Evaluation(n, values, {"y": 2 * values["x"]}, {}) for n, values in jobs)
    >>> [one.objectives["y"] for one in sweep([{"x": 1.0}, {"x": 2.0}], double, {})]
    [2.0, 4.0]
    """
    inside = [one for number, one in known.items() if number < len(values)]
    check_values(dict(enumerate(values)), inside)
    yield from evaluate([(number, one) for number, one in enumerate(values) if number not in known])


def list_settings(method: str, values: Sequence[Mapping[str, Value]]) -> dict[str, Any]:
    """Settings besides method and seed that determine the values; a Sobol sequence can be extended, others cannot."""
    return {} if method == "sobol" else {"count": len(values)}
