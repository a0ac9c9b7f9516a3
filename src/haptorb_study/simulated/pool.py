"""Pool of simulated participants: each answers a whole study in memory and yields one value of a measure."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import cache

import numpy as np

from haptorb.child_process import spawn_context
from haptorb.cluster import open_cluster, run_jobs
from haptorb.errors import InputError
from haptorb_study.analysis.measures import PersonMeasures, list_thresholds
from haptorb_study.columns import Columns, place_answers
from haptorb_study.order import plan, procedure_of
from haptorb_study.procedures import Procedure
from haptorb_study.prompts import Answer, Prompt
from haptorb_study.simulated.participant import Participant
from haptorb_study.study_file import Study

__all__ = ["ADAPTIVE", "answer_study", "list_columns", "simulate_pool", "simulate_value"]


ADAPTIVE = ("staircase", "bayesian")  #: procedures with thresholds of their own
_SIMULATED_CODE = "SIM"


def simulate_value(
    study: Study, seed: tuple[int, ...], ordinal: int, measure: str, between: tuple[str, str] | None
) -> float:
    """a − b of the `ordinal`-th simulated participant, or the measure itself; NaN without data.

    All random numbers depend on `seed` only, so the result does not depend on where and in which order it is computed.
    """
    procedure, responses = answer_study(study, seed, ordinal)
    main = list_columns(study, responses)
    thresholds = list_thresholds({_SIMULATED_CODE: procedure}) if study.procedure in ADAPTIVE else None
    found = PersonMeasures(study, main, [_SIMULATED_CODE], thresholds).compare(measure, between).differences
    return float(found[0]) if len(found) else float("nan")


def answer_study(study: Study, seed: tuple[int, ...], ordinal: int) -> tuple[Procedure, list[tuple[Prompt, Answer]]]:
    """The procedure after all trials of one simulated participant, and its prompts and answers."""
    participant = Participant(study, seed)
    procedure: Procedure = procedure_of(study, plan(study, ordinal))
    responses: list[tuple[Prompt, Answer]] = []
    while (prompt := procedure.prompt) is not None:
        answer = participant.answer(prompt, len(responses))
        procedure = procedure.record_answer(answer)
        responses.append((prompt, answer))
    return procedure, responses


def list_columns(study: Study, responses: Iterable[tuple[Prompt, Answer]], code: str = _SIMULATED_CODE) -> Columns:
    """Columns of the tidy table that measures use, for the participant `code`; without practice."""
    main = [(prompt, answer) for prompt, answer in responses if prompt.phase != "practice"]
    points = {point.number: point for point in study.points}
    ways = np.array([points[p.set_point].direction if p.set_point else (np.nan,) * 3 for p, _ in main]).reshape(-1, 3)
    place = np.array([a.position or (np.nan,) * 3 for _, a in main], dtype=float).reshape(-1, 3)
    number = np.array([p.set_point for p, _ in main])
    contact = study.load_device().contact_distance
    answer = np.array([np.nan if a.value is None else a.value for _, a in main], dtype=float)
    return {
        "participant": np.full(len(main), code), "set_point": number, "answer": answer,
        "condition": np.array([p.condition for p, _ in main]), "other": np.array([p.other for p, _ in main]),
        "level": np.array([p.level for p, _ in main]), "interval": np.array([p.interval for p, _ in main]),
        "theta_deg": np.array([points[p.set_point].theta_deg if p.set_point else np.nan for p, _ in main]),
        "correct": np.where(np.isfinite(answer), answer == number, np.nan),
        "x_m": place[:, 0], "y_m": place[:, 1], "z_m": place[:, 2],
        "distance_mm": 1e3 * np.linalg.norm(place_answers(study, answer, place) - contact * ways, axis=1),
    }  # fmt: skip


# --------------------------------------------------------------------------------------------------
# Execution of the pool: in this process, on all cores, or on a Dask cluster.
#
# Each participant has its own seed and results are ordered by number, so all three agree bit for bit.


_JOBS_PER_PROCESS = 8  #: jobs per process, for load balance

Job = tuple[bytes, tuple[tuple[tuple[int, ...], int], ...], str, tuple[str, str] | None]


def simulate_pool(
    study: Study, pool: int, seed: int, measure: str, between: tuple[str, str] | None, *, processes: int = 1,
    scheduler: str | None = None, progress: Callable[[int, int], None] | None = None,
) -> list[float]:  # fmt: skip
    """`measure` of each of `pool` simulated participants, computed in `processes` or on the cluster of `scheduler`.

    Raises InputError for a scheduler that does not answer or has different versions.
    """
    if processes < 1:
        raise InputError(f"processes must be 1 or more; got {processes}")
    people: list[tuple[tuple[int, ...], int]] = [((seed, n + 1), n) for n in range(pool)]
    found = [math.nan] * pool

    def store(values: dict[int, float], done: int) -> int:
        for n, value in values.items():
            found[n] = value
        if progress is not None:
            progress(done + len(values), pool)
        return done + len(values)

    done = 0
    if scheduler is None and min(processes, pool) == 1:
        for who, n in people:
            done = store({n: simulate_value(study, who, n, measure, between)}, done)
        return found
    import cloudpickle

    packed: bytes = cloudpickle.dumps(study)  # includes the code of a user's own world
    at_once = processes if scheduler is None else 8
    size = max(1, math.ceil(pool / (at_once * _JOBS_PER_PROCESS)))
    jobs: list[Job] = [(packed, tuple(people[k : k + size]), measure, between) for k in range(0, pool, size)]
    for values in _run_processes(jobs, processes) if scheduler is None else _run_cluster(jobs, scheduler):
        done = store(values, done)
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
    """Number → value of these participants."""
    study = _unpack(packed)
    return {n: simulate_value(study, seed, n, measure, between) for seed, n in people}


@cache
def _unpack(packed: bytes) -> Study:
    import cloudpickle

    study: Study = cloudpickle.loads(packed)
    return study
