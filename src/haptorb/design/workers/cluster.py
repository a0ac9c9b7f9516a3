"""Candidates computed on a Dask cluster: workers may come, go and die, and every candidate comes back once."""

from __future__ import annotations

import pickle
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, final

from haptorb.cluster.dask_cluster import count_threads, open_cluster, run_jobs
from haptorb.design.design import Design
from haptorb.design.evaluate import evaluate
from haptorb.design.evaluation import Evaluation, Value
from haptorb.design.workers.workers import Job
from haptorb.files.pickle_code import pickle_with_code

__all__ = ["ClusterWorkers", "evaluate_part", "open_cluster_workers"]

_MOST = 8  #: candidates in one job: more would wait for each other at the end
_SHARES = 4  #: jobs for each thread, unless that makes them longer than `_MOST`

Part = tuple[bytes, tuple[tuple[int, dict[str, Value]], ...]]


@contextmanager
def open_cluster_workers(design: Design, address: str) -> Iterator[ClusterWorkers]:
    """The workers of the Dask scheduler at `address`, such as tcp://127.0.0.1:8786, for the candidates of `design`.

    Raises InputError if nothing answers there, if it has no workers, or if they have other versions than this computer.
    """
    with open_cluster(address) as client:
        yield ClusterWorkers(client, design)


@final
class ClusterWorkers:
    """What computes candidates on a cluster, as `Workers` does on this computer.

    client  of dask.distributed, open
    """

    def __init__(self, client: Any, design: Design) -> None:
        self._client = client
        self._packed = pickle_with_code(design)  # an objective of the user's own comes with its code

    def evaluate(self, jobs: Iterable[Job]) -> Iterator[Evaluation]:
        """The evaluation of each candidate (number, values), each once, as they arrive.

        Raises InputError when the cluster fails; what came before is good.
        """
        todo = [(number, dict(values)) for number, values in jobs]
        size = max(1, min(_MOST, len(todo) // (_SHARES * max(1, count_threads(self._client)))))
        parts: list[Part] = [(self._packed, tuple(todo[k : k + size])) for k in range(0, len(todo), size)]
        after = "results are kept; repeat the command to continue"
        for found in run_jobs(self._client, evaluate_part, parts, after=after):
            yield from found


def evaluate_part(part: Part) -> Sequence[Evaluation]:
    """What a worker does: the design as it was packed, and some of its candidates."""
    packed, jobs = part
    design = _unpack(packed)
    return [evaluate(design, number, values) for number, values in jobs]


@lru_cache(maxsize=4)
def _unpack(packed: bytes) -> Design:
    design: Design = pickle.loads(packed)
    return design
