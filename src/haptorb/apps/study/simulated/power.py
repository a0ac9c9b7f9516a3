"""How many participants a study needs to see a difference between two conditions, foretold with simulated ones.

A pool of simulated participants sits the study once; each gives one paired difference. Groups of n are drawn from the
pool, and the test that the analysis uses (paired, sign-flip, two-sided) is applied to each: its share of p < α is the
power at n. What is uncertain in that because the pool is finite is stated, by drawing whole pools from the pool.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from haptorb.apps.asking.procedure import Procedure
from haptorb.apps.asking.prompt import Answer, Prompt
from haptorb.apps.study.model.order import plan, procedure_of
from haptorb.apps.study.model.study_file import Study
from haptorb.apps.study.simulated.participant import Participant
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array

__all__ = ["MEASURES", "PEOPLE", "Power", "differences", "power", "power_of"]

PEOPLE = (6, 8, 10, 12, 16, 20, 24, 32, 48)  #: below 6 the test cannot reach p < 0.05, whatever is found
#: procedure → what may be compared, the first unless told; all in the units of the analysis
MEASURES = {
    "identification": ("error", "accuracy"), "localisation": ("error",), "rating": ("rating",),
    "staircase": ("threshold",), "bayesian": ("threshold",), "forced-choice": ("choice",),
}  # fmt: skip
_GROUPS = 2000  #: groups drawn per number of people
_POOLS = 80  #: pools drawn from the pool
_FEWER = 200  #: groups drawn from each of those
_SIGNS = 512  #: sign patterns of the test; all there are, up to 9 people


@dataclass(frozen=True)
class Power:
    """What was found; every interval is 95 % over pools."""

    measure: str
    a: str
    b: str
    pool: int
    difference: float  #: mean of a − b over the pool
    spread: float  #: its standard deviation over people
    alpha: float
    wanted: float
    people: tuple[int, ...]
    power: tuple[float, ...]  #: by people
    low: tuple[float, ...]
    high: tuple[float, ...]
    needed: int | None  #: fewest of `people` that reach `wanted`; None: more than the most
    needed_95: tuple[int | None, int | None]

    @property
    def sentence(self) -> str:
        """For people."""
        most = f"more than {self.people[-1]}"
        low, high = (most if n is None else str(n) for n in self.needed_95)
        needed = most if self.needed is None else f"about {self.needed}"
        return (
            f"{needed} participants (95 %: {low} to {high}) detect {self.measure} {self.a} − {self.b} = "
            f"{self.difference:.3g} ± {self.spread:.2g} with a probability of {self.wanted:.0%} at α = {self.alpha:g}; "
            f"predicted with {self.pool} SIMULATED participants, which is no evidence about people"
        )

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types."""
        rows = zip(self.people, self.power, self.low, self.high, strict=True)
        return {
            "simulated": True, "measure": self.measure, "a": self.a, "b": self.b, "pool": self.pool,
            "difference": self.difference, "standard_deviation": self.spread, "alpha": self.alpha,
            "wanted_power": self.wanted, "needed": self.needed, "needed_95": list(self.needed_95),
            "power": [{"people": n, "power": p, "interval_95": [low, high]} for n, p, low, high in rows],
        }  # fmt: skip


def power(
    study: Study, between: tuple[str, str] | None = None, measure: str | None = None, *, pool: int = 40,
    people: Sequence[int] = PEOPLE, alpha: float = 0.05, wanted: float = 0.8, seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Power:  # fmt: skip
    """Power of `study` to see `measure` differ `between` two conditions (its first two); `progress` (done, of).

    Raises InputError for a study, condition or measure for which there is no such thing.
    """
    known = MEASURES.get(study.procedure)
    if known is None:
        raise InputError(
            f"procedure '{study.procedure}' has no measure per participant to compare; power is predicted for "
            f"{', '.join(MEASURES)}"
        )
    names = [condition.name for condition in study.conditions]
    if len(names) < 2:
        raise InputError(f"study '{study.name}' has one condition: add a second [[conditions]] to compare it with")
    a, b = between or (names[0], names[1])
    for name in (a, b):
        if name not in names:
            raise InputError(f"there is no condition '{name}'; known: {', '.join(names)}")
    if a == b:
        raise InputError(f"a condition cannot be compared with itself ('{a}')")
    measure = measure or known[0]
    if measure not in known:
        raise InputError(f"procedure '{study.procedure}' has no measure '{measure}'; known: {', '.join(known)}")
    if not 8 <= pool <= 10_000:
        raise InputError(f"a pool has 8 to 10000 simulated participants; got {pool}")
    found = []
    for n in range(pool):
        found.append(differences(study, (seed, n + 1), n, a, b, measure))
        if progress is not None:
            progress(n + 1, pool)
    return power_of(found, people, alpha, wanted, (measure, a, b), seed)


def power_of(
    pairs: Sequence[float], people: Sequence[int] = PEOPLE, alpha: float = 0.05, wanted: float = 0.8,
    what: tuple[str, str, str] = ("difference", "a", "b"), seed: int = 0,
) -> Power:  # fmt: skip
    """Power from the paired differences of a pool, by groups of `people`; `what` is (measure, a, b)."""
    if not 0 < alpha < 0.5 or not 0.1 <= wanted < 1:
        raise InputError(f"needs 0 < alpha < 0.5 and 0.1 ≤ power < 1; got {alpha:g} and {wanted:g}")
    if not people or any(isinstance(n, bool) or not isinstance(n, int) or not 2 <= n <= 500 for n in people):
        raise InputError(f"numbers of people must be whole, 2 to 500; got {', '.join(map(str, people)) or 'none'}")
    d = np.asarray(pairs, dtype=float)
    d = d[np.isfinite(d)]
    if len(d) < 4:
        raise InputError("fewer than 4 simulated participants gave a difference: the procedure ends too soon")
    draw = np.random.default_rng([seed, 2])
    counts = tuple(sorted(set(people)))
    signs = [_signs(n, draw) for n in counts]
    # The k-th pool is the k-th resample, the 0th the pool itself; groups come from that pool with replacement.
    pools = np.vstack([d, d[draw.integers(0, len(d), (_POOLS, len(d)))]])
    shares = np.array(
        [
            [_share(pool, n, s, alpha, _FEWER if k else _GROUPS, draw) for n, s in zip(counts, signs, strict=True)]
            for k, pool in enumerate(pools)
        ]
    )
    reached = [_find_fewest(row, counts, wanted) for row in shares]
    low, high = np.percentile(shares[1:], (2.5, 97.5), axis=0)
    ends = np.sort([np.inf if n is None else n for n in reached[1:]])
    needed_95 = tuple(
        None if not np.isfinite(end) else int(end) for end in (ends[int(0.025 * _POOLS)], ends[int(0.975 * _POOLS)])
    )
    return Power(
        *what, len(d), float(d.mean()), float(d.std(ddof=1)), alpha, wanted, counts, tuple(shares[0].tolist()),
        tuple(low.tolist()), tuple(high.tolist()), reached[0], (needed_95[0], needed_95[1]),
    )  # fmt: skip


def differences(study: Study, seed: tuple[int, ...], ordinal: int, a: str, b: str, measure: str) -> float:
    """a − b of one simulated participant after the whole study; NaN where one of both is missing."""
    somebody, drawn = Participant(study, seed), plan(study, ordinal)
    procedure: Procedure = procedure_of(study, drawn)
    responses: list[tuple[Prompt, Answer]] = []
    while (prompt := procedure.prompt) is not None:
        answer = somebody.answer(prompt, len(responses))
        procedure = procedure.record_answer(answer)
        responses.append((prompt, answer))
    if measure == "threshold":
        one, two = (_threshold(getattr(procedure, "parts", ()), name) for name in (a, b))
        return one - two
    if measure == "choice":
        # a's share of the choices between both, less one half: what a prefers over b.
        pairs = [(p, x) for p, x in responses if {p.condition, p.other} == {a, b}]
        chosen = [(x.value == p.interval) == (p.condition == a) for p, x in pairs]
        return float(np.mean(chosen)) - 0.5 if chosen else float("nan")
    contact = study.load_device().contact_distance
    values: dict[str, list[float]] = {a: [], b: []}
    for prompt, answer in responses:
        if prompt.phase != "practice" and prompt.condition in values:
            values[prompt.condition].append(_measure_answer(study, prompt, answer, measure, contact))
    return float(np.mean(values[a]) - np.mean(values[b])) if values[a] and values[b] else float("nan")


def _measure_answer(study: Study, prompt: Prompt, answer: Answer, measure: str, contact: float) -> float:
    if measure == "accuracy":
        return float(answer.value == prompt.set_point)
    if measure == "rating":
        return float(answer.value or 0)
    goal: Array = contact * np.array(study.point(prompt.set_point).direction)
    return 1e3 * float(np.linalg.norm(np.asarray(answer.position) - goal))


def _threshold(parts: Sequence[Procedure], name: str) -> float:
    return next((float(p.threshold) for p in parts if getattr(p, "condition", None) == name), float("nan"))  # type: ignore[attr-defined]


def _signs(n: int, draw: np.random.Generator) -> Array:
    """(patterns, n): all there are, or as many drawn ones, the observed among them."""
    if 2**n <= _SIGNS:
        return np.array(list(product((1.0, -1.0), repeat=n)))
    drawn: Array = draw.choice((-1.0, 1.0), (_SIGNS, n))
    drawn[0] = 1.0
    return drawn


def _share(pool: Array, n: int, signs: Array, alpha: float, count: int, draw: np.random.Generator) -> float:
    """Of `count` groups of n from `pool`, how many show p < α."""
    groups = pool[draw.integers(0, len(pool), (count, n))]
    sums = np.abs(groups @ signs.T)
    counts = np.abs(groups.sum(axis=1))[:, None]
    p = np.mean(sums >= counts - 1e-12 * np.abs(groups).sum(axis=1)[:, None], axis=1)
    return float(np.mean(p < alpha))


def _find_fewest(shares: Array, counts: Sequence[int], wanted: float) -> int | None:
    """The fewest from which on the wanted power is reached."""
    return next((n for k, n in enumerate(counts) if (shares[k:] >= wanted).all()), None)
