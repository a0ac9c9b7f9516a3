"""Where simulated participants are computed: in this process, on all its cores, or on a Dask cluster.

Each participant has a seed of its own and results are kept by number, so all three give the same, bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import cache

from haptorb.apps.study.model.study_file import Study
from haptorb.apps.study.simulated.power_person import simulate_value
from haptorb.cluster.dask_cluster import open_cluster, run_jobs
from haptorb.cluster.spawned_process import spawn_context
from haptorb.errors import InputError

__all__ = ["simulate_pool"]

_SHARES = 8  #: parts of the work per process, so that none waits long for the last

Job = tuple[bytes, tuple[tuple[tuple[int, ...], int], ...], str, tuple[str, str] | None]


def simulate_pool(
    study: Study, pool: int, seed: int, measure: str, between: tuple[str, str] | None, *, processes: int = 1,
    scheduler: str | None = None, progress: Callable[[int, int], None] | None = None,
) -> list[float]:  # fmt: skip
    """Value of `measure` of each of `pool` simulated participants, in `processes` or on the cluster of `scheduler`.

    Raises InputError for a scheduler that does not answer or has other versions than this computer.
    """
    if processes < 1:
        raise InputError(f"processes must be 1 or more; got {processes}")
    people: list[tuple[tuple[int, ...], int]] = [((seed, n + 1), n) for n in range(pool)]
    found = [math.nan] * pool

    def keep(values: dict[int, float], done: int) -> int:
        for n, value in values.items():
            found[n] = value
        if progress is not None:
            progress(done + len(values), pool)
        return done + len(values)

    done = 0
    if scheduler is None and min(processes, pool) == 1:
        for who, n in people:
            done = keep({n: simulate_value(study, who, n, measure, between)}, done)
        return found
    import cloudpickle

    packed: bytes = cloudpickle.dumps(study)  # a world of the user's own comes with its code
    at_once = processes if scheduler is None else 8
    size = max(1, math.ceil(pool / (at_once * _SHARES)))
    jobs: list[Job] = [(packed, tuple(people[k : k + size]), measure, between) for k in range(0, pool, size)]
    for values in _run_processes(jobs, processes) if scheduler is None else _run_cluster(jobs, scheduler):
        done = keep(values, done)
    return found


def _run_processes(jobs: list[Job], processes: int) -> Iterator[dict[int, float]]:
    with ProcessPoolExecutor(min(processes, len(jobs)), mp_context=spawn_context()) as workers:
        try:
            for future in as_completed([workers.submit(_simulate_part, *job) for job in jobs]):
                yield future.result()
        except BaseException:
            workers.shutdown(cancel_futures=True)
            raise


def _run_cluster(jobs: list[Job], address: str) -> Iterator[dict[int, float]]:
    with open_cluster(address) as client:
        yield from run_jobs(client, _simulate_job, jobs, after="the result is lost, start again")


def _simulate_job(job: Job) -> dict[int, float]:
    return _simulate_part(*job)


def _simulate_part(
    packed: bytes, people: tuple[tuple[tuple[int, ...], int], ...], measure: str, between: tuple[str, str] | None
) -> dict[int, float]:
    """Number → value of these people."""
    study = _unpack(packed)
    return {n: simulate_value(study, seed, n, measure, between) for seed, n in people}


@cache
def _unpack(packed: bytes) -> Study:
    import cloudpickle

    study: Study = cloudpickle.loads(packed)
    return study
