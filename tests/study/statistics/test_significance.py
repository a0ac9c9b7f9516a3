"""Tests over people and their corrections against scipy and computation by hand; effect sizes by brute force."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import nct, permutation_test, ttest_1samp

from haptorb.errors import InputError
from haptorb_study.statistics.effect_size import effect_size
from haptorb_study.statistics.intervals import mean_interval
from haptorb_study.statistics.significance import compute_p, correct_p, fewest_people

DRAW = np.random.default_rng(5)


@pytest.mark.parametrize("people", [2, 6, 24])
def test_students_test_is_scipys_and_agrees_with_its_interval(people: int) -> None:
    groups = DRAW.normal(0.6, 1.0, (50, people))
    p = compute_p(groups)
    assert p == pytest.approx(ttest_1samp(groups, 0.0, axis=1).pvalue)
    low, high = mean_interval(groups.T)
    assert ((p < 0.05) == ((low > 0) | (high < 0))).all()


@pytest.mark.parametrize("people", [3, 8])
def test_sign_flips_are_scipys_permutations(people: int) -> None:
    d = DRAW.normal(0.5, 1.0, people)
    found = permutation_test(
        (d,), lambda x, axis: np.mean(x, axis=axis), permutation_type="samples", vectorized=True, n_resamples=np.inf
    )
    assert float(compute_p(d, "sign-flip")) == pytest.approx(found.pvalue)


def test_drawn_signs_come_near_all_of_them() -> None:
    d = DRAW.normal(0.4, 1.0, 15)
    signs = 1 - 2 * ((np.arange(1 << 15)[:, None] >> np.arange(15)) & 1)
    exact = np.mean(np.abs(signs @ d) >= abs(d.sum()) - 1e-12)
    assert float(compute_p(d, "sign-flip")) == pytest.approx(exact, abs=4 * np.sqrt(exact / 5_000))


def test_groups_are_decided_one_by_one() -> None:
    groups = DRAW.normal(0.3, 1.0, (300, 13))
    together = compute_p(groups, "sign-flip")
    assert together.tolist() == [float(compute_p(group, "sign-flip")) for group in groups]


@pytest.mark.parametrize(("value", "p"), [(0.0, 1.0), (-2.5, 2 / 2**5)])
def test_people_who_do_not_differ_are_not_proof_beyond_their_number(value: float, p: float) -> None:
    assert float(compute_p([value] * 5)) == pytest.approx(p)
    assert np.isnan(effect_size([value] * 5).d_z)


@pytest.mark.parametrize(("values", "test", "words"), [([1.0], "t", "two"), ([1.0, 2.0], "u", "known: t, sign-flip")])
def test_what_cannot_be_tested_is_refused(values: list[float], test: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        compute_p(values, test)  # type: ignore[arg-type]


def test_holm_by_hand() -> None:
    # Holm 1979: 0.01·4, 0.013·3 is less and does not fall below it, 0.02·2, 0.3·1.
    assert correct_p([0.02, 0.01, 0.3, 0.013]) == pytest.approx((0.04, 0.04, 0.3, 0.04))
    assert correct_p([0.5, np.nan, 0.6]) == pytest.approx((1.0, np.nan, 1.0), nan_ok=True)
    assert correct_p([0.02, 0.4], "bonferroni") == pytest.approx((0.04, 0.8))
    assert correct_p([0.02, 0.4], "none") == (0.02, 0.4)
    assert correct_p([]) == ()


def test_holm_keeps_the_error_of_all_tests_together() -> None:
    groups = DRAW.normal(0.0, 1.0, (2000, 5, 12))
    wrong = [min(correct_p(p)) < 0.05 for p in compute_p(groups)]
    assert np.mean(wrong) == pytest.approx(0.05, abs=4 * np.sqrt(0.05 * 0.95 / 2000))


@pytest.mark.parametrize(("delta", "people"), [(0.0, 6), (1.2, 6), (0.5, 24), (4.0, 4)])
def test_effect_sizes_hold_the_truth_nineteen_times_in_twenty(delta: float, people: int) -> None:
    found = [effect_size(row).d_z_95 for row in DRAW.normal(delta, 1.0, (400, people))]
    held = np.mean([low <= delta <= high for low, high in found])
    assert held == pytest.approx(0.95, abs=4 * np.sqrt(0.05 * 0.95 / 400))


def test_the_ends_are_where_the_noncentral_t_says_so() -> None:
    d = np.array([1.0, 3.0, 2.5, -0.5, 4.0, 2.0])
    found, t = effect_size(d, spread=2.0), float(ttest_1samp(d, 0.0).statistic)
    shares = [nct.cdf(t, 5, end * np.sqrt(6)) for end in found.d_z_95]
    assert shares == pytest.approx([0.975, 0.025], abs=1e-6)
    assert found.d_z == pytest.approx(t / np.sqrt(6))
    assert found.g_av == pytest.approx(2.0 / 2.0 * 0.8408, abs=1e-3)  # J(5), Hedges 1981: near 1 − 3/(4·5 − 1)
    assert found.g_av_95 == pytest.approx([end * d.std(ddof=1) / 2.0 for end in found.d_z_95])


def test_with_two_people_the_correction_for_few_leaves_nothing() -> None:
    assert effect_size([1.0, 2.0], spread=1.0).g_av == 0.0
    with pytest.raises(InputError, match="two people"):
        effect_size([1.0])


@pytest.mark.parametrize(("alpha", "fewest"), [(0.05, 6), (0.001, 11), (0.3, 3)])
def test_fewest_people_are_those_whose_signs_can_show_it(alpha: float, fewest: int) -> None:
    assert fewest_people(alpha, "sign-flip") == fewest
    enough, too_few = (float(compute_p(np.ones(people), "sign-flip")) for people in (fewest, fewest - 1))
    assert enough == pytest.approx(2 / 2**fewest)
    assert enough < alpha <= too_few
