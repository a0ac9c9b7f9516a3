"""Power of a study: number of participants that detects an effect, estimated with simulated participants."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from haptorb.arrays import Array
from haptorb.errors import InputError
from haptorb_study.analysis_plan import CLAIMS, MEASURES, unit_of
from haptorb_study.simulated.pool import simulate_pool
from haptorb_study.statistics.significance import MAX_EXACT_PARTICIPANTS, PairTest, check_test, compute_p, fewest_people
from haptorb_study.study_file import Study

__all__ = ["DEFAULT_GROUP_SIZES", "MAX_GROUP_SIZE", "GroupPower", "Power", "power", "power_of"]


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
