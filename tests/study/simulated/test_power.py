"""Number of participants: against the power of a known test, and rejected without a comparison."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.stats import nct, t

from haptorb.errors import InputError
from haptorb_study.analysis.analysis import analyse
from haptorb_study.simulated.power import power, power_of, simulate_value
from haptorb_study.study_file import Study, study_of
from oracles.repetitions import repetitions

TWO = """
name = "two"
[set_points]
points = [{ number = 1, theta_deg = 0 }, { number = 2, theta_deg = 36 }]
[trials]
repetitions = 1
[[conditions]]
name = "base"
[[conditions]]
name = "weak"
parameters = { moment = 0.05 }
"""


def t_power(effect: float, n: int, alpha: float = 0.05) -> float:
    """Of the paired two-sided t test, in closed form."""
    limit = t.ppf(1 - alpha / 2, n - 1)
    shift = effect * np.sqrt(n)
    return float(nct.sf(limit, n - 1, shift) + nct.cdf(-limit, n - 1, shift))


@pytest.mark.parametrize("effect", [0.5, 1.0])
def test_normal_differences_have_the_power_of_the_t_test(effect: float) -> None:
    # A pool as large as this is nearly its distribution.
    pool = np.random.default_rng(1).standard_normal(4000)
    pool = (pool - pool.mean()) / pool.std(ddof=1) + effect
    found = power_of(pool.tolist(), (8, 12, 20, 32))
    for n, share in zip(found.people, found.power, strict=True):
        assert share == pytest.approx(t_power(effect, n), abs=0.02)


def test_sign_flips_are_nearly_as_powerful_where_differences_are_normal() -> None:
    pool = 1.0 + np.random.default_rng(1).standard_normal(400)
    signs, student = (power_of(pool.tolist(), (10,), test=test) for test in ("sign-flip", "t"))
    assert signs.power[signs.people.index(10)] == pytest.approx(student.power[student.people.index(10)], abs=0.05)


def test_without_a_difference_the_test_errs_as_often_as_it_says() -> None:
    pool = np.random.default_rng(2).standard_normal(4000)
    found = power_of((pool - pool.mean()).tolist(), (8, 16, 32))
    assert all(share < 0.09 for share in found.power)
    assert found.needed is None
    assert "more than 500" in found.sentence


def test_a_small_pool_says_how_little_it_knows() -> None:
    draw = np.random.default_rng(3)
    small, large = (power_of((0.8 + draw.standard_normal(n)).tolist(), (6, 12, 24, 48)) for n in (8, 800))
    widths = [max(h - low for h, low in zip(found.high, found.low, strict=True)) for found in (small, large)]
    assert widths[0] > 2 * widths[1]
    low, high = large.needed_95
    assert low is not None
    assert high is not None
    assert low <= (large.needed or 0) <= high


@pytest.mark.parametrize("people", [(100,), (3,)])
def test_the_search_goes_below_and_above_what_was_given(people: tuple[int, ...]) -> None:
    pool = np.random.default_rng(1).standard_normal(4000)
    pool = (pool - pool.mean()) / pool.std(ddof=1) + 0.6
    needed = next(n for n in range(2, 500) if t_power(0.6, n) >= 0.8)
    found = power_of(pool.tolist(), people)
    assert found.needed == pytest.approx(needed, abs=2)
    assert set(found.people) == {*people, found.needed}
    assert found.power[found.people.index(found.needed or 0)] >= 0.8
    assert all(p < 0.8 for n, p in zip(found.people, found.power, strict=True) if n < (found.needed or 0))
    low, high = found.needed_95
    assert (low or 0) <= (found.needed or 0) <= (high or 0)


def test_the_answer_does_not_depend_on_what_was_given() -> None:
    pool = (0.5 + np.random.default_rng(4).standard_normal(60)).tolist()
    first, second = power_of(pool, (6, 24)), power_of(pool, (24, 30))
    assert abs((first.needed or 0) - (second.needed or 0)) <= 1
    assert first.power[first.people.index(24)] == second.power[second.people.index(24)]


def test_with_a_clear_difference_the_test_itself_sets_the_number() -> None:
    clear = [5.0, 6.0, 5.5, 6.5, 5.2, 5.8, 6.1, 5.9]
    found = power_of(clear, (12,), test="sign-flip")
    assert (found.needed, found.least) == (6, 6)  # 2/2⁶ < 0.05 < 2/2⁵
    assert "with fewer than 6 the test cannot reach p < 0.05" in found.sentence
    assert power_of(clear, (12,), alpha=0.001, test="sign-flip").needed == 11  # 2/2¹¹ < 0.001
    assert power_of(clear, (12,)).needed == 3


def test_simulated_participants_find_a_weak_dome_less_exactly_and_are_called_simulated() -> None:
    told: list[tuple[int, int]] = []
    found = power(study_of(TWO), pool=8, people=(6, 12), progress=lambda done, of: told.append((done, of)))
    assert found.difference < 0  # base is found more exactly than weak
    assert told == [(n, 8) for n in range(1, 9)]
    assert "SIMULATED" in found.sentence
    assert found.numbers()["simulated"] is True
    assert (found.measure, found.a, found.b) == ("error", "base", "weak")


def test_a_choice_is_counted_for_the_one_that_was_chosen() -> None:
    study = study_of(
        'name = "pick"\nprocedure = "forced-choice"\n[trials]\nrepetitions = 8\n'
        '[[conditions]]\nname = "base"\n[[conditions]]\nname = "weak"\nparameters = { moment = 0.05 }'
    )
    # "Stronger" is all that a simulated participant can prefer.
    assert simulate_value(study, (0, 1), 0, "choice", ("base", "weak")) > 0.3
    assert simulate_value(study, (0, 1), 0, "choice", ("weak", "base")) < -0.3


@pytest.mark.parametrize(
    ("change", "options", "words"),
    [
        ("[[conditions]]", {}, "one condition"),
        ("", {"between": ("base", "strong")}, "no condition 'strong'"),
        ("", {"between": ("base", "base")}, "compared with itself"),
        ("", {"measure": "threshold"}, "error, accuracy"),
        ("", {"pool": 3}, "8 to 100000"),
        ("", {"pool": 8, "people": (1,)}, "2 to 500"),
        ("", {"pool": 8, "alpha": 0.0}, "alpha"),
        ("", {"pool": 8, "wanted": 1.0}, "power"),
    ],
)
def test_what_cannot_be_predicted_is_refused(change: str, options: dict[str, object], words: str) -> None:
    text = TWO[: TWO.index('[[conditions]]\nname = "weak"')] if change else TWO
    with pytest.raises(InputError, match=words):
        power(study_of(text), **options)  # type: ignore[arg-type]


def test_constant_stimuli_give_each_person_a_threshold_and_a_midpoint() -> None:
    study = study_of(
        'name = "x"\nprocedure = "constant"\n[levels]\nreference = 1.2\nvalues = [0.9, 1.1, 1.3, 1.5]\n'
        '[trials]\nrepetitions = 8\n[[conditions]]\nname = "a"\n[[conditions]]\nname = "b"'
    )
    assert simulate_value(study, (0, 1), 0, "midpoint", ("a", "b")) == pytest.approx(0.0, abs=0.25)
    assert power_of([simulate_value(study, (0, n), n, "threshold", ("a", "b")) for n in range(4)]).least == 2


PLANNED = (
    TWO
    + """
[plan]
participants = 18
test = "sign-flip"
alpha = 0.04
[[plan.tests]]
measure = "error"
between = ["weak", "base"]
[[plan.tests]]
measure = "accuracy"
between = ["base", "weak"]
"""
)


def test_the_plan_says_what_is_not_asked_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whose answers they are does not matter here."""
    simulated: list[tuple[str, tuple[str, str]]] = []

    def simulate_pool(study: Study, pool: int, seed: int, measure: str, between: tuple[str, str], **_: object) -> Any:
        simulated.append((measure, between))
        return [0.1 + 0.01 * n for n in range(pool)]

    monkeypatch.setattr("haptorb_study.simulated.power.simulate_pool", simulate_pool)
    found = power(study_of(PLANNED), pool=8, people=(6,))
    assert (found.measure, found.a, found.b, found.test) == ("error", "weak", "base", "sign-flip")
    assert found.alpha == pytest.approx(0.02)  # two tests, Holm: the strictest step
    assert 18 in power(study_of(PLANNED), test="t", pool=8).people
    asked = power(study_of(PLANNED), ("base", "weak"), "accuracy", pool=8, alpha=0.05, test="t", people=(6,))
    assert (asked.measure, asked.alpha, asked.test) == ("accuracy", 0.05, "t")
    planned = ("error", ("weak", "base"))
    assert simulated == [planned, planned, ("accuracy", ("base", "weak"))]


def test_what_is_claimed_of_all_conditions_has_a_power_too() -> None:
    found = power(study_of(TWO), measure="error-slope", pool=8, people=(6,))
    assert (found.a, found.b, found.unit) == ("", "", "mm/deg")
    assert found.difference > 0


def test_power_is_what_the_analysis_finds() -> None:
    """benchmarks/study/study_power.py in a reduced form: whole analyses of groups of the same people, counted."""
    study = study_of(
        'name = "r"\nprocedure = "rating"\n[trials]\nrepetitions = 2\n'
        '[[conditions]]\nname = "base"\n[[conditions]]\nname = "other"'
    )
    draw = np.random.default_rng(8)
    a, b = draw.integers(3, 8, (24, 2)), draw.integers(2, 7, (24, 2))  # two ratings each
    told = power_of((a.mean(axis=1) - b.mean(axis=1)).tolist(), (8,))
    studies, found = repetitions(150, 500), 0
    count = 8 * 4
    for _ in range(studies):
        who = draw.integers(0, 24, 8)
        columns = {
            "participant": np.repeat([f"P{n}" for n in range(8)], 4), "trial": np.arange(count),
            "condition": np.tile(["base", "base", "other", "other"], 8), "phase": np.full(count, "main"),
            "answer": np.concatenate([a[who], b[who]], axis=1).ravel(), "simulated": np.full(count, False),
            "simulated_device": np.full(count, None), "safety": np.full(count, ""), "repeats": np.zeros(count),
            "distance_mm": np.full(count, np.nan), "seconds": np.ones(count),
        }  # fmt: skip
        (row,) = analyse(study, columns).comparisons
        found += row.p < 0.05
    share = told.power[told.people.index(8)]
    assert 0.3 < share < 0.95  # where it is hardest to agree
    assert found / studies == pytest.approx(share, abs=0.02 + 3 * np.sqrt(share * (1 - share) / studies))
