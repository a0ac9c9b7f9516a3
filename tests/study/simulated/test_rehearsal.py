"""Simulated participants: labelled, reproducible, driven by the device's force, and calibrated as documented."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from haptorb.errors import InputError
from haptorb_study.analysis.analysis import analysis_of
from haptorb_study.analysis.error_by_latitude import LatitudeError, measure_tool_rings
from haptorb_study.analysis.report import page
from haptorb_study.columns import tidy
from haptorb_study.database import database
from haptorb_study.prompts import Answer, Prompt
from haptorb_study.set_points import PUBLISHED_ERRORS
from haptorb_study.simulated.participant import Participant
from haptorb_study.simulated.rehearsal import answer_rest, rehearse
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import Study, study_of

#: as in the paper, whose controller inverts point dipoles; with the set-points that participants were calibrated with
PUBLISHED = 'name = "published"\nmodel = "published"\n[set_points]\nlayout = "1-8-8-8"'


def test_what_is_simulated_says_so_everywhere(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    rehearse(engine, identify, 2)
    assert tidy(engine, identify)["simulated"].all()
    found = analysis_of(tmp_path / "s.db")
    assert found.origin.startswith("SIMULATED")
    assert found.origin in page(found)
    assert found.numbers()["simulated"] == 2


def test_an_interrupted_rehearsal_goes_on_as_if_it_had_not_been(identify: Study, tmp_path: Path) -> None:
    whole, parts = database(tmp_path / "whole.db"), database(tmp_path / "parts.db")
    rehearse(whole, identify, 1, seed=3)
    person = Participant(identify, (3, 1))
    with StoredSession(parts, identify, "SIM01", simulated=True) as session:
        for _ in range(3):
            assert session.prompt is not None
            session.answer(person.answer(session.prompt, session.number))
    with StoredSession(parts, identify, "SIM01", simulated=True) as session:
        assert session.resumed
        assert answer_rest(session, Participant(identify, (3, 1))) == 4
    one, two = tidy(whole, identify), tidy(parts, identify)
    for name in ("answer", "x_m", "y_m", "z_m", "seconds"):
        assert one[name].tolist() == two[name].tolist()


def test_without_a_force_nothing_is_found() -> None:
    # The feeling is the device's: with a moment too weak to be felt the places are guessed.
    errors = {}
    for moment in (0.02, 2.4):
        study = study_of(f'name = "weak"\n[parameters]\nmoment = {moment}')
        person = Participant(study, (0, 1))
        numbers = tuple(p.number for p in study.points)
        places = [person.answer(Prompt("main", "base", set_point=n, numbers=numbers), n).position for n in numbers]
        ways = np.array([p.direction for p in study.points])
        errors[moment] = np.mean(np.linalg.norm(np.array(places) - 0.05 * ways, axis=1))
    assert errors[0.02] > 3 * errors[2.4]


def test_a_staircase_finds_the_jnd_that_the_participant_brings(stairs: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    rehearse(engine, stairs, 12)
    found = list(analysis_of(tmp_path / "s.db").thresholds["base"].values())
    # 70.7 % of Φ(x/(√2 σ)), with σ such that 75 % are a JND of 8.5 % of 1.2 A·m²: 0.545/0.6745 of 0.102.
    assert np.exp(np.mean(np.log(found))) == pytest.approx(0.0824, rel=0.3)


@pytest.mark.parametrize(("people", "seed", "first"), [(0, 0, 1), (2, -1, 1), (2, 0, 0)])
def test_rehearsals_that_cannot_be_are_refused(
    identify: Study, tmp_path: Path, people: int, seed: int, first: int
) -> None:
    with pytest.raises(InputError, match="people must be"):
        rehearse(database(tmp_path / "s.db"), identify, people, seed=seed, first=first)


def rings(tmp_path: Path, people: int, seed: int) -> tuple[LatitudeError, ...]:
    study = study_of(PUBLISHED)
    place = tmp_path / f"{people}-{seed}.db"
    engine = database(place)
    rehearse(engine, study, people, seed=seed)
    return measure_tool_rings(tidy(engine, study))


def test_six_simulated_participants_give_the_published_course(tmp_path: Path) -> None:
    """Within one standard error of the paper's means, taken over its 12, 96, 96 and 96 trials: calibrated so."""
    for ring in rings(tmp_path, 6, 0):
        mean, sd = PUBLISHED_ERRORS[ring.theta_deg]
        assert ring.trials == (12 if ring.theta_deg == 0 else 96)
        assert abs(ring.mean - mean) <= sd / np.sqrt(ring.trials)


@pytest.mark.slow
def test_so_do_many_on_average_so_that_no_lucky_seed_is_behind_it(tmp_path: Path) -> None:
    for ring in rings(tmp_path, 60, 1):
        mean, sd = PUBLISHED_ERRORS[ring.theta_deg]
        assert abs(ring.mean - mean) <= sd / np.sqrt(12 if ring.theta_deg == 0 else 96)


@pytest.mark.parametrize("procedure", ["rating", "forced-choice", "localisation", "constant", "bayesian"])
def test_every_procedure_can_be_rehearsed_and_analysed(procedure: str, tmp_path: Path) -> None:
    levelled = {
        "constant": "[levels]\nreference = 1.2\nvalues = [1.0, 1.1, 1.3, 1.4]",
        "bayesian": "[levels]\nreference = 1.2\nleast = 0.01\nmost = 1.0\ntrials = 8",
    }.get(procedure, "")
    points = "[set_points]\npoints = [{number = 1, theta_deg = 0}, {number = 2, theta_deg = 36}]"
    conditions = '[[conditions]]\nname = "a"\n[[conditions]]\nname = "b"\nparameters = {half_width_deg = 30}'
    study = study_of(f'name = "x"\nprocedure = "{procedure}"\n{points}\n{levelled}\n{conditions}')
    rehearse(database(tmp_path / "s.db"), study, 2)
    found = analysis_of(tmp_path / "s.db")
    assert found.participants == 2
    assert "SIMULATED" in page(found)
    if procedure == "localisation":
        with pytest.raises(InputError, match="not a number"):
            Prompt().check_answer(Answer(3, (0.0, 0.0, 0.05)))
