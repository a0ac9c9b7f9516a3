"""A sweep: the values of a sample computed, those that are stored already excepted."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from haptorb.design.evaluation import Evaluation, Value
from haptorb.design.store.stored_values import check_values

__all__ = ["list_settings", "sweep"]

Evaluate = Callable[[Iterable[tuple[int, Mapping[str, Value]]]], Iterable[Evaluation]]


def sweep(
    values: Sequence[Mapping[str, Value]], evaluate: Evaluate, known: Mapping[int, Evaluation]
) -> Iterator[Evaluation]:
    """DesignCandidate n has `values[n]`: each of them, those in `known` excepted, as soon as it is computed.

    evaluate  computes (number, values), in any order: `Workers.evaluate`
    known     number → what an earlier run of the same sample stored

    Raises RecordingError where what is known does not come from this sample.

    >>> from haptorb.design.evaluation import Evaluation
    >>> def double(jobs):
    ...     return (Evaluation(n, values, {"y": 2 * values["x"]}, {}) for n, values in jobs)
    >>> [one.objectives["y"] for one in sweep([{"x": 1.0}, {"x": 2.0}], double, {})]
    [2.0, 4.0]
    """
    inside = [one for number, one in known.items() if number < len(values)]
    check_values(dict(enumerate(values)), inside)
    yield from evaluate([(number, one) for number, one in enumerate(values) if number not in known])


def list_settings(method: str, values: Sequence[Mapping[str, Value]]) -> dict[str, Any]:
    """What decides the values of a number beside method and seed: a Sobol sequence can be continued, others not."""
    return {} if method == "sobol" else {"count": len(values)}
