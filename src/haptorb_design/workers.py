"""Workers that evaluate candidates: in this process, in processes of this computer, or on a Dask cluster."""

from __future__ import annotations

import os
import pickle
import signal
import threading
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import replace
from functools import lru_cache
from multiprocessing import current_process, parent_process
from multiprocessing.connection import wait
from pathlib import Path
from time import monotonic
from typing import Any, Protocol, final

from haptorb.child_process import count_cores, spawn_context
from haptorb.cluster import count_threads, open_cluster, run_jobs
from haptorb.errors import InputError
from haptorb.own_code import pickle_with_code
from haptorb.runtime.liveness import StarvedTime
from haptorb_design.evaluate import OBJECTIVE, compute_quantity, evaluate, find_base
from haptorb_design.problem import (
    Bound,
    Design,
    DesignCandidate,
    DesignQuantity,
    Evaluation,
    Value,
    is_own_code,
)

__all__ = [
    "CANDIDATE_TIME_LIMIT_S",
    "ClusterWorkers",
    "Job",
    "LocalWorker",
    "ProcessWorkers",
    "Workers",
    "compute_base_quantities",
    "compute_base_values",
    "describe_end",
    "evaluate_part",
    "measure_memory",
    "open_cluster_workers",
    "open_processes",
    "open_workers",
    "processor_time",
    "reject",
]


Job = tuple[int, Mapping[str, Value]]  #: number and values of a candidate


class Workers(Protocol):
    """Evaluates candidates of one design."""

    def evaluate(self, jobs: Iterable[Job]) -> Iterator[Evaluation]:
        """Evaluate each candidate once; yields in any order.

        Raises InputError when the workers fail; earlier evaluations are valid.
        """
        ...


@final
class LocalWorker:
    """Evaluation in this process, one candidate after another."""

    def __init__(self, design: Design) -> None:
        self._design = design

    def evaluate(self, jobs: Iterable[Job]) -> Iterator[Evaluation]:
        """Evaluate the candidates in order."""
        for number, values in jobs:
            yield evaluate(self._design, number, values)


# --------------------------------------------------------------------------------------------------
# Evaluation on all cores of this computer, by processes that are replaced when a candidate ends one.
#
# A candidate that ends its process is evaluated again in a new one, and rejected if it ends that too; so is one that
# exceeds the time limit. All others are evaluated.


_QUEUED_CANDIDATES = 2  #: candidates queued per process: the one in progress and the next
_MAX_ENDED_PROCESSES = 2  #: processes that a candidate may end before it is rejected
CANDIDATE_TIME_LIMIT_S = 600.0  #: limit of the processor time of one candidate [s]
_WALL_CLOCK_FACTOR = (
    4.0  #: limit of the wall-clock time, in multiples of that, for a candidate that waits instead of computing
)
_POLL_INTERVAL_S = 0.5  #: polling interval of the time limits [s]
#: one thread each: there are as many processes as cores
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
_READY = "ready"
_START_LOCK = threading.Lock()  #: held while a process starts: it inherits the environment and the signals of this one


@contextmanager
def open_processes(
    design: Design, processes: int | None = None, limit: float = CANDIDATE_TIME_LIMIT_S
) -> Iterator[Workers]:
    """Start processes for the candidates of `design`, one per core by default, until the block ends.

    limit  processor time after which a candidate is rejected [s]

    With one, candidates of a design without a user's function are evaluated in this process. An exception in the block,
    also ^C, ends the processes at once.
    """
    many = count_cores() if processes is None else processes
    if not 1 <= many <= 1000:
        raise InputError(f"processes must be between 1 and 1000; got {many}")
    if not limit > 0.0:
        raise InputError(f"the time limit of a candidate must be above 0 s; got {limit:g} s")
    if many == 1 and not design.has_own_code:
        yield LocalWorker(design)
        return
    workers = ProcessWorkers(pickle_with_code(design), many, limit)  # includes the code of a user's own objective
    try:
        yield workers
    except BaseException:
        workers.kill()
        raise
    workers.close()


def compute_base_quantities(
    design: Design, quantities: Mapping[str, DesignQuantity], limit: float = CANDIDATE_TIME_LIMIT_S
) -> dict[str, float | str]:
    """Compute `quantities` of the base device of `design`, by name: the value [SI], or the reason why there is none.

    A function of the user's own is computed in another process, as for a candidate: it may end the process, or take
    longer than `limit` of processor time [s].
    """
    device = find_base(design)
    candidate = DesignCandidate(device, device, design.options)
    own = {name: one for name, one in quantities.items() if is_own_code(one)}
    found: dict[str, float | str] = {}
    for name, one in quantities.items():
        if name not in own:
            value, reason = compute_quantity(one, candidate)
            found[name] = reason or value

    def compute(some: Mapping[str, DesignQuantity]) -> Evaluation:
        bounds = tuple(Bound(name, one) for name, one in some.items())
        with open_processes(replace(design, parameters=(), goals=(), bounds=bounds), 1, limit) as workers:
            return next(iter(workers.evaluate([(0, {})])))

    found |= compute(own).constraints if own else {}
    for name, one in own.items():
        if name not in found:  # one of them failed, and may have ended the process with the values of all others
            alone = compute({name: one})
            found[name] = alone.constraints.get(name, alone.reason)
    return found


def compute_base_values(design: Design, limit: float = CANDIDATE_TIME_LIMIT_S) -> dict[str, float]:
    """Values of the base device: "objectives.NAME" and "constraints.NAME" → number [SI]; undefined ones, and those that
    take longer than `limit` of processor time [s], are left out."""
    quantities = {f"objectives.{goal.name}": goal.quantity for goal in design.goals}
    quantities |= {f"constraints.{bound.name}": bound.quantity for bound in design.bounds}
    found = compute_base_quantities(design, quantities, limit)
    return {name: one for name, one in found.items() if not isinstance(one, str)}


class _Process:
    """A process, its candidates, and the start time of the first."""

    def __init__(self, packed: bytes, memory: float, idle: float | None) -> None:
        context = spawn_context()
        self.connection, other = context.Pipe()
        self.process = context.Process(target=_serve, args=(other, packed, memory, idle), daemon=True)
        with _START_LOCK, _allow_children(), _one_thread_and_no_interrupt():
            self.process.start()
        other.close()
        self.jobs: deque[Job] = deque()
        self.ready = False
        self._starvation = StarvedTime(self.process.pid or 0)
        self.restart_clock()

    def send(self, job: Job) -> None:
        """Send one more candidate; an ended process is detected by whoever waits for it."""
        if not self.jobs:
            self.restart_clock()
        self.jobs.append(job)
        with suppress(OSError):
            self.connection.send(job)

    def restart_clock(self) -> None:
        """Restart the time limit for the next candidate."""
        self._since, self._used, self._starved = monotonic(), processor_time(self.process.pid), self._starvation.read()

    def is_over(self, limit: float) -> bool:
        """Whether its candidate exceeded `limit` [s] of processor time, or several times that by the clock; time in
        which it was ready and had no processor does not count."""
        passed = monotonic() - self._since - (self._starvation.read() - self._starved)
        used, before = processor_time(self.process.pid), self._used
        computed = passed if used is None or before is None else used - before
        return computed > limit or passed > _WALL_CLOCK_FACTOR * limit

    def kill(self) -> None:
        """Kill the process."""
        self.process.kill()
        self.process.join()
        self.connection.close()


@final
class ProcessWorkers:
    """Evaluation by processes of this computer; made by `open_processes`.

    packed  the design
    limit   processor time of one candidate [s]
    memory  maximum of one process [bytes]
    idle    time without a candidate after which a process ends [s]; None: none
    """

    def __init__(
        self, packed: bytes, many: int, limit: float, memory: float = float("inf"), idle: float | None = None
    ) -> None:
        self._packed, self._many, self._limit, self._idle = packed, many, limit, idle
        self._memory = min(memory, measure_memory() * (0.8 if many == 1 else 0.5))
        self._processes: list[_Process] = []
        self._failed_starts = 0

    def evaluate(self, jobs: Iterable[Job]) -> Iterator[Evaluation]:
        """The evaluation of each candidate, as they arrive; one that ends its process twice, or that needs longer than
        the limit, is rejected. InputError if processes cannot start."""
        todo: deque[Job] = deque((number, dict(values)) for number, values in jobs)
        deaths: Counter[int] = Counter()
        for one in [one for one in self._processes if not one.process.is_alive()]:  # was idle, or was ended since
            self._remove(one)
        try:
            while todo or any(one.jobs for one in self._processes):
                self._send_jobs(todo)
                ready = wait([one.connection for one in self._processes], _POLL_INTERVAL_S)
                for one in list(self._processes):
                    if one.connection in ready:
                        yield from self._receive(one, todo, deaths)
                    elif one.ready and one.jobs and one.is_over(self._limit):
                        yield self._reject_slow(one, todo)
        finally:  # a caller that stops early does not wait for the rest
            for one in [one for one in self._processes if one.jobs]:
                self._remove(one)

    def _send_jobs(self, todo: deque[Job]) -> None:
        while len(self._processes) < min(self._many, len(todo) + sum(bool(one.jobs) for one in self._processes)):
            self._processes.append(_Process(self._packed, self._memory, self._idle))
        for ahead in range(_QUEUED_CANDIDATES):
            for one in self._processes:
                if todo and len(one.jobs) <= ahead:
                    one.send(todo.popleft())

    def _receive(self, one: _Process, todo: deque[Job], deaths: Counter[int]) -> Iterator[Evaluation]:
        try:
            said = one.connection.recv()
        except (EOFError, OSError):
            yield from self._replace(one, todo, deaths)
            return
        if isinstance(said, BaseException):
            raise said
        if said == _READY:
            one.ready, self._failed_starts = True, 0
        else:
            one.jobs.popleft()
            yield said
        one.restart_clock()

    def _replace(self, one: _Process, todo: deque[Job], deaths: Counter[int]) -> Iterator[Evaluation]:
        """Replace an ended process: its candidates are evaluated again, the one that ended it at most once."""
        one.process.join()
        code = one.process.exitcode or 0
        self._remove(one)
        todo.extendleft(reversed(one.jobs))
        if not one.ready:
            self._failed_starts += 1
            if self._failed_starts > _MAX_ENDED_PROCESSES:
                raise InputError(
                    f"the processes that compute candidates end while they start ({describe_end(code)}): use fewer "
                    "--processes, or look for what ends them"
                )
            return
        if not one.jobs:
            return
        number, values = todo.popleft()
        deaths[number] += 1
        if deaths[number] < _MAX_ENDED_PROCESSES:
            todo.appendleft((number, values))
        else:
            yield reject(number, values, f"its process ended {_MAX_ENDED_PROCESSES} times: {describe_end(code)}")

    def _reject_slow(self, one: _Process, todo: deque[Job]) -> Evaluation:
        self._remove(one)
        number, values = one.jobs.popleft()
        todo.extendleft(reversed(one.jobs))
        return reject(number, values, f"not computed within {self._limit:g} s of processor time")

    def _remove(self, one: _Process) -> None:
        self._processes.remove(one)
        one.kill()

    def kill(self) -> None:
        """Kill all processes."""
        while self._processes:
            self._remove(self._processes[0])

    def close(self) -> None:
        """End the idle processes."""
        for one in self._processes:
            with suppress(OSError):
                one.connection.send(None)
        self.kill()


def reject(number: int, values: Mapping[str, Value], reason: str) -> Evaluation:
    """The evaluation of a rejected candidate."""
    return Evaluation(
        number=number, values=dict(values), objectives={}, constraints={}, refused_by=OBJECTIVE, reason=reason
    )


def describe_end(code: int) -> str:
    """Description of the exit code `code` of a process.

    >>> describe_end(-9), describe_end(3)
    ('signal SIGKILL, perhaps because memory ran out', 'exit code 3')
    """
    if code >= 0:
        return f"exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = str(-code)
    return f"signal {name}" + (", perhaps because memory ran out" if name == "SIGKILL" else "")


def measure_memory() -> float:
    """Memory of this computer, or of this container if less [bytes]; infinite if unknown."""
    found = [float("inf")]
    with suppress(OSError, ValueError, AttributeError):
        found.append(float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")))
    for place in ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"):
        with suppress(OSError, ValueError):
            found.append(float(Path(place).read_text(encoding="ascii")))
    return min(found)


def processor_time(process: int | None) -> float | None:
    """Processor time of a process [s]; None if the system does not report it."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError, AttributeError):
        return None


@contextmanager
def _allow_children() -> Iterator[None]:
    """Let a daemonic process, as a worker of Dask is, start a process: ours ends with its parent, however that ends."""
    this = current_process()
    if not this.daemon:
        yield
        return
    this.daemon = False
    try:
        yield
    finally:
        this.daemon = True


@contextmanager
def _one_thread_and_no_interrupt() -> Iterator[None]:
    """Child processes started within ignore ^C and use one thread."""
    main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN) if main else None
    old = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in old.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        if main:
            signal.signal(signal.SIGINT, before)


def _serve(connection: Any, packed: bytes, memory: float, idle: float | None) -> None:
    """A process: unpack the design, then compute one candidate after the other. It ends with the program that started
    it, however that ends, when no candidate came for `idle` [s], and before all others where memory runs out."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_wait_for_parent, daemon=True).start()
    _limit_memory(memory)
    try:
        design: Design = pickle.loads(packed)
        connection.send(_READY)
        while connection.poll(idle) and (job := connection.recv()) is not None:
            connection.send(evaluate(design, *job))
    except (EOFError, BrokenPipeError):
        return
    except (Exception, KeyboardInterrupt) as cause:  # an objective that raises KeyboardInterrupt ends the run
        connection.send(cause)


def _limit_memory(memory: float) -> None:
    with suppress(ImportError, OSError, ValueError):
        import resource  # not at the top: not available on Windows

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        if memory < float("inf"):
            resource.setrlimit(resource.RLIMIT_DATA, (int(memory), resource.getrlimit(resource.RLIMIT_DATA)[1]))
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")


def _wait_for_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


# --------------------------------------------------------------------------------------------------
# Workers as chosen by a command.


def open_workers(
    design: Design, processes: int | None = None, scheduler: str | None = None, limit: float = CANDIDATE_TIME_LIMIT_S
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
    limit : float
        Processor time of one candidate [s]; one that needs longer is rejected. On a cluster it applies to designs with
        a function of the user's own.

    Returns
    -------
    context manager of Workers
        `evaluate` of the workers evaluates (number, values) pairs, in any order.
    """
    if scheduler is None:
        return open_processes(design, processes, limit)
    if processes is not None:
        raise InputError("processes are those of this computer: leave them out with a scheduler")
    return open_cluster_workers(design, scheduler, limit)


# --------------------------------------------------------------------------------------------------
# Evaluation on a Dask cluster: workers may join, leave and fail; every candidate is returned once.
#
# Candidates of a design with a user's function are evaluated in a process beside the worker, one for each of its
# threads, with the limits of `ProcessWorkers`: Dask has no limit of time, and a job that ends its worker ends four.


_MAX_JOB_CANDIDATES = 8  #: candidates per job at most, for load balance at the end
_JOBS_PER_THREAD = 4  #: jobs per thread, unless they would exceed `_MAX_JOB_CANDIDATES`
_MAX_IDLE_S = 120.0  #: after which the process beside a worker ends: the search is over, or its generation is long [s]

Part = tuple[bytes, tuple[tuple[int, dict[str, Value]], ...], float]
"""design with its code, candidates, and the limit of processor time of each [s]; 0: none, within the worker"""


@contextmanager
def open_cluster_workers(
    design: Design, address: str, limit: float = CANDIDATE_TIME_LIMIT_S
) -> Iterator[ClusterWorkers]:
    """Workers of the Dask scheduler at `address`, such as tcp://127.0.0.1:8786, for the candidates of `design`.

    limit  processor time after which a candidate of a design with a user's function is rejected [s]

    Raises InputError if the scheduler does not answer, has no workers, or has different versions.
    """
    if not limit > 0.0:
        raise InputError(f"the time limit of a candidate must be above 0 s; got {limit:g} s")
    with open_cluster(address) as client:
        yield ClusterWorkers(client, design, limit)


@final
class ClusterWorkers:
    """Evaluation on a cluster, as `ProcessWorkers` does on this computer.

    client  of dask.distributed, open
    limit   processor time of one candidate of a design with a user's function [s]
    """

    def __init__(self, client: Any, design: Design, limit: float = CANDIDATE_TIME_LIMIT_S) -> None:
        self._client = client
        self._packed = pickle_with_code(design)  # includes the code of a user's own objective
        self._limit = limit if design.has_own_code else 0.0

    def evaluate(self, jobs: Iterable[Job]) -> Iterator[Evaluation]:
        """Evaluate each candidate (number, values) once; yields as they arrive.

        Raises InputError when the cluster fails; earlier evaluations are valid.
        """
        todo = [(number, dict(values)) for number, values in jobs]
        size = max(1, min(_MAX_JOB_CANDIDATES, len(todo) // (_JOBS_PER_THREAD * max(1, count_threads(self._client)))))
        if self._limit:  # none waits for one that takes long
            size = 1
        parts: list[Part] = [(self._packed, tuple(todo[k : k + size]), self._limit) for k in range(0, len(todo), size)]
        after = "results are kept; repeat the command to continue"
        killers: list[Part] = []

        def refuse(part: Part) -> Sequence[Evaluation]:
            """Retry the candidates of a job that ended its workers one by one; reject one that does so alone."""
            _, jobs, limit = part
            if len(jobs) == 1:
                number, values = jobs[0]
                return [reject(number, values, "it ended the workers that computed it, perhaps because memory ran out")]
            killers.extend((self._packed, (job,), limit) for job in jobs)
            return []

        while parts:
            for found in run_jobs(self._client, evaluate_part, parts, after=after, killed=refuse):
                yield from found
            parts, killers = killers, []


def evaluate_part(part: Part) -> Sequence[Evaluation]:
    """Worker function: unpack the design, evaluate some of its candidates."""
    packed, jobs, limit = part
    if not limit:
        design = _unpack(packed)
        return [evaluate(design, number, values) for number, values in jobs]
    try:
        return list(_find_process(packed, limit).evaluate(jobs))
    except KeyboardInterrupt as cause:  # raised by a candidate: it would end the thread of the worker
        raise InputError("a candidate raised KeyboardInterrupt: remove it from the function") from cause


@lru_cache(maxsize=4)
def _unpack(packed: bytes) -> Design:
    design: Design = pickle.loads(packed)
    return design


_of_thread = threading.local()  # `workers`: the process of this thread of a Dask worker; `of`: its design and limit


def _find_process(packed: bytes, limit: float) -> ProcessWorkers:
    """The process beside this thread of a Dask worker; it replaces that of another design."""
    if getattr(_of_thread, "of", None) != (packed, limit):
        if hasattr(_of_thread, "workers"):
            _of_thread.workers.kill()
        _of_thread.workers = ProcessWorkers(packed, 1, limit, _measure_worker_memory(), _MAX_IDLE_S)
        _of_thread.of = packed, limit
    workers: ProcessWorkers = _of_thread.workers
    return workers


def _measure_worker_memory() -> float:
    """Memory that this Dask worker may use [bytes]; infinite without a limit."""
    from distributed import get_worker  # an extra

    return float(get_worker().memory_manager.memory_limit or "inf")
