"""Curves and thresholds of whole studies: participants and population, with undetermined values."""

from __future__ import annotations

import json
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtr

from haptorb.terminal import make_console
from haptorb_study.analysis.analysis import Analysis, analysis_of
from haptorb_study.analysis.figures import figures
from haptorb_study.analysis.report import page
from haptorb_study.analysis.tables import print_summary
from haptorb_study.bayesian import Bayesian
from haptorb_study.columns import tidy
from haptorb_study.database import database
from haptorb_study.prompts import Answer
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import Study, study_of

CONSTANT = """
name = "curves"
procedure = "constant"
[trials]
repetitions = 6
[levels]
reference = 1.2
values = [0.8, 1.0, 1.2, 1.4, 1.6]
[[conditions]]
name = "a"
[[conditions]]
name = "b"
"""
TRACK = "[levels]\nreference = 1.2\nleast = 0.01\nmost = 1.0\nstart = 0.8\ntrials = 24\nreversals = 100\n"


def sat(study: Study, place: Path, codes: tuple[str, ...], skip: str = "", most: int = 10_000) -> Analysis:
    """People who notice a difference of 0.15 in most trials; they answer nothing in the condition `skip`."""
    engine = database(place)
    for n, code in enumerate(codes):
        draw = np.random.default_rng([3, n])
        with StoredSession(engine, study, code) as session:
            while (prompt := session.prompt) is not None and session.number < most:
                if prompt.condition == skip:
                    break
                stronger = draw.random() < ndtr((prompt.level - 1.2 + 0.05 * n) / 0.15)
                session.answer(Answer(prompt.interval if stronger else 3 - prompt.interval), driver="serial:x")
    engine.dispose()
    return analysis_of(place)


def text_of(analysis: Analysis) -> str:
    told = StringIO()
    console = make_console()
    console.file, console.width = told, 100
    print_summary(analysis, console)
    return " ".join(told.getvalue().split())


def test_each_person_and_the_group_have_a_curve(tmp_path: Path) -> None:
    found = sat(
        study_of(CONSTANT.replace('[[conditions]]\nname = "b"\n', "")), tmp_path / "s.db", ("P01", "P02", "P03")
    )
    curves = found.curves["a"]
    middles = [fit.curve.middle for fit in curves.people.values()]
    assert list(curves.people) == ["P01", "P02", "P03"]
    assert middles == pytest.approx([1.2, 1.15, 1.1], abs=0.12)
    assert curves.group is not None
    low, high = curves.group.threshold.mean_95
    assert low < np.mean(middles) < high
    numbers = json.loads(json.dumps(found.numbers(), allow_nan=False))["curves"]["a"]
    assert sum(numbers["of"]) == 90
    assert set(numbers["people"]["P02"]) >= {"middle_95", "spread_95", "guess_95", "lapse_95", "deviance", "p_fit"}
    assert numbers["group"]["middle"]["mean_95"] == [low, high]
    lines = [line for line in figures(found)["curves"].axes[0].get_lines() if len(line.get_xdata()) > 100]
    faint, bold = ([line for line in lines if (line.get_linewidth() > 2) == wide] for wide in (False, True))
    assert (len(faint), len(bold)) == (3, 1)  # three people; the group
    told = text_of(found)
    for words in ("of the group", "each participant", "P03", "SD between people"):
        assert words in told
        assert words in page(found, {"curves": b""})


def test_a_condition_without_answers_is_named(tmp_path: Path) -> None:
    study = study_of(CONSTANT.replace("repetitions = 6", 'repetitions = 6\norder = "blocked"'))
    found = sat(study, tmp_path / "s.db", ("P01", "P02"), skip="b")
    assert list(found.curves) == ["a"]
    assert found.notes == ("condition 'b': no answers yet",)
    assert "condition 'b': no answers yet" in text_of(found)
    assert "no answers yet" in page(found, {"curves": b""})
    assert found.numbers()["notes"] == ["condition 'b': no answers yet"]


def test_answers_at_one_level_are_told_and_not_fitted(tmp_path: Path) -> None:
    study = study_of(CONSTANT.replace('[[conditions]]\nname = "b"\n', ""))
    found = sat(study, tmp_path / "s.db", ("P01",), most=1)
    assert found.curves == {}
    assert "at one level only" in found.notes[0]
    found = sat(study, tmp_path / "s.db", ("P01",), most=4)
    assert any("too few trials" in note for note in found.curves["a"].people["P01"].notes)
    assert found.curves["a"].group is None
    found = sat(study, tmp_path / "few.db", ("P01", "P02", "P03"), most=1)  # not all at the same level
    assert found.curves["a"].group is None
    assert found.curves["a"].numbers()["people"]["P01"]["middle"] is None
    assert "nan" not in text_of(found)


@pytest.mark.parametrize("procedure", ["staircase", "bayesian"])
def test_an_adaptive_track_has_an_interval_and_the_group_a_mean(procedure: str, tmp_path: Path) -> None:
    study = study_of(f'name = "x"\nprocedure = "{procedure}"\n{TRACK}')
    found = sat(study, tmp_path / "s.db", ("P01", "P02", "P03"))
    tracks = found.tracks["base"]
    for fit in tracks.people.values():
        assert fit.complete
        assert fit.fitted_95[0] < fit.fitted < fit.fitted_95[1]
        assert fit.closed or any("limit" in note for note in fit.notes)
    assert tracks.group is not None
    low, high = (2**end for end in tracks.group.mean_95)
    assert low < 2**tracks.group.mean < high
    told = text_of(found)
    assert "group" in told
    closed = np.isfinite(tracks.group.mean_95).all()
    assert f"{2**tracks.group.mean:.4g}" in told if closed else "≥" in told or "≤" in told or "no limit" in told
    if procedure == "bayesian":  # its own posterior: the mean is its own, the interval lies within a step of its own
        first = next(iter(tracks.people.values()))
        assert first.fitted == pytest.approx(first.threshold)


def test_a_track_that_was_left_is_bounded_and_called_unfinished(tmp_path: Path) -> None:
    study = study_of(f'name = "x"\nprocedure = "bayesian"\n{TRACK}')
    found = sat(study, tmp_path / "s.db", ("P01", "P02"), most=5)
    assert found.thresholds == {"base": {}}
    fit = found.tracks["base"].people["P01"]
    assert not fit.complete
    assert "not finished: 5 trials" in fit.notes
    own = Bayesian(1.2, 0.01, 1.0, (1,) * 24)
    assert own.thresholds[0] <= fit.fitted_95[0] < fit.fitted_95[1] <= own.thresholds[-1] * 1.07


def test_the_interval_of_quest_is_that_of_the_librarys_posterior(tmp_path: Path) -> None:
    oracle = pytest.importorskip("questplus", reason="questplus is not installed")
    study = study_of(f'name = "x"\nprocedure = "bayesian"\n{TRACK}')
    fit = sat(study, tmp_path / "s.db", ("P01",)).tracks["base"].people["P01"]
    own = Bayesian(1.2, 0.01, 1.0, (1,) * 24)
    library = oracle.QuestPlus(
        stim_domain={"intensity": np.log10(own.differences)},
        param_domain={
            "mean": np.log10(own.thresholds), "sd": np.log10(2) / np.geomspace(0.5, 6.0, 12),
            "lower_asymptote": [0.5], "lapse_rate": [0.02],
        },
        outcome_domain={"response": ["right", "wrong"]}, func="norm_cdf", stim_scale="linear",
    )  # fmt: skip
    columns = tidy(database(tmp_path / "s.db", make=False), study)
    for level, interval, answer in zip(columns["level"], columns["interval"], columns["answer"], strict=True):
        asked = np.log10(own.differences)[np.abs(own.differences - (level - 1.2)).argmin()]
        library.update(stim={"intensity": asked}, outcome={"response": "right" if answer == interval else "wrong"})
    mass, axis = np.asarray(library.marginal_posterior["mean"]), np.log10(own.thresholds)
    step = axis[1] - axis[0]
    edges = np.append(axis - step / 2, axis[-1] + step / 2)
    below = np.interp(np.log10(fit.fitted_95), edges, np.append(0, np.cumsum(mass)))
    assert below == pytest.approx([0.025, 0.975], abs=1e-6)
    assert fit.fitted == pytest.approx(10 ** (mass @ axis), rel=1e-9)
