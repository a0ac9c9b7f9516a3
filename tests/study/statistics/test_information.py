"""Information against matrices computed by hand, scipy's entropies, and planted values."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import entropy

from haptorb.errors import InputError
from haptorb_study.statistics.information import plug_in_information, transfer_information

RING = 0.8 * np.eye(8) + 0.1 * np.roll(np.eye(8), 1, axis=1) + 0.1 * np.roll(np.eye(8), -1, axis=1)
#: by hand: log₂ 8 less the entropy of (0.8, 0.1, 0.1)
RING_BITS = 3 + 0.8 * np.log2(0.8) + 0.2 * np.log2(0.1)


def test_a_matrix_by_hand() -> None:
    # Two prompts, the second answered as the first in 1 of 4: H(answer) = H(5/8), H(answer | prompt) = H(1/4)/2.
    table = np.array([[4, 0], [1, 3]])
    by_hand = entropy([5 / 8, 3 / 8], base=2) - entropy([1 / 4, 3 / 4], base=2) / 2
    assert float(plug_in_information(table)) == pytest.approx(by_hand)
    found = transfer_information(table[None])
    assert found.plug_in == pytest.approx(by_hand)
    # Three cells, two rows, two columns are not empty: Miller's correction is zero.
    assert found.miller_madow == pytest.approx(by_hand)
    assert found.most == pytest.approx(1.0)
    assert np.isnan([found.low, found.high]).all()


def test_with_many_answers_all_formulations_meet() -> None:
    found = transfer_information(np.stack([10_000 * RING / 2] * 2).round())
    assert [found.bits, found.plug_in, found.miller_madow] == pytest.approx([RING_BITS] * 3, abs=2e-3)
    assert found.chance < 2e-3
    assert found.p == pytest.approx(1 / 200)


def test_few_answers_are_corrected_and_the_interval_holds_the_truth() -> None:
    """benchmarks/study/study_localisation.py in a reduced form: 12 answers to each of 25 set-points."""
    rng = np.random.default_rng(4)
    found = [
        transfer_information(np.stack([[rng.multinomial(2, row) for row in RING] for _ in range(6)])) for _ in range(60)
    ]
    bits, plug_in = (np.array([getattr(one, name) for one in found]) for name in ("bits", "plug_in"))
    error = 4 * bits.std() / np.sqrt(len(bits))
    assert bits.mean() == pytest.approx(RING_BITS, abs=0.02 * RING_BITS + error)
    assert plug_in.mean() > RING_BITS * 1.03
    assert np.mean([one.low <= RING_BITS <= one.high for one in found]) > 0.85


def test_guessing_transfers_nothing_and_p_says_so() -> None:
    rng = np.random.default_rng(6)
    ps = []
    for n in range(60):
        found = transfer_information(rng.multinomial(3, np.full(6, 1 / 6), (4, 6)), seed=n)
        assert found.plug_in == pytest.approx(found.chance, abs=0.3)
        ps.append(found.p)
    assert np.mean(np.array(ps) <= 0.05) < 0.15


def test_one_answer_each_or_one_answer_always() -> None:
    once = transfer_information(np.eye(4)[None])
    assert np.isnan(once.bits)
    assert (once.plug_in, once.p) == (2.0, 1.0)  # as much as by chance
    same = transfer_information(np.stack([np.tile([5.0, 0, 0], (3, 1))] * 2))
    assert (same.bits, same.plug_in, same.p) == (0.0, 0.0, 1.0)


@pytest.mark.parametrize("counts", [np.zeros((2, 3, 3)), -np.ones((1, 2, 2)), np.full((1, 2, 2), 0.5), np.eye(3)])
def test_what_is_no_count_is_refused(counts: np.ndarray) -> None:
    with pytest.raises(InputError, match="counts must be whole"):
        transfer_information(counts)
