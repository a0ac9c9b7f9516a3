"""Magnitude estimation: a planted power law is found, whatever scale each person has of their own."""

from __future__ import annotations

import numpy as np
import pytest

from haptorb.apps.asking.prompt import Answer, Prompt
from haptorb.apps.study.analysis.by_condition.magnitude import estimate_magnitudes
from haptorb.apps.study.model.order import plan, procedure_of
from haptorb.apps.study.model.study_file import study_of
from haptorb.errors import InputError

LEVELS = "[levels]\nreference = 1.0\nvalues = [0.25, 0.5, 1.0, 2.0]\n"
STUDY = study_of(f'name = "x"\nprocedure = "magnitude"\n{LEVELS}[trials]\nrepetitions = 3\n')


def answer(exponents: list[float], scales: list[float], spread: float) -> dict[str, np.ndarray]:
    draw = np.random.default_rng(2)
    rows = []
    for person, (exponent, scale) in enumerate(zip(exponents, scales, strict=True)):
        procedure = procedure_of(STUDY, plan(STUDY, person))
        for prompt in procedure.parts[0].prompts:
            value = scale * prompt.level**exponent * np.exp(spread * draw.standard_normal())
            rows.append((f"P{person}", "base", prompt.level, max(1, round(value))))
    people, names, levels, values = zip(*rows, strict=True)
    return {"participant": np.array(people), "condition": np.array(names), "level": np.array(levels),
            "answer": np.array(values)}  # fmt: skip


def test_a_power_law_is_found_whatever_the_scales() -> None:
    (one,) = estimate_magnitudes(STUDY, answer([0.8] * 4, [50.0, 100.0, 1000.0, 20_000.0], 0.0))
    assert one.exponent == pytest.approx(0.8, abs=0.02)
    assert one.means == pytest.approx(np.array([0.25, 0.5, 1.0, 2.0]) ** 0.8, rel=0.02)
    assert one.means[2] == pytest.approx(1.0, abs=0.01)


def test_the_interval_is_over_people() -> None:
    draw = np.random.default_rng(4)
    true = (0.8 + 0.1 * draw.standard_normal(12)).tolist()
    (one,) = estimate_magnitudes(STUDY, answer(true, [1000.0] * 12, 0.1))
    low, high = one.exponent_95
    assert low < np.mean(true) < high
    assert 0.05 < high - low < 0.25
    (alone,) = estimate_magnitudes(STUDY, answer([0.8], [1000.0], 0.0))
    assert np.isnan(alone.exponent_95).all()


def test_any_whole_number_above_zero_answers() -> None:
    prompt = procedure_of(STUDY, plan(STUDY, 0)).prompt
    assert prompt is not None
    assert prompt.check_answer(Answer(37_000)).value == 37_000
    for wrong in (0, -3, 2_000_000, None):
        with pytest.raises(InputError):
            prompt.check_answer(Answer(wrong))
    assert Prompt.read(prompt.row()) == prompt


@pytest.mark.parametrize("levels", ["values = [1.0]", "values = [-1.0, 1.0]", "", "values = [0.0, 1.0]"])
def test_levels_without_a_power_law_are_refused(levels: str) -> None:
    with pytest.raises(InputError, match="two different"):
        study_of(f'name = "x"\nprocedure = "magnitude"\n[levels]\nreference = 1.0\n{levels}\n')


@pytest.mark.parametrize(
    ("procedure", "levels"),
    [
        ("magnitude", "reference = 1.0\nvalues = [0.5, 9.0]"),
        ("constant", "reference = 1.0\nvalues = [0.5, 9.0]"),
        ("constant", "reference = 9.0\nvalues = [0.5, 1.0]"),
        ("staircase", "reference = 3.5\nleast = 0.1\nmost = 1.0\nstart = 0.5"),
    ],
)
def test_levels_outside_the_range_are_refused_with_the_range(procedure: str, levels: str) -> None:
    with pytest.raises(InputError, match="between -4 and 4"):
        study_of(f'name = "x"\nprocedure = "{procedure}"\n[levels]\n{levels}\n')
