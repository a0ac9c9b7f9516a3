"""A Dask cluster as a place to compute: a scheduler at an address, with workers that may come, go and die.

Dask gives the jobs of a lost worker to another one, and a result lost with it is computed again. Each job
checks the version of its worker, so that one that joins later cannot bring other numbers.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from itertools import islice
from queue import Empty, SimpleQueue
from typing import Any, TypeVar

from haptorb.errors import HaptorbError, InputError
from haptorb.version import __version__

__all__ = ["count_threads", "open_cluster", "run_jobs"]

Job = TypeVar("Job")
Result = TypeVar("Result")

_PATIENCE = 5.0  #: until a scheduler that does not answer counts as unreachable [s]
_DESERTED = 60.0  #: for which a cluster may be without any worker [s]
_LOOK = 1.0  #: between two looks at whether there still are workers, while no result comes [s]
_AHEAD = 3  #: jobs that are given out for each thread of the cluster
_ADDRESS = re.compile(r"([a-z]+://)?[^\s/]+:\d{1,5}")  #: of a scheduler: host and port


@contextmanager
def open_cluster(address: str) -> Iterator[Any]:
    """A Dask client of the scheduler at `address`, closed after the block.

    Raises InputError if nothing answers there, if it has no workers, or if they have other versions than this computer.
    """
    try:
        distributed: Any = import_module("distributed")  # which has types only in parts
    except ImportError as cause:
        raise InputError("--scheduler needs dask.distributed: pip install 'haptorb[cluster]'") from cause
    if not _ADDRESS.fullmatch(address):  # a client that is made for it fails a second time when it is thrown away
        raise InputError(
            f"'{address}' is not the address of a Dask scheduler; give the one that `dask scheduler` prints, such as "
            "tcp://127.0.0.1:8786"
        )
    try:
        client = distributed.Client(address, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError, TypeError, ImportError, KeyError) as cause:
        raise InputError(
            f"no Dask scheduler responds at '{address}'; start one with `dask scheduler`, and give the address that it "
            "prints, such as tcp://127.0.0.1:8786"
        ) from cause
    with client:
        _check_cluster(client, address)
        yield client


def count_threads(client: Any) -> int:
    """Threads of all workers that the cluster has now."""
    return sum(client.nthreads().values())


def run_jobs(
    client: Any, function: Callable[[Job], Result], jobs: Iterable[Job], *, after: str = "start again"
) -> Iterator[Result]:
    """What `function`, which stands in a module, returns for each job; as they come, each once.

    after   what a person does when the cluster has failed

    Raises InputError when the cluster fails: its scheduler goes away, no worker has come for a minute, or the same job
    killed four of them. What the function raises is raised here.
    """
    call = _make_call(function.__module__, function.__qualname__, __version__)
    address = client.scheduler.address
    source, pending, done = iter(jobs), set[Any](), SimpleQueue[Any]()
    try:
        while True:
            room = _AHEAD * max(1, count_threads(client)) - len(pending)
            fresh = list(islice(source, max(room, 0)))
            for future in client.map(call, fresh, pure=False) if fresh else ():
                pending.add(future)
                future.add_done_callback(done.put)
            if not pending:
                return
            future = _wait_for_one(client, done)
            result = future.result()
            pending.discard(future)
            yield result
    except (HaptorbError, GeneratorExit):
        raise
    except Exception as cause:  # a scheduler that went away, a job that kills its workers
        raise InputError(f"the Dask cluster at '{address}' failed: {_shorten(cause)}; {after}") from cause
    finally:
        if pending and client.status == "running":
            client.cancel(list(pending))


def _wait_for_one(client: Any, done: SimpleQueue[Any]) -> Any:
    """A future that is done; RuntimeError without a worker to compute one."""
    deserted = None
    while True:
        try:
            return done.get(timeout=_LOOK)
        except Empty:
            now = time.monotonic()
            deserted = None if client.nthreads() else (deserted or now)
            if deserted is not None and now - deserted > _DESERTED:
                raise RuntimeError(f"it has had no worker for {_DESERTED:.0f} s") from None


def _make_call(module: str, name: str, version: str) -> Callable[[Any], Any]:
    """A function that travels with its code, because a worker of another version may not know this module."""

    def call(job: Any) -> Any:
        from importlib import import_module

        from haptorb.version import __version__ as here

        if here != version:
            raise RuntimeError(
                f"a worker has haptorb {here}, this computer has {version}: install the same version on all"
            )
        return getattr(import_module(module), name)(job)

    return call


def _check_cluster(client: Any, address: str) -> None:
    """InputError unless the cluster has workers, with the versions of this computer."""
    if not client.nthreads():
        raise InputError(f"the Dask scheduler at '{address}' has no workers: start some with `dask worker {address}`")

    def find_version() -> str:
        from haptorb.version import __version__ as here

        return str(here)

    try:
        client.get_versions(check=True)
        versions = client.run(find_version)
    except Exception as cause:  # what a worker of another version raises is its own
        raise InputError(
            f"the Dask cluster at '{address}' is not compatible with this computer: {_shorten(cause)}"
        ) from cause
    others = sorted({version for version in versions.values() if version != __version__})
    if others:
        raise InputError(
            f"the Dask workers at '{address}' have haptorb {', '.join(others)}, this computer has {__version__}: "
            "install the same version on all"
        )


def _shorten(cause: Exception) -> str:
    return " ".join((str(cause) or type(cause).__name__).split())[:200]
