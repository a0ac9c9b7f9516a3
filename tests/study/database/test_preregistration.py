"""A plan is validated, stored with the first session, compared afterwards, and reported first."""

from __future__ import annotations

import json
import re
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from sqlalchemy import text

from haptorb.cli.program import main
from haptorb.errors import InputError
from haptorb_study.analysis.analysis import Analysis, analysis_of
from haptorb_study.analysis.report import page
from haptorb_study.analysis.tables import print_summary
from haptorb_study.database import database
from haptorb_study.preregistration import read_registration, write_registration
from haptorb_study.prompts import Answer
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import Study, study_of

BARE = """
name = "planned"
procedure = "rating"
[trials]
repetitions = 1
[[conditions]]
name = "a"
[[conditions]]
name = "b"
[[conditions]]
name = "c"
"""
PLAN = """
[plan]
participants = 4
[[plan.tests]]
measure = "rating"
between = ["b", "a"]
smallest_effect = 2.5
"""
RATINGS = {"P01": (2, 6, 4), "P02": (3, 6, 3), "P03": (2, 7, 2), "P04": (4, 7, 5)}  #: of a, b and c
NO_IMAGES = dict.fromkeys(("confusion", "answers", "error", "curves"), b"")


def sat(study: Study, place: Path, codes: tuple[str, ...] = tuple(RATINGS), only: str = "abc") -> None:
    engine = database(place)
    for code in codes:
        with StoredSession(engine, study, code) as session:
            while (prompt := session.prompt) is not None and prompt.condition in only:
                session.answer(Answer(RATINGS[code]["abc".index(prompt.condition)], None, 1.0))
    engine.dispose()


def show_text(found: Analysis) -> str:
    out = StringIO()
    print_summary(found, Console(file=out, width=80))
    assert max(map(len, out.getvalue().splitlines())) <= 80
    return " ".join(out.getvalue().split())


def test_the_plan_is_no_part_of_the_study_but_has_a_digest_of_its_own() -> None:
    bare, planned = study_of(BARE), study_of(BARE + PLAN)
    assert bare.digest == planned.digest
    assert planned.plan is not None
    altered = study_of(BARE + PLAN.replace("2.5", "1.5")).plan
    assert altered is not None
    assert altered.digest != planned.plan.digest
    assert study_of(BARE + PLAN + "# a remark\n").plan == planned.plan


def test_planned_tests_come_first_and_the_rest_is_exploratory(tmp_path: Path) -> None:
    sat(study_of(BARE + PLAN), tmp_path / "s.db")
    found = analysis_of(tmp_path / "s.db")
    pairs = [(x.a, x.b, x.planned) for x in found.comparisons]
    assert pairs == [("b", "a", True), ("a", "c", False), ("b", "c", False)]
    first, *rest = found.comparisons
    assert first.difference == pytest.approx(np.mean([4, 3, 5, 3]))
    assert first.p_corrected == first.p  # alone among the planned ones
    assert min(one.p_corrected / one.p for one in rest) >= 1.0
    assert max(one.p_corrected for one in rest) >= 2 * min(one.p for one in rest)
    assert found.plan is not None
    (outcome,) = found.plan.outcomes
    assert outcome.significant
    assert outcome.verdict == "in the interval"  # 2.2 to 5.3 holds 2.5
    text_ = show_text(found)
    assert "4 of 4 planned participants finished: reached" in text_
    assert text_.index("Planned tests") < text_.index("Not planned: exploratory")
    assert found.plan.digest in page(found, NO_IMAGES)
    numbers = json.loads(json.dumps(found.numbers(), allow_nan=False))["plan"]
    assert (numbers["reached"], numbers["tests"][0]["significant"], numbers["remarks"]) == (True, True, [])


@pytest.mark.parametrize(
    ("least", "verdict"),
    [("0.5", "exceeded"), ("9.0", "excluded"), ("", "not stated")],
)
def test_the_smallest_effect_is_set_against_the_interval(least: str, verdict: str, tmp_path: Path) -> None:
    plan = PLAN.replace("smallest_effect = 2.5", f"smallest_effect = {least}" if least else "")
    sat(study_of(BARE + plan), tmp_path / "s.db", ("P01", "P02", "P03"))
    found = analysis_of(tmp_path / "s.db")
    assert found.plan is not None
    assert found.plan.outcomes[0].verdict == verdict
    assert "3 of 4 planned participants finished: NOT REACHED" in show_text(found)


def test_a_condition_that_nobody_met_is_told_not_guessed(tmp_path: Path) -> None:
    blocked = study_of(BARE.replace("repetitions = 1", 'repetitions = 1\norder = "blocked"') + PLAN)
    sat(blocked, tmp_path / "s.db", only="a")
    found = analysis_of(tmp_path / "s.db")
    assert found.comparisons == ()
    assert found.plan is not None
    assert (found.plan.outcomes[0].found, found.plan.outcomes[0].verdict) == (None, "no data")
    assert "no data" in show_text(found)


def test_a_plan_that_changes_after_data_exist_is_told(tmp_path: Path) -> None:
    sat(study_of(BARE + PLAN), tmp_path / "s.db", ("P01", "P02", "P03"))
    sat(study_of(BARE + PLAN.replace("2.5", "1.0")), tmp_path / "s.db", ("P04",))
    found = analysis_of(tmp_path / "s.db")
    assert found.plan is not None
    assert found.plan.outcomes[0].test.smallest_effect == 2.5  # the first plan stays in force
    (remark,) = found.plan.remarks
    assert "CHANGED after data existed: 1 session" in remark
    assert "CHANGED after data existed" in show_text(found)
    assert "CHANGED after data existed" in page(found, NO_IMAGES)


def test_a_plan_that_came_after_the_data_is_none(tmp_path: Path) -> None:
    sat(study_of(BARE), tmp_path / "s.db", ("P01", "P02"))
    assert analysis_of(tmp_path / "s.db").plan is None
    sat(study_of(BARE + PLAN), tmp_path / "s.db", ("P03", "P04"))
    found = analysis_of(tmp_path / "s.db")
    assert found.plan is not None
    assert not any(one.planned for one in found.comparisons)
    assert "no plan was stored before data existed" in show_text(found)
    assert json.dumps(found.numbers(), allow_nan=False)


def test_a_plan_that_was_changed_in_the_database_is_told(tmp_path: Path) -> None:
    sat(study_of(BARE + PLAN), tmp_path / "s.db")
    engine = database(tmp_path / "s.db")
    with engine.begin() as connection:
        connection.execute(text("UPDATE studies SET text = replace(text, 'smallest_effect = 2.5', '')"))
    engine.dispose()
    found = analysis_of(tmp_path / "s.db")
    assert found.plan is not None
    assert "the plan in the database was CHANGED" in found.plan.remarks[0]
    assert found.plan.outcomes == ()
    assert not any(one.planned for one in found.comparisons)


def test_a_registration_is_one_file_that_shows_later_changes(tmp_path: Path) -> None:
    study = study_of(BARE + PLAN)
    made = write_registration(study, tmp_path / "registered.toml")
    assert read_registration(tmp_path / "registered.toml") == made
    sat(study, tmp_path / "s.db")
    found = analysis_of(tmp_path / "s.db", registration=made)
    assert found.plan is not None
    assert found.plan.remarks == ()
    assert "registered 20" in found.plan.sentence
    other = write_registration(study_of(BARE + PLAN.replace("2.5", "9")), tmp_path / "late.toml")
    late = analysis_of(tmp_path / "s.db", registration=other).plan
    assert late is not None
    assert "ANOTHER PLAN was registered" in late.remarks[0]
    assert not late.registered
    with pytest.raises(InputError, match="never replaced"):
        write_registration(study, tmp_path / "registered.toml")
    with pytest.raises(InputError, match="no plan to register"):
        write_registration(study_of(BARE), tmp_path / "none.toml")
    changed = (tmp_path / "registered.toml").read_text().replace("smallest_effect = 2.5", "smallest_effect = 2.0")
    (tmp_path / "registered.toml").write_text(changed)
    with pytest.raises(InputError, match="was CHANGED"):
        read_registration(tmp_path / "registered.toml")
    (tmp_path / "x.toml").write_text("a = 1")
    with pytest.raises(InputError, match="is not a registration"):
        read_registration(tmp_path / "x.toml")


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        (PLAN.replace('"rating"', '"error"'), "no measure 'error'; known: rating"),
        (PLAN.replace('["b", "a"]', '["b", "z"]'), "no condition 'z'; known: a, b, c"),
        (PLAN.replace('["b", "a"]', '["b", "b"]'), "compared with itself"),
        (PLAN.replace('between = ["b", "a"]', ""), "needs between"),
        (PLAN.replace("participants = 4", "participants = 1"), "participants"),
        (PLAN.replace("participants = 4", "participants = 4\nalpha = 0.7"), "alpha"),
        (PLAN.replace("participants = 4", 'participants = 4\ntest = "u"'), "test"),
        (PLAN.replace("2.5", "-1"), "smallest_effect"),
        (PLAN + '[[plan.tests]]\nmeasure = "rating"\nbetween = ["a", "b"]\n', "must differ"),
        ("[plan]\nparticipants = 4\ntests = []\n", "tests"),
    ],
)
def test_a_plan_that_the_study_cannot_keep_is_refused(plan: str, words: str) -> None:
    with pytest.raises(InputError, match=re.escape(words)):
        study_of(BARE + plan)


def test_check_prints_and_registers_the_plan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "study.toml").write_text(BARE + PLAN)
    target = str(tmp_path / "r.toml")
    with pytest.raises(SystemExit):
        main(["study", "check", str(tmp_path / "study.toml"), "--register", target])
    out = " ".join("".join(capsys.readouterr()).split())
    assert "4 participants, 1 test (t), α = 0.05, correction holm" in out
    assert "registered: plan" in out
    sat(study_of(BARE + PLAN), tmp_path / "s.db")
    with pytest.raises(SystemExit):
        main(["study", "analyse", str(tmp_path / "s.db"), "--registration", target, "--json"])
    assert json.loads(capsys.readouterr().out)["plan"]["registered"].startswith("registered 20")
