"""Power of a study: number of participants that detects an effect, estimated with simulated participants."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import cache
from typing import Any, final

import numpy as np

from haptorb.arrays import Array
from haptorb.child_process import spawn_context
from haptorb.cluster import open_cluster, run_jobs
from haptorb.errors import InputError
from haptorb_study.analysis.measures import PersonMeasures, list_thresholds
from haptorb_study.analysis_plan import CLAIMS, MEASURES, unit_of
from haptorb_study.columns import Columns, place_answers
from haptorb_study.order import plan, procedure_of
from haptorb_study.procedures import Procedure
from haptorb_study.prompts import Answer, Prompt
from haptorb_study.simulated.participant import Participant
from haptorb_study.statistics.significance import MAX_EXACT_PARTICIPANTS, PairTest, check_test, compute_p, fewest_people
from haptorb_study.study_file import Study

__all__ = [
    "ADAPTIVE",
    "DEFAULT_GROUP_SIZES",
    "MAX_GROUP_SIZE",
    "GroupPower",
    "Power",
    "answer_study",
    "list_columns",
    "power",
    "power_of",
    "simulate_pool",
    "simulate_value",
]


# --------------------------------------------------------------------------------------------------
# Pool of simulated participants: each answers a whole study in memory and yields one value of a measure.


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


# --------------------------------------------------------------------------------------------------
# Power by group size, of groups drawn from the pool.


MAX_GROUP_SIZE = 500  #: search limit
_MAX_SLOW_GROUPS = 2000  #: groups at most for slow tests


@final
class GroupPower:
    """Power by group size: share of groups drawn from `pool` in which `test` shows p < `alpha`.

    The groups depend on `seed` and their size only, so a power does not depend on the other sizes.
    """

    def __init__(self, pool: Array, alpha: float, groups: int, seed: tuple[int, ...], test: PairTest = "t") -> None:
        self._pool, self._alpha, self._groups, self._seed, self._test = pool, alpha, groups, seed, test
        self.found: dict[int, float] = {}  #: powers computed so far

    def power(self, people: int) -> float:
        """Power of groups of `people`."""
        if people not in self.found:
            draw = np.random.default_rng([*self._seed, people])
            count = self._groups
            if self._test == "sign-flip" and people > MAX_EXACT_PARTICIPANTS:
                count = min(count, _MAX_SLOW_GROUPS)  # thousands of sign patterns per group
            groups = self._pool[draw.integers(0, len(self._pool), (count, people))]
            self.found[people] = float(np.mean(compute_p(groups, self._test) < self._alpha))
        return self.found[people]

    @property
    def least(self) -> int:
        """Smallest group in which the test can show p < alpha."""
        return fewest_people(self._alpha, self._test)

    def find_fewest(self, wanted: float, start: int) -> int | None:
        """Smallest group with the power `wanted`, searched from `start`; None: above MAX_GROUP_SIZE.

        Assumes that power increases with the group size, which holds except for steps at small sizes.
        """
        low, high = self.least - 1, min(max(start, self.least), MAX_GROUP_SIZE)
        while self.power(high) < wanted:
            if high == MAX_GROUP_SIZE:
                return None
            low, high = high, min(2 * high, MAX_GROUP_SIZE)
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if self.power(middle) >= wanted else (middle, high)
        return high


# --------------------------------------------------------------------------------------------------
# Power estimate from a pool of simulated participants.
#
# Each simulated participant answers the study once and gives one paired difference. Groups of n are drawn from the
# pool, and the test of the analysis (`compute_p`) is applied to each: the share of p < α is the power at n. The
# smallest group with the wanted power is searched below and above the sizes asked for. The uncertainty due to the
# finite pool is estimated by resampling the pool.


DEFAULT_GROUP_SIZES = (6, 8, 10, 12, 16, 20, 24, 32, 48)  #: default group sizes
_GROUPS = 20_000  #: groups drawn per group size
_RESAMPLES = 80  #: resamples of the pool
_GROUPS_PER_RESAMPLE = 200  #: groups drawn from each resample
_TEST_NAMES = {"t": "Student's paired t test", "sign-flip": "sign-flip test"}


@dataclass(frozen=True)
class Power:
    """Power estimate; every interval is 95 % over resampled pools."""

    measure: str
    a: str  #: empty, like b: the measure against zero, over all conditions
    b: str
    pool: int
    difference: float  #: mean of a − b over the pool
    spread: float  #: its standard deviation over participants
    alpha: float
    wanted: float
    people: tuple[int, ...]  #: group sizes asked for, and the smallest that reaches `wanted`
    power: tuple[float, ...]  #: by group size
    low: tuple[float, ...]
    high: tuple[float, ...]
    needed: int | None  #: smallest group that reaches `wanted`; None: above MAX_GROUP_SIZE
    needed_95: tuple[int | None, int | None]
    least: int  #: smallest group in which the test can be significant
    test: PairTest = "t"
    unit: str = ""  #: of the difference

    @property
    def sentence(self) -> str:
        """Summary for users."""
        most = f"more than {MAX_GROUP_SIZE}"
        low, high = (most if n is None else str(n) for n in self.needed_95)
        needed = most if self.needed is None else f"about {self.needed}"
        floor = ""
        if self.needed == self.least:
            floor = f"; with fewer than {self.least} the test cannot reach p < {self.alpha:g}"
        what = f"{self.a} − {self.b} " if self.a else ""
        return (
            f"{needed} participants (95 %: {low} to {high}) detect {self.measure} {what}= {self.difference:.3g} ± "
            f"{self.spread:.2g}{self.unit and f' {self.unit}'} with a probability of {100 * self.wanted:.0f} % at α = "
            f"{self.alpha:.3g} ({_TEST_NAMES[self.test]}, two-sided){floor}; predicted with {self.pool} SIMULATED "
            "participants, which are not evidence about people"
        )

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types."""
        rows = zip(self.people, self.power, self.low, self.high, strict=True)
        return {
            "simulated": True, "measure": self.measure, "unit": self.unit, "a": self.a, "b": self.b, "test": self.test,
            "pool": self.pool,
            "difference": self.difference, "standard_deviation": self.spread, "alpha": self.alpha,
            "wanted_power": self.wanted, "needed": self.needed, "needed_95": list(self.needed_95),
            "least_people": self.least, "searched_up_to": MAX_GROUP_SIZE,
            "power": [{"people": n, "power": p, "interval_95": [low, high]} for n, p, low, high in rows],
        }  # fmt: skip


def power(
    study: Study, between: tuple[str, str] | None = None, measure: str | None = None, *, pool: int = 40,
    people: Sequence[int] | None = None, alpha: float | None = None, wanted: float = 0.8, seed: int = 0,
    test: PairTest | None = None, processes: int = 1, scheduler: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Power:  # fmt: skip
    """Power of `study` for the difference of `measure` `between` two conditions; `progress` (done, in all).

    Defaults are those of the study's plan: its first test, its level divided by the number of tests (if p is
    corrected), its number of participants; without a plan the first two conditions, α = 0.05 and Student's test.
    `scheduler` is the address of a Dask cluster; the result does not depend on where it is computed.

    Raises InputError if the study has no such condition or measure.
    """
    plan = study.plan
    if plan is not None and measure is None and between is None:
        measure, between = plan.tests[0].measure, plan.tests[0].between
    measure, between = _check_question(study, measure, between)
    alpha = alpha if alpha is not None else plan.strictest_alpha if plan else 0.05
    test = test or (plan.test if plan else "t")
    people = people or (
        tuple(sorted({*DEFAULT_GROUP_SIZES, min(plan.participants, MAX_GROUP_SIZE)})) if plan else DEFAULT_GROUP_SIZES
    )
    _check_numbers(people, alpha, wanted, test)
    if isinstance(pool, bool) or not 8 <= pool <= 100_000 or seed < 0:
        raise InputError(f"a pool has 8 to 100000 simulated participants, a seed is 0 or more; got {pool} and {seed}")
    found = simulate_pool(
        study, pool, seed, measure, between, processes=processes, scheduler=scheduler, progress=progress
    )
    return power_of(found, people, alpha, wanted, (measure, *(between or ("", ""))), seed, test,
                    unit_of(measure, study.level_unit))  # fmt: skip


def _check_question(
    study: Study, measure: str | None, between: tuple[str, str] | None
) -> tuple[str, tuple[str, str] | None]:
    """Validate `measure` and conditions, with the study's own as default."""
    known = MEASURES[study.procedure]
    measure = measure or known[0]
    if measure not in known:
        raise InputError(f"procedure '{study.procedure}' has no measure '{measure}'; known: {', '.join(known)}")
    names = [condition.name for condition in study.conditions]
    if between is None and measure in CLAIMS:
        return measure, None
    if len(names) < 2:
        raise InputError(f"study '{study.name}' has one condition: add a second [[conditions]] to compare it with")
    a, b = between or (names[0], names[1])
    for name in (a, b):
        if name not in names:
            raise InputError(f"there is no condition '{name}'; known: {', '.join(names)}")
    if a == b:
        raise InputError(f"a condition cannot be compared with itself ('{a}')")
    return measure, (a, b)


def power_of(
    pairs: Sequence[float], people: Sequence[int] = DEFAULT_GROUP_SIZES, alpha: float = 0.05, wanted: float = 0.8,
    what: tuple[str, str, str] = ("difference", "a", "b"), seed: int = 0, test: PairTest = "t", unit: str = "",
) -> Power:  # fmt: skip
    """Power from the paired differences of a pool, for groups of `people` and for the smallest that reaches `wanted`.

    `what` is (measure, a, b), `unit` that of the differences.
    """
    _check_numbers(people, alpha, wanted, test)
    d = np.asarray(pairs, dtype=float)
    d = d[np.isfinite(d)]
    if len(d) < 4:
        raise InputError("fewer than 4 simulated participants have a difference: the procedure ends too soon")
    draw = np.random.default_rng([seed, 2])
    # Pool k is resample k, pool 0 the pool itself; groups are drawn from it with replacement.
    pools = np.vstack([d, d[draw.integers(0, len(d), (_RESAMPLES, len(d)))]])
    drawn = [
        GroupPower(pool, alpha, _GROUPS_PER_RESAMPLE if k else _GROUPS, (seed, 3, k), test)
        for k, pool in enumerate(pools)
    ]
    whole, parts = drawn[0], drawn[1:]
    needed = whole.find_fewest(wanted, min(people))
    counts = tuple(sorted({*people, *([] if needed is None else [needed])}))
    shares = np.array([[part.power(n) for n in counts] for part in parts])
    low, high = np.percentile(shares, (2.5, 97.5), axis=0)
    ends = sorted(part.find_fewest(wanted, needed or MAX_GROUP_SIZE) or MAX_GROUP_SIZE + 1 for part in parts)
    needed_95 = [
        None if end > MAX_GROUP_SIZE else end for end in (ends[int(0.025 * _RESAMPLES)], ends[int(0.975 * _RESAMPLES)])
    ]
    return Power(
        *what, len(d), float(d.mean()), float(d.std(ddof=1)), alpha, wanted, counts,
        tuple(whole.power(n) for n in counts), tuple(low.tolist()), tuple(high.tolist()), needed,
        (needed_95[0], needed_95[1]), whole.least, test, unit,
    )  # fmt: skip


def _check_numbers(people: Sequence[int], alpha: float, wanted: float, test: str) -> None:
    """Validate group sizes and levels before a pool is simulated."""
    if not 0 < alpha < 0.5 or not 0.1 <= wanted < 1:
        raise InputError(f"needs 0 < alpha < 0.5 and 0.1 ≤ power < 1; got {alpha:g} and {wanted:g}")
    if not people or any(isinstance(n, bool) or not isinstance(n, int) or not 2 <= n <= MAX_GROUP_SIZE for n in people):
        raise InputError(
            f"numbers of people must be whole, 2 to {MAX_GROUP_SIZE}; got {', '.join(map(str, people)) or 'none'}"
        )
    check_test(test)
