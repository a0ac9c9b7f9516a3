"""What computes candidates, wherever it does; and the plainest of its kind, this process."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Protocol, final

from haptorb.design.design import Design
from haptorb.design.evaluate import evaluate
from haptorb.design.evaluation import Evaluation, Value

__all__ = ["Job", "LocalWorker", "Workers"]

Job = tuple[int, Mapping[str, Value]]  #: number and values of a candidate


class Workers(Protocol):
    """What computes candidates of one design, as often as it is asked."""

    def evaluate(self, jobs: Iterable[Job]) -> Iterator[Evaluation]:
        """The evaluation of each candidate, each once, in any order.

        Raises InputError when the workers fail; what came before is good.
        """
        ...


@final
class LocalWorker:
    """This process, one candidate after the other."""

    def __init__(self, design: Design) -> None:
        self._design = design

    def evaluate(self, jobs: Iterable[Job]) -> Iterator[Evaluation]:
        """The evaluation of each candidate, in order."""
        for number, values in jobs:
            yield evaluate(self._design, number, values)
