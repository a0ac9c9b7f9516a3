"""What computes candidates, wherever it does; and the plainest of its kind, this process."""

from __future__ import annotations

import os
import pickle
import signal
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager
from functools import lru_cache
from itertools import islice
from multiprocessing import active_children, parent_process
from typing import Any, Protocol, final

from haptorb.cluster import count_cores, count_threads, open_cluster, run_jobs, spawn_context
from haptorb.errors import InputError
from haptorb.own_code import pickle_with_code
from haptorb_design.evaluate import evaluate
from haptorb_design.problem import Design, Evaluation, Value

__all__ = [
    "ClusterWorkers",
    "Job",
    "LocalWorker",
    "ProcessWorkers",
    "Workers",
    "evaluate_part",
    "open_cluster_workers",
    "open_processes",
    "open_workers",
]


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


# --------------------------------------------------------------------------------------------------
# Candidates on all cores of this computer: processes that are started once, and given a few candidates at a time.


_PROCESSES_MOST = 8  #: candidates in one job: more would wait for each other at the end
_PROCESSES_SHARES = 4  #: jobs for each process, unless that makes them longer than `_MOST`
_AHEAD = 3  #: jobs that are given out for each process
#: one thread each: the processes are as many as the cores
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


@contextmanager
def open_processes(design: Design, processes: int | None = None) -> Iterator[Workers]:
    """So many processes for the candidates of `design`, one per core by default, until the block ends.

    With one, candidates are computed in this process. An exception in the block, ^C too, ends them at once.
    """
    many = count_cores() if processes is None else processes
    if not 1 <= many <= 1000:
        raise InputError(f"processes must be between 1 and 1000; got {many}")
    if many == 1:
        yield LocalWorker(design)
        return
    packed = pickle_with_code(design)  # an objective of the user's own comes with its code
    others = set(active_children())
    pool = ProcessPoolExecutor(many, spawn_context(), initializer=_start, initargs=(packed,))
    try:
        yield ProcessWorkers(pool, many)
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for child in set(active_children()) - others:
            child.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


@final
class ProcessWorkers:
    """Processes of this computer; made by `open_processes`."""

    def __init__(self, pool: ProcessPoolExecutor, many: int) -> None:
        self._pool, self._many = pool, many
        self._started = False  # with the first candidates: a run that is complete needs none

    def evaluate(self, jobs: Iterable[Job]) -> Iterator[Evaluation]:
        """The evaluation of each candidate, as they arrive. InputError if a process is killed; earlier ones remain."""
        todo = [(number, dict(values)) for number, values in jobs]
        if todo and not self._started:
            _start_all(self._pool)
            self._started = True
        size = max(1, min(_PROCESSES_MOST, len(todo) // (_PROCESSES_SHARES * self._many)))
        parts = iter([todo[k : k + size] for k in range(0, len(todo), size)])
        running: set[Future[list[Evaluation]]] = set()
        try:
            while True:
                for part in islice(parts, _AHEAD * self._many - len(running)):
                    running.add(self._pool.submit(_evaluate_part, part))
                if not running:
                    return
                done, running = wait(running, return_when=FIRST_COMPLETED)
                for future in done:
                    yield from future.result()
        except BrokenProcessPool as cause:
            raise InputError(
                "a process that computed candidates was killed, perhaps because memory ran out: repeat the command "
                "to continue, with fewer --processes"
            ) from cause
        finally:
            for future in running:
                future.cancel()


def _start_all(pool: ProcessPoolExecutor) -> None:
    """Start the processes, which inherit that they ignore ^C and have one thread each."""
    main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN) if main else None
    old = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        pool.submit(int)
    finally:
        for name, value in old.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        if main:
            signal.signal(signal.SIGINT, before)


_design: Design | None = None  # of this process, if it is one of the workers


def _start(packed: bytes) -> None:
    """Unpack the design once per process, and end with the program that started it, however that ends."""
    global _design
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_wait_for_parent, daemon=True).start()
    _design = pickle.loads(packed)


def _wait_for_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _evaluate_part(jobs: Sequence[Job]) -> list[Evaluation]:
    if _design is None:
        raise InputError("no design was given to this process")
    return [evaluate(_design, number, values) for number, values in jobs]


# --------------------------------------------------------------------------------------------------
# The workers that a command asks for: a cluster, or processes of this computer.


def open_workers(
    design: Design, processes: int | None = None, scheduler: str | None = None
) -> AbstractContextManager[Workers]:
    """Start processes that evaluate candidates, until the `with` block ends.

    Parameters
    ----------
    design : Design
        The design.
    processes : int, optional
        Number of processes; None: one per processor core.
    scheduler : str, optional
        Address of a Dask scheduler, such as tcp://127.0.0.1:8786: compute on its cluster instead.

    Returns
    -------
    context manager of Workers
        `evaluate` of the workers evaluates (number, values) pairs, in any order.
    """
    if scheduler is None:
        return open_processes(design, processes)
    if processes is not None:
        raise InputError("processes are those of this computer: leave them out with a scheduler")
    return open_cluster_workers(design, scheduler)


# --------------------------------------------------------------------------------------------------
# Candidates computed on a Dask cluster: workers may come, go and die, and every candidate comes back once.


_CLUSTER_MOST = 8  #: candidates in one job: more would wait for each other at the end
_CLUSTER_SHARES = 4  #: jobs for each thread, unless that makes them longer than `_MOST`

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
        size = max(1, min(_CLUSTER_MOST, len(todo) // (_CLUSTER_SHARES * max(1, count_threads(self._client)))))
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
