"""Procedures as state machines: permitted answers, termination, and convergence."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr

from haptorb.errors import InputError
from haptorb_study.bayesian import Bayesian
from haptorb_study.procedures import FixedOrder, ProcedureSequence
from haptorb_study.prompts import Answer, Prompt
from haptorb_study.staircase import Staircase


def stairs(intervals: tuple[int, ...], **more: object) -> Staircase:
    values = {"reference": 1.0, "start": 0.4, "least": 0.001, "most": 1.0, "step": 1.5, "reversals": 10}
    return Staircase(**{**values, **more}, intervals=intervals)  # type: ignore[arg-type]


@given(st.lists(st.integers(1, 2), max_size=80), st.integers(0, 40), st.integers(0, 10))
def test_procedures_end_and_refuse_to_go_on(answers: list[int], trials: int, practice: int) -> None:
    rng = np.random.default_rng(trials)
    warm = FixedOrder((Prompt(phase="practice", low=1, high=2),) * practice)
    procedure = ProcedureSequence((warm, stairs(tuple(rng.integers(1, 3, trials).tolist()))))
    for value in answers:
        if procedure.prompt is None:
            with pytest.raises(InputError, match="complete"):
                procedure.record_answer(Answer(value))
            break
        before = procedure.expected
        procedure = procedure.record_answer(Answer(value))
        assert procedure.expected <= before - 1


@given(st.lists(st.booleans(), min_size=1, max_size=60))
def test_a_staircase_stays_within_its_limits_and_replays_alike(right: list[bool]) -> None:
    procedure = stairs((1,) * 60, least=0.05, most=0.5)
    seen = []
    for one in right:
        if procedure.prompt is None:
            break
        seen.append(procedure.prompt.level)
        procedure = procedure.record_answer(Answer(1 if one else 2))
    assert all(1.05 - 1e-12 <= level <= 1.5 + 1e-12 for level in seen)
    again, replayed = stairs((1,) * 60, least=0.05, most=0.5), []
    for one in right[: len(seen)]:
        replayed.append(again.prompt.level)
        again = again.record_answer(Answer(1 if one else 2))
    assert replayed == seen
    assert again == procedure


def test_two_right_make_it_harder_one_wrong_easier() -> None:
    one = stairs((1,) * 20)
    assert one.record_answer(Answer(1)).difference == one.difference
    assert one.record_answer(Answer(1)).record_answer(Answer(1)).difference == pytest.approx(0.4 / 1.5)
    assert one.record_answer(Answer(2)).difference == pytest.approx(0.6)


@pytest.mark.parametrize("sigma", [0.05, 0.2])
def test_a_staircase_settles_where_the_known_observer_is_right_in_70_7_percent(sigma: float) -> None:
    # Right with Φ(difference/σ) between ½ and 1: p = ½ + ½(2Φ(x/σ) − 1) = Φ(x/σ); 70.7 % lies at 0.545 σ.
    rng = np.random.default_rng(3)
    share = []
    for _ in range(200):
        procedure = stairs((1,) * 400, reversals=24, step=1.4)
        while procedure.prompt is not None:
            right = rng.random() < ndtr(procedure.difference / sigma)
            procedure = procedure.record_answer(Answer(1 if right else 2))
        share.append(np.log(procedure.threshold))
    assert ndtr(np.exp(np.mean(share)) / sigma) == pytest.approx(0.707, abs=0.02)


def test_the_adaptive_procedure_finds_a_known_threshold() -> None:
    rng = np.random.default_rng(5)
    errors, inside = [], 0
    for _ in range(6):
        procedure = Bayesian(1.0, 0.01, 1.0, tuple(rng.integers(1, 3, 50).tolist()))
        while procedure.prompt is not None:
            prompt = procedure.prompt
            p = 0.5 + 0.48 * ndtr(2.0 * np.log2((prompt.level - 1.0) / 0.15))
            right = rng.random() < p
            procedure = procedure.record_answer(Answer(prompt.interval if right else 3 - prompt.interval))
        below = procedure.posterior.sum(axis=1)[procedure.thresholds < 0.15].sum()
        inside += 0.025 <= below <= 0.975
        errors.append(np.log(procedure.threshold / 0.15))
    assert abs(np.mean(errors)) < 0.2
    assert inside >= 4


@settings(deadline=None, max_examples=10)
@given(st.lists(st.booleans(), max_size=12))
def test_the_posterior_is_a_probability(right: list[bool]) -> None:
    procedure = Bayesian(1.0, 0.01, 1.0, (1,) * 12)
    for one in right:
        procedure = procedure.record_answer(Answer(1 if one else 2))
    assert procedure.posterior.sum() == pytest.approx(1.0)
    assert procedure.posterior.min() >= 0.0


@pytest.mark.parametrize(
    ("prompt", "answer", "says"),
    [
        (Prompt(numbers=(1, 2, 3)), Answer(4), "1 to 3"),
        (Prompt(numbers=(1, 5)), Answer(2), "1, 5"),
        (Prompt(low=1, high=7), Answer(8), "1 to 7"),
        (Prompt(low=1, high=7), Answer(None), "whole number"),
        (Prompt(low=0, high=1), Answer(True), "whole number"),
        (Prompt(), Answer(3, (0, 0, 0.05)), "not a number"),
        (Prompt(), Answer(None), "no position"),
    ],
)
def test_an_answer_outside_the_list_is_refused(prompt: Prompt, answer: Answer, says: str) -> None:
    with pytest.raises(InputError, match=says):
        FixedOrder((prompt,)).record_answer(answer)


def test_answers_that_are_no_numbers_are_refused() -> None:
    with pytest.raises(InputError, match="finite"):
        Answer(1, (0.0, float("nan"), 0.05))
    with pytest.raises(InputError, match="duration"):
        Answer(1, None, -1.0)


def test_a_prompt_survives_being_stored() -> None:
    prompt = Prompt(condition="a", set_point=3, numbers=(1, 2, 3), pause=5.0)
    assert Prompt.read(prompt.row()) == prompt
