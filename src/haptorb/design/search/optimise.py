"""A run of an optimiser: what it asks for is computed, or taken from the results that are there already."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping

from haptorb.design.evaluation import Evaluation, Value
from haptorb.design.search.optimiser import Optimiser
from haptorb.design.store.stored_values import check_values

__all__ = ["optimise"]

Evaluate = Callable[[Iterable[tuple[int, Mapping[str, Value]]]], Iterable[Evaluation]]


def optimise(
    optimiser: Optimiser, evaluate: Evaluate, known: Mapping[int, Evaluation], count: int
) -> Iterator[Evaluation]:
    """Candidates 0 to `count` - 1 of a run, those in `known` excepted: each as soon as it is computed.

    optimiser  that was not asked before
    evaluate   computes (number, values) of a generation, in any order
    known      number → what an earlier run of the same design, seed and population stored

    The optimiser is replayed with the stored evaluations, so that an interrupted run continues as an uninterrupted one.
    Ends early where nothing new can be found. Raises RecordingError where what is known does not come from this
    optimiser.
    """
    while (jobs := optimiser.ask()) and jobs[0][0] < count:
        wanted = [(number, values) for number, values in jobs if number < count]
        found = [known[number] for number, _ in wanted if number in known]
        check_values(dict(wanted), found)
        for evaluation in evaluate([(number, values) for number, values in wanted if number not in known]):
            found.append(evaluation)
            yield evaluation
        if len(found) < len(jobs):
            return
        optimiser.tell(found)
