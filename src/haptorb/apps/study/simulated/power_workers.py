"""Where simulated participants are computed: in this process, on all its cores, or on a Dask cluster.

Each participant has a seed of its own and results are kept by number, so all three give the same, bit for bit.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import cache
from importlib import import_module
from multiprocessing import get_context
from typing import Any

from haptorb.apps.study.model.study_file import Study
from haptorb.apps.study.simulated.power_person import simulate_value
from haptorb.errors import HaptorbError, InputError
from haptorb.version import __version__

__all__ = ["count_cores", "simulate_pool"]

_PATIENCE = 5.0  #: until a scheduler that does not answer counts as unreachable [s]
_ADDRESS = re.compile(r"([a-z]+://)?[^\s/]+:\d{1,5}")  #: of a scheduler: host and port
_SHARES = 8  #: parts of the work per process, so that none waits long for the last

Job = tuple[bytes, tuple[tuple[tuple[int, ...], int], ...], str, tuple[str, str] | None]


def count_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


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
    with ProcessPoolExecutor(min(processes, len(jobs)), mp_context=get_context("spawn")) as workers:
        try:
            for future in as_completed([workers.submit(_simulate_part, *job) for job in jobs]):
                yield future.result()
        except BaseException:
            workers.shutdown(cancel_futures=True)
            raise


def _run_cluster(jobs: list[Job], address: str) -> Iterator[dict[int, float]]:
    try:
        distributed: Any = import_module("distributed")  # which has types only in parts
    except ImportError as cause:
        raise InputError("--scheduler needs dask.distributed: pip install 'haptorb[cluster]'") from cause
    if not _ADDRESS.fullmatch(address):  # a client that is made for it fails a second time when it is thrown away
        raise InputError(
            f"'{address}' is no address of a Dask scheduler; give the one that `dask scheduler` prints, such as "
            "tcp://127.0.0.1:8786"
        )
    try:
        client = distributed.Client(address, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError, TypeError, ImportError, KeyError) as cause:
        raise InputError(
            f"no Dask scheduler answers at '{address}'; start one with `dask scheduler`, and give the address that it "
            "prints, such as tcp://127.0.0.1:8786"
        ) from cause
    with client:
        _check_cluster(client, address)
        futures = client.map(_simulate_job, jobs, pure=False)
        try:
            for future in distributed.as_completed(futures, loop=client.loop):
                yield future.result()
        except (HaptorbError, GeneratorExit):
            raise
        except Exception as cause:  # a worker that was killed, a scheduler that went away
            text = " ".join(str(cause).split())[:200]
            raise InputError(
                f"the Dask cluster at '{address}' failed: {text}; the result is lost, start again"
            ) from cause


def _check_cluster(client: Any, address: str) -> None:
    """InputError unless the cluster has workers, with the versions of this computer."""
    if not client.scheduler_info().get("workers"):
        raise InputError(f"the Dask scheduler at '{address}' has no workers: start some with `dask worker {address}`")
    try:
        client.get_versions(check=True)
        versions = client.run(_find_version)
    except Exception as cause:  # what a worker of another version raises is its own
        text = " ".join(str(cause).split())[:200]
        raise InputError(f"the Dask cluster at '{address}' does not fit this computer: {text}") from cause
    others = sorted({version for version in versions.values() if version != __version__})
    if others:
        raise InputError(
            f"the Dask workers at '{address}' have haptorb {', '.join(others)}, this computer has {__version__}: "
            "install the same version on all"
        )


def _find_version() -> str:
    return __version__


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
