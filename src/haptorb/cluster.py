"""Distributed computation on a Dask cluster: a scheduler at an address, with workers that may join, leave and fail.

Dask reassigns the jobs of a lost worker, and recomputes results lost with it. Each job checks the versions on its
worker, so that one that joins later cannot return different results.
"""

from __future__ import annotations

import re
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from itertools import islice
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any, TypeVar

from haptorb.errors import HaptorbError, InputError
from haptorb.version import __version__

__all__ = ["check_versions", "count_threads", "list_versions", "open_cluster", "run_jobs"]


# --------------------------------------------------------------------------------------------------
# Version check of a cluster: with different versions results could differ, or jobs could not be read.
#
# A scheduler passes jobs on without unpacking them, so only its Dask and Python must match. A worker computes, so
# haptorb and its numerical libraries must match too.


_DASK = ("distributed", "dask", "cloudpickle")
_NUMBERS = ("numpy", "scipy", "numba")


def check_versions(client: Any, address: str) -> None:
    """Raise InputError, with both versions, unless scheduler and workers of the Dask `client` match this computer."""
    found = _call_in_thread(lambda: client.get_versions(packages=_NUMBERS))
    here = _list_packages(found["client"])
    scheduler = _list_packages(found["scheduler"])
    _refuse(f"the Dask scheduler at '{address}' has", scheduler, here, ("Python", *_DASK[:2]))
    owner = f"the Dask workers at '{address}' have"
    for worker in found["workers"].values():
        _refuse(owner, _list_packages(worker), here, ("Python", *_DASK, *_NUMBERS))
    for worker in _call_in_thread(lambda: client.run(_make_version_reporter(), on_error="return")).values():
        versions = {"haptorb": worker} if isinstance(worker, str) else {}  # an exception: a worker without haptorb
        _refuse(owner, versions, {"haptorb": __version__}, ("haptorb",))


def list_versions() -> dict[str, str]:
    """Return package → version on this computer, of all packages that determine results."""
    from importlib.metadata import version

    return {"haptorb": __version__, **{name: version(name) for name in _NUMBERS}}


def _refuse(owner: str, remote: Mapping[str, str], here: Mapping[str, str], names: Iterable[str]) -> None:
    for name in names:
        if remote.get(name) != here.get(name):
            raise InputError(
                f"{owner} {name} {remote.get(name) or '(missing)'}, this computer has {here.get(name)}: install the "
                "same version on all"
            )


def _list_packages(computer: Mapping[str, Any]) -> dict[str, str]:
    """Return package → version, as Dask reports for one computer; Python without the patch number."""
    packages = {name: str(value) for name, value in computer["packages"].items() if value is not None}
    packages["Python"] = ".".join(packages.pop("python", "").split(".")[:2])
    return packages


def _make_version_reporter() -> Any:
    """Return a function that is sent with its code: a worker may not have this module."""

    def report_version() -> str:
        from haptorb.version import __version__ as here

        return str(here)

    return report_version


Job = TypeVar("Job")
Result = TypeVar("Result")

_CONNECT_TIMEOUT_S = 5.0  #: connection timeout of a scheduler
_NO_WORKER_TIMEOUT_S = 60.0  #: time without any worker after which the run fails [s]
_WORKER_CHECK_INTERVAL_S = 1.0  #: interval at which the presence of workers is checked while no result arrives
_JOBS_PER_THREAD = 3  #: jobs submitted in advance for each thread of the cluster
_ADDRESS = re.compile(r"([a-z]+://)?[^\s/]+:\d{1,5}")  #: host and port of a scheduler


@contextmanager
def open_cluster(address: str) -> Iterator[Any]:
    """Open a Dask client of the scheduler at `address`, closed after the block.

    Raises InputError if the scheduler does not respond, has no workers, or versions differ from those of this computer.
    """
    try:
        distributed: Any = import_module("distributed")  # it has types only in parts
    except ImportError as cause:
        raise InputError("--scheduler needs dask.distributed: pip install 'haptorb[cluster]'") from cause
    if not _ADDRESS.fullmatch(address):  # a client of an invalid address fails a second time when it is deleted
        raise InputError(
            f"'{address}' is not the address of a Dask scheduler; give the one that `dask scheduler` prints, such as "
            "tcp://127.0.0.1:8786"
        )
    try:
        with warnings.catch_warnings():  # `check_versions` rejects the versions that matter
            warnings.simplefilter("ignore")
            client = distributed.Client(address, timeout=_CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError, TypeError, ImportError, KeyError) as cause:
        raise InputError(
            f"no Dask scheduler responds at '{address}'; start one with `dask scheduler`, and give the address that it "
            "prints, such as tcp://127.0.0.1:8786"
        ) from cause
    with client:
        _check_cluster(client, address)
        yield client


def count_threads(client: Any) -> int:
    """Return the number of threads of all present workers."""
    return sum(_call_in_thread(client.nthreads).values())


def _call_in_thread(function: Callable[[], Any]) -> Any:
    """Call a function of distributed in another thread; return its result, or raise its exception.

    Python handles signals in the main thread only. A Ctrl-C inside such a call can come between the request to the
    client's event loop and the answer's place, and the event loop then prints a traceback beside the program's message.
    """
    answer = SimpleQueue[Any]()

    def call() -> None:
        try:
            answer.put((function(), None))
        except BaseException as cause:
            answer.put((None, cause))

    Thread(target=call, name="call of distributed", daemon=True).start()
    result, cause = answer.get()
    if cause is not None:
        raise cause
    return result


def run_jobs(
    client: Any,
    function: Callable[[Job], Result],
    jobs: Iterable[Job],
    *,
    after: str = "start again",
    killed: Callable[[Job], Result] | None = None,
) -> Iterator[Result]:
    """Yield the results of `function`, defined in a module, for all jobs; in order of completion, each once.

    after   advice to the user if the cluster failed
    killed  returns the result of a job that killed four workers

    Raises InputError if the cluster fails: its scheduler disconnects, no worker joins for a minute, or the same job
    killed four workers and there is no `killed`. Exceptions of the function are raised here.
    """
    call = _make_call(function.__module__, function.__qualname__, list_versions())
    address = client.scheduler.address
    source, pending, done = iter(jobs), dict[Any, Job](), SimpleQueue[Any]()
    try:
        while True:
            room = _JOBS_PER_THREAD * max(1, count_threads(client)) - len(pending)
            fresh = list(islice(source, max(room, 0)))
            for future, job in zip(client.map(call, fresh, pure=False) if fresh else (), fresh, strict=True):
                pending[future] = job
                future.add_done_callback(done.put)
            if not pending:
                return
            future = _wait_for_one(client, done)
            job = pending.pop(future)
            try:
                result = _call_in_thread(future.result)
            except Exception as cause:
                if killed is None or type(cause).__name__ != "KilledWorker":
                    raise
                result = killed(job)
            yield result
    except (HaptorbError, GeneratorExit):
        raise
    except Exception as cause:  # a disconnected scheduler, a job that kills its workers
        raise InputError(f"the Dask cluster at '{address}' failed: {_shorten(cause)}; {after}") from cause
    finally:
        if pending and client.status == "running":
            _call_in_thread(lambda: client.cancel(list(pending)))


def _wait_for_one(client: Any, done: SimpleQueue[Any]) -> Any:
    """Return a completed future; RuntimeError if no worker remains to compute one."""
    deserted = None
    while True:
        try:
            return done.get(timeout=_WORKER_CHECK_INTERVAL_S)
        except Empty:
            now = time.monotonic()
            deserted = None if count_threads(client) else (deserted or now)
            if deserted is not None and now - deserted > _NO_WORKER_TIMEOUT_S:
                raise RuntimeError(f"it has had no worker for {_NO_WORKER_TIMEOUT_S:.0f} s") from None


def _make_call(module: str, name: str, versions: dict[str, str]) -> Callable[[Any], Any]:
    """Return a function that is sent with its code, because a worker of another version may not have this module."""

    def call(job: Any) -> Any:
        from importlib import import_module

        for package, wanted in versions.items():
            found = import_module("haptorb.version" if package == "haptorb" else package).__version__
            if found != wanted:
                raise RuntimeError(
                    f"a worker has {package} {found}, this computer has {wanted}: install the same version on all"
                )
        return getattr(import_module(module), name)(job)

    return call


def _check_cluster(client: Any, address: str) -> None:
    """Raise InputError unless the cluster has workers, with the versions of this computer."""
    if not count_threads(client):
        raise InputError(f"the Dask scheduler at '{address}' has no workers: start some with `dask worker {address}`")
    try:
        check_versions(client, address)
    except HaptorbError:
        raise
    except Exception as cause:  # another version may raise anything
        raise InputError(
            f"the Dask cluster at '{address}' is not compatible with this computer: {_shorten(cause)}"
        ) from cause


def _shorten(cause: Exception) -> str:
    return " ".join((str(cause) or type(cause).__name__).split())[:200]
