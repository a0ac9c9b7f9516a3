"""Magnitude estimation: planted power laws are found, independent of each participant's scale."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from haptorb.errors import InputError
from haptorb_study.analysis.comparison import compare_conditions
from haptorb_study.analysis.magnitude import estimate_magnitudes
from haptorb_study.columns import tidy
from haptorb_study.database import database
from haptorb_study.export_table import write_csv
from haptorb_study.order import plan, procedure_of
from haptorb_study.prompts import Answer, Prompt
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import Study, study_of

TWO = '[[conditions]]\nname = "base"\n[[conditions]]\nname = "other"\n'
LEVELS = "[levels]\nreference = 1.0\nvalues = [0.25, 0.5, 1.0, 2.0]\n"
STUDY = study_of(f'name = "x"\nprocedure = "magnitude"\n{LEVELS}[trials]\nrepetitions = 3\n')
PAIR = study_of(f'name = "x"\nprocedure = "magnitude"\n{LEVELS}[trials]\nrepetitions = 3\n{TWO}')


def answer(
    exponents: list[float], scales: list[float], spread: float, study: Study = STUDY, factor: float = 1.0
) -> dict[str, np.ndarray]:
    """Columns of a study; in condition "other" everything is `factor` times as strong."""
    draw = np.random.default_rng(2)
    rows = []
    for person, (exponent, scale) in enumerate(zip(exponents, scales, strict=True)):
        procedure = procedure_of(study, plan(study, person))
        for prompt in procedure.parts[0].prompts:
            value = scale * prompt.level**exponent * np.exp(spread * draw.standard_normal())
            value *= factor if prompt.condition == "other" else 1.0
            rows.append((f"P{person}", prompt.condition, prompt.level, float(f"{value:.3g}")))
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


def test_any_number_above_zero_answers() -> None:
    prompt = procedure_of(STUDY, plan(STUDY, 0)).prompt
    assert prompt is not None
    for right in (37_000, 0.25, 1_000_000):
        assert prompt.check_answer(Answer(right)).value == right
    for wrong in (0, -3, 2_000_000, None, True, float("nan"), float("inf"), "7", [7]):
        with pytest.raises(InputError):
            prompt.check_answer(Answer(wrong))  # type: ignore[arg-type]
    assert Prompt.read(prompt.row()) == prompt
    older = {key: value for key, value in prompt.row().items() if key != "decimal"} | {"low": 1}
    with pytest.raises(InputError, match="whole number"):  # a session of an older haptorb goes on as it began
        Prompt.read(older).check_answer(Answer(2.5))


def test_conditions_are_compared_on_one_scale() -> None:
    main = answer([0.7, 0.8, 0.9, 0.8], [0.5, 3.0, 40.0, 900.0], 0.01, PAIR, 2.0)
    base, other = estimate_magnitudes(PAIR, main)
    assert (base.at_reference, other.at_reference) == pytest.approx((1.0, 2.0), rel=0.02)
    assert np.isnan(base.at_reference_95).all()
    assert other.at_reference_95[0] < 2.0 < other.at_reference_95[1]
    assert other.means == pytest.approx(2 * base.means, rel=0.03)
    rows = {row.what: row for row in compare_conditions(PAIR, main, ["P0", "P1", "P2", "P3"])}
    assert rows["magnitude"].difference == pytest.approx(-np.log10(2.0), abs=0.01)
    assert rows["magnitude"].p < 1e-4
    assert rows["exponent"].low < 0 < rows["exponent"].high


def test_whoever_has_no_scale_has_an_exponent_only() -> None:
    main = answer([0.8] * 3, [10.0, 20.0, 30.0], 0.0, PAIR)
    here = ~((main["participant"] == "P1") & (main["condition"] == "base"))
    base, other = estimate_magnitudes(PAIR, {name: values[here] for name, values in main.items()})
    assert (base.people, other.people) == (2, 3)
    assert other.means[2] == pytest.approx(1.0, abs=0.01)
    only = {name: values[main["condition"] == "other"] for name, values in main.items()}
    (alone,) = estimate_magnitudes(PAIR, only)  # a condition without data: the next one has the scale
    assert (alone.condition, alone.at_reference) == ("other", pytest.approx(1.0))


def test_decimal_answers_are_stored_and_exported_as_they_were_given(tmp_path: Path) -> None:
    engine = database(tmp_path / "study.db")
    given = [2.5, 40, 0.125]
    for _ in given:  # resumed after each answer: what is stored is read again
        with StoredSession(engine, STUDY, "P1", simulated=False) as sitting:
            sitting.answer(Answer(given[sitting.number]))
    columns = tidy(engine, STUDY)
    assert columns["answer"].tolist() == given
    write_csv(STUDY, columns, tmp_path / "trials.csv")
    with (tmp_path / "trials.csv").open(encoding="utf-8") as file:
        assert [row["answer"] for row in csv.DictReader(file)] == ["2.5", "40", "0.125"]


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
