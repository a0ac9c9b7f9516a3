"""Analysis against closed forms: chance, intervals, known tables, known curves; exports and report."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from haptorb.errors import InputError, RecordingError
from haptorb_study.analysis.analysis import analyse, analysis_of
from haptorb_study.analysis.report import page, write_report
from haptorb_study.columns import tidy
from haptorb_study.database import database
from haptorb_study.prompts import Answer
from haptorb_study.statistics.intervals import mean_interval, wilson
from haptorb_study.statistics.significance import binomial_tail
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import Study, study_of

WAYS = {1: (0.0, 0.0, 0.05), 2: (0.0294, 0.0, 0.0405), 3: (-0.0294, 0.0, 0.0405)}


def sat(study: Study, place: Path, answers: dict[int, int], codes: tuple[str, ...] = ("P01", "P02")) -> None:
    """Participants who answer every set-point as `answers` tells."""
    engine = database(place)
    for code in codes:
        with StoredSession(engine, study, code) as session:
            while (prompt := session.prompt) is not None:
                value = answers[prompt.set_point]
                session.answer(Answer(value, WAYS[value], 1.0))
    engine.dispose()


@given(st.integers(1, 400).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_solves_its_own_equation(kn: tuple[int, int]) -> None:
    # Wilson's ends are where |p̂ − p| = z √(p(1 − p)/n).
    k, n = kn
    for p in wilson(k, n):
        if 0 < p < 1:
            assert abs(k / n - p) == pytest.approx(1.959964 * np.sqrt(p * (1 - p) / n), rel=1e-5, abs=1e-8)


@given(st.integers(0, 60), st.floats(0.01, 0.99))
def test_chance_is_the_binomial_tail(right: int, chance: float) -> None:
    assert binomial_tail(right, 60, chance) == pytest.approx(binom.sf(right - 1, 60, chance), abs=1e-12)


def test_guessing_is_found_to_be_guessing() -> None:
    # Answers drawn at random: accuracy near 1/25, and the test's p seldom small.
    rng = np.random.default_rng(0)
    ps = [binomial_tail(int(rng.binomial(300, 1 / 25)), 300, 1 / 25) for _ in range(400)]
    assert np.mean(np.array(ps) < 0.05) < 0.08


def test_intervals_over_few_people_hold_the_truth() -> None:
    # The percentile bootstrap that stood here once held the mean in 87 % of studies with six people.
    rng = np.random.default_rng(1)
    for sd in (0.0, 0.05, 0.15):
        low, high = mean_interval(6.0 * (1 + sd * rng.standard_normal((6, 4000))) + rng.normal(0, 1, (6, 4000)))
        assert 0.93 <= np.mean((low <= 6) & (high >= 6)) <= 0.97


def test_one_person_has_no_interval_over_people() -> None:
    assert np.isnan(mean_interval([0.5])).all()


def test_everybody_right_is_everybody_right(identify: Study, tmp_path: Path) -> None:
    sat(identify, tmp_path / "s.db", {1: 1, 2: 2, 3: 3})
    found = analysis_of(tmp_path / "s.db")
    assert found.confusion is not None
    assert found.confusion.matrix.tolist() == np.eye(3).tolist()
    assert found.arrows == ()
    assert found.trials == 12
    assert found.practice == 2
    assert found.confusion.p_chance == pytest.approx(3.0**-12)
    assert not found.simulated
    assert "2 participants" in found.origin


def test_wrong_answers_become_an_arrow(identify: Study, tmp_path: Path) -> None:
    sat(identify, tmp_path / "s.db", {1: 1, 2: 1, 3: 3})
    found = analysis_of(tmp_path / "s.db")
    assert [(a.of, a.to, a.wrong, a.share) for a in found.arrows] == [(2, 1, 4, 1.0)]
    assert found.confusion is not None
    assert found.confusion.matrix[1].tolist() == [1.0, 0.0, 0.0]
    assert found.confusion.accuracy == pytest.approx(2 / 3)


def test_participants_count_alike_however_much_they_answered(identify: Study, tmp_path: Path) -> None:
    sat(identify, tmp_path / "s.db", {1: 1, 2: 2, 3: 3}, ("P01",))
    engine = database(tmp_path / "s.db")
    with StoredSession(engine, identify, "P02") as session:  # stops after practice and one wrong answer
        for _ in range(2):
            prompt = session.prompt
            assert prompt is not None
            session.answer(Answer(1 + prompt.set_point % 3, WAYS[1]))
    found = analysis_of(tmp_path / "s.db")
    assert found.confusion is not None
    assert found.confusion.accuracy == pytest.approx(0.5)


def test_the_report_needs_nothing_else(identify: Study, tmp_path: Path) -> None:
    sat(identify, tmp_path / "s.db", {1: 1, 2: 1, 3: 3})
    found = analysis_of(tmp_path / "s.db")
    assert repr(found).startswith(f"<Analysis of study {found.study.name!r}: {found.trials} trials; ")
    assert "2 practice trials excluded" in found._repr_html_()
    text = page(found)
    assert "src='http" not in text
    assert "href" not in text
    assert "<script" not in text
    assert "data:image/png" in text
    path = write_report(found, tmp_path / "out")
    assert {p.name for p in path.parent.iterdir()} == {
        "report.html", "numbers.json", "confusion.svg", "answers.svg", "error.svg",
    }  # fmt: skip
    assert json.loads((path.parent / "numbers.json").read_text())["accuracy"]["mean"] == pytest.approx(2 / 3)


def test_a_database_without_answers_is_told(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    with pytest.raises(InputError, match="holds no study"):
        analysis_of(tmp_path / "s.db")
    with StoredSession(engine, identify, "P01") as session:
        pass
    with pytest.raises(RecordingError, match="no answered trials"):
        analysis_of(tmp_path / "s.db")
    with StoredSession(engine, identify, "P01") as session:
        session.answer(Answer(1, WAYS[1]))
    with pytest.raises(InputError, match="only practice trials"):
        analysis_of(tmp_path / "s.db")
    with pytest.raises(InputError, match="no study 'other'"):
        analysis_of(tmp_path / "s.db", "other")


def test_conditions_are_compared_person_by_person(tmp_path: Path) -> None:
    study = study_of(
        'name = "two"\n[set_points]\npoints = [{number = 1, theta_deg = 0}, {number = 2, theta_deg = 36}]\n'
        '[[conditions]]\nname = "a"\n[[conditions]]\nname = "b"\nparameters = {moment = 1.0}\n'
    )
    engine = database(tmp_path / "s.db")
    for code in ("P01", "P02", "P03"):
        with StoredSession(engine, study, code) as session:
            while (prompt := session.prompt) is not None:
                right = prompt.condition == "a"
                session.answer(Answer(prompt.set_point if right else 3 - prompt.set_point, WAYS[1]))
    found = analyse(study, tidy(engine, study))
    accuracy = next(one for one in found.comparisons if one.what == "accuracy")
    assert (accuracy.what, accuracy.difference, accuracy.people) == ("accuracy", 1.0, 3)
    assert accuracy.p == pytest.approx(0.25)
    means = {(one.measure, one.condition): one for one in found.means}
    assert (means["accuracy", "a"].mean, means["accuracy", "b"].mean) == (1.0, 0.0)
    assert means["accuracy", "a"].low == pytest.approx(1 - means["accuracy", "b"].high, abs=1e-6)
    error = next(one for one in found.comparisons if one.what == "error")
    assert means["error", "a"].mean - means["error", "b"].mean == pytest.approx(error.difference)


def test_ratings_that_all_agree_have_no_interval(tmp_path: Path) -> None:
    study = study_of('name = "r"\nprocedure = "rating"\n[trials]\nrepetitions = 2\n')
    engine = database(tmp_path / "s.db")
    for code in ("P01", "P02", "P03"):
        with StoredSession(engine, study, code) as session:
            while session.prompt is not None:
                session.answer(Answer(4, WAYS[1]))
    found = analysis_of(tmp_path / "s.db").scores["base"]
    assert (found.mean, found.ratings) == (4.0, 6)
    assert np.isnan([found.low, found.high]).all()


def test_choices_are_counted_over_people(tmp_path: Path) -> None:
    study = study_of(
        'name = "f"\nprocedure = "forced-choice"\n[trials]\nrepetitions = 8\n'
        '[[conditions]]\nname = "a"\n[[conditions]]\nname = "b"\nparameters = {moment = 1.0}\n'
    )
    engine = database(tmp_path / "s.db")
    for n, code in enumerate(("P01", "P02", "P03", "P04")):
        with StoredSession(engine, study, code) as session:
            while (prompt := session.prompt) is not None:
                session.answer(Answer(prompt.interval if n % 2 else 3 - prompt.interval))
    k, of, (low, high) = analysis_of(tmp_path / "s.db").chosen[("a", "b")]
    assert (k, of) == (16, 32)
    pooled = wilson(k, of)
    assert low < pooled[0] - 0.1  # two people always choose a, two never: 32 choices are worth few
    assert high > pooled[1] + 0.1
