"""Order of a session: counterbalanced, balanced in every procedure, determined by the seed, stored complete."""

from __future__ import annotations

import json
from collections import Counter
from hashlib import sha256
from itertools import groupby, pairwise
from pathlib import Path

import pytest

from haptorb.cli import main
from haptorb.errors import InputError
from haptorb_study.columns import find_begun_version, tidy
from haptorb_study.database import database
from haptorb_study.order import (
    balance_conditions,
    balance_intervals,
    draw_turns,
    plan,
    procedure_of,
    square_size,
    summarize_order,
)
from haptorb_study.procedures import InterleavedProcedures, Procedure
from haptorb_study.prompts import Answer, Prompt
from haptorb_study.simulated.forecast import forecast
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import Study, list_older, study_of

CONDITIONS = "".join(f'[[conditions]]\nname = "{name}"\n' for name in ("one", "two", "three"))
LEVELS = "[levels]\nreference = 1.2\n"
ADAPTIVE = LEVELS + "least = 0.01\nmost = 1.0\nstart = 0.8\ntrials = 12\n"
PROCEDURES = {
    "identification": "", "localisation": "", "rating": "", "forced-choice": "",
    "constant": LEVELS + "values = [0.8, 1.0, 1.4]\n", "magnitude": LEVELS + "values = [0.8, 1.0, 1.4]\n",
    "staircase": ADAPTIVE, "bayesian": ADAPTIVE,
}  # fmt: skip
ONE_POINT = "[set_points]\npoints = [{ number = 1, theta_deg = 0 }, { number = 2, theta_deg = 36 }]\n"


def study_with(procedure: str, trials: str = "", conditions: str = CONDITIONS) -> Study:
    parts = f"{ONE_POINT}{PROCEDURES[procedure]}[trials]\n{trials}\n{conditions}"
    return study_of(f'name = "x"\nprocedure = "{procedure}"\n{parts}')


def collect_prompts(study: Study, participant: int, right: bool = True) -> list[Prompt]:
    """All that is asked of a person who is always right, or never."""
    procedure: Procedure = procedure_of(study, plan(study, participant))
    found = []
    while (prompt := procedure.prompt) is not None:
        found.append(prompt)
        value = (prompt.interval if right else 3 - prompt.interval) if prompt.interval else prompt.set_point
        procedure = procedure.advance(Answer(value, (0.0, 0.0, 0.05)))
    return found


def list_main(prompts: list[Prompt]) -> list[Prompt]:
    return [prompt for prompt in prompts if prompt.phase == "main"]


@pytest.mark.parametrize("procedure", PROCEDURES)
def test_by_default_conditions_are_counter_balanced_in_every_procedure(procedure: str) -> None:
    study = study_with(procedure)
    units = summarize_order(study).units
    assert len(units) == 3
    orders = []
    for person in range(6):
        main = list_main(collect_prompts(study, person))
        names = [f"{p.condition}, {p.other}" if p.other else p.condition for p in main]
        orders.append(list(dict.fromkeys(names)))
    for place in range(3):
        assert Counter(order[place] for order in orders) == dict.fromkeys(units, 2)
    follows = Counter(pair for order in orders for pair in pairwise(order))
    assert set(follows.values()) == {2}
    assert len(follows) == 6


@pytest.mark.parametrize("procedure", PROCEDURES)
@pytest.mark.parametrize("order", ["counter-balanced", "random", "blocked"])
def test_the_plan_is_the_seeds_and_every_persons_own(procedure: str, order: str) -> None:
    study, other = (study_with(procedure, f'order = "{order}"\nseed = {seed}') for seed in (1, 2))
    assert plan(study, 0) == plan(study, 0)
    assert json.loads(json.dumps(plan(study, 0))) == plan(study, 0)
    if procedure != "rating" or order == "random":  # a rating has nothing but its conditions to be ordered
        assert collect_prompts(study, 0) != collect_prompts(study, 1)
        assert collect_prompts(study, 0) != collect_prompts(other, 0)


@pytest.mark.parametrize("procedure", ["identification", "localisation", "rating", "constant"])
def test_a_counter_balanced_condition_is_one_block(procedure: str) -> None:
    names = [p.condition for p in list_main(collect_prompts(study_with(procedure), 4))]
    assert len(list(groupby(names))) == 3


@pytest.mark.parametrize("procedure", ["staircase", "bayesian"])
@pytest.mark.parametrize("order", ["counter-balanced", "random"])
def test_tracks_run_side_by_side_and_none_runs_ahead(procedure: str, order: str) -> None:
    main = list_main(collect_prompts(study_with(procedure, f'order = "{order}"'), 1))
    done: Counter[str] = Counter(dict.fromkeys(("one", "two", "three"), 0))
    runs = [len(list(run)) for _, run in groupby(p.condition for p in main)]
    assert max(runs) <= 2
    for prompt in main:
        done[prompt.condition] += 1
        assert max(done.values()) - min(done.values()) <= 1
    rounds = {tuple(p.condition for p in main[k : k + 3]) for k in range(0, 36, 3)}
    assert len(rounds) > 2, "the rounds are not in one order"


def test_the_others_go_on_when_a_track_has_ended() -> None:
    study = study_with("staircase")
    procedure: Procedure = procedure_of(study, plan(study, 0))
    asked: list[str] = []
    while (prompt := procedure.prompt) is not None:
        # Who answers 'one' wrong and right in turn has its ten reversals early; the others never reverse.
        asked.append(prompt.condition)
        count = asked.count("one")
        right = prompt.condition != "one" or count % 3 != 0
        procedure = procedure.record_answer(Answer(prompt.interval if right else 3 - prompt.interval))
        left = procedure.expected
    assert left == 0
    assert asked.count("two") == asked.count("three") == 12
    short = study_of(study.text.replace("trials = 12", "trials = 60\nreversals = 4"))
    procedure, asked = procedure_of(short, plan(short, 0)), []
    while (prompt := procedure.prompt) is not None:
        asked.append(prompt.condition)
        right = prompt.condition != "one" or asked.count("one") % 3 != 0
        procedure = procedure.record_answer(Answer(prompt.interval if right else 3 - prompt.interval))
    assert asked.count("one") < 20
    assert asked.count("two") == asked.count("three") == 60
    assert set(asked[-20:]) == {"two", "three"}


@pytest.mark.parametrize("repetitions", [1, 2, 3, 8])
@pytest.mark.parametrize("procedure", ["constant", "forced-choice"])
def test_both_intervals_come_equally_often_for_every_level_and_pair(procedure: str, repetitions: int) -> None:
    study = study_with(procedure, f"repetitions = {repetitions}\nseed = 5")
    both = []
    for person in (0, 1):
        main = list_main(collect_prompts(study, person))
        cells = Counter((p.condition, p.other, p.level, p.interval) for p in main)
        groups = {key[:3] for key in cells}
        for cell in groups:
            assert abs(cells[(*cell, 1)] - cells[(*cell, 2)]) <= repetitions % 2
            assert cells[(*cell, 1)] + cells[(*cell, 2)] == repetitions
        assert abs(sum(2 * p.interval - 3 for p in main)) <= repetitions % 2
        both.append(cells)
    together = both[0] + both[1]
    assert set(together.values()) == {repetitions}, "two people together are balanced in every cell"


@pytest.mark.parametrize("procedure", ["staircase", "bayesian"])
def test_both_intervals_come_equally_often_in_a_track_wherever_it_ends(procedure: str) -> None:
    for person in range(3):
        main = list_main(collect_prompts(study_with(procedure), person))
        for name in ("one", "two", "three"):
            signs = [2 * p.interval - 3 for p in main if p.condition == name]
            assert sum(signs) == 0
            assert max(abs(sum(signs[:n])) for n in range(len(signs))) <= 3


@pytest.mark.parametrize("procedure", PROCEDURES)
def test_practice_and_breaks_come_in_every_procedure(procedure: str) -> None:
    study = study_with(procedure, "practice = 4\nbreak_every = 3\nbreak_seconds = 30")
    prompts = collect_prompts(study, 2)
    assert [p.phase for p in prompts[:5]] == ["practice"] * 4 + ["main"]
    assert [p.phase for p in prompts].count("practice") == 4
    main = list_main(prompts)
    assert [n for n, p in enumerate(main) if p.pause] == list(range(3, len(main), 3))
    assert {p.pause for p in prompts} == {0.0, 30.0}
    told = forecast(study)
    assert told.trials == len(prompts)
    assert told.seconds >= 30 * len([p for p in prompts if p.pause])
    assert (summarize_order(study).practice, summarize_order(study).breaks) == (4, (len(main) - 1) // 3)


@pytest.mark.parametrize("procedure", ["staircase", "bayesian"])
def test_practice_of_a_track_is_easy_and_moves_nothing(procedure: str) -> None:
    study = study_with(procedure, "practice = 5")
    found = []
    for wrong in (True, False):
        state: Procedure = procedure_of(study, plan(study, 0))
        for _ in range(5):
            prompt = state.prompt
            assert prompt is not None
            assert prompt.level == pytest.approx(2.2)
            state = state.record_answer(Answer(3 - prompt.interval if wrong else prompt.interval))
        found.append(state)
    assert found[0].prompt == found[1].prompt
    assert getattr(found[0], "parts")[1:] == getattr(found[1], "parts")[1:]  # noqa: B009


@pytest.mark.parametrize("procedure", PROCEDURES)
def test_blocked_is_the_order_of_the_file_and_one_condition_is_random(procedure: str) -> None:
    main = list_main(collect_prompts(study_with(procedure, 'order = "blocked"'), 1))
    pairs = [(p.condition, p.other) for p in main]
    assert len(list(groupby(pairs))) == 3
    assert main[0].condition == "one"
    if procedure != "forced-choice":
        alone = study_with(procedure, 'order = "counter-balanced"', "")
        asked, summary = list_main(collect_prompts(alone, 0)), summarize_order(alone)
        assert "order: random, each participant's own" in summary.sentences
        told = {"constant": [f"{p.level:g}" for p in asked], "identification": [str(p.set_point) for p in asked],
                "staircase": [str(p.interval) for p in asked]}.get(procedure)  # fmt: skip
        if told is not None:  # a track that ends early asks less than was drawn
            assert list(summary.asked[0][: len(told)]) == told
            assert summary.row(0).startswith(" ".join(told[:20]))


@pytest.mark.parametrize("procedure", ["staircase", "bayesian", "constant"])
def test_a_session_that_was_cut_off_goes_on_at_the_same_place(procedure: str, tmp_path: Path) -> None:
    study = study_with(procedure, "practice = 2\nbreak_every = 5\nseed = 3")
    wanted = collect_prompts(study, 0)
    engine, asked = database(tmp_path / "s.db"), []
    while True:
        with StoredSession(engine, study, "P01") as session:
            for _ in range(4):  # begun anew after every four answers
                if (prompt := session.prompt) is not None:
                    asked.append(prompt)
                    session.answer(Answer(prompt.interval))
            if session.over:
                break
    assert asked == wanted
    columns = tidy(engine, study)
    assert columns["phase"].tolist() == [p.phase for p in wanted]


#: procedure → digest of the study and SHA-256 of the first two plans, as haptorb 0.1 at b77c0a6 stored them
OLDER = {
    'name = "a"\n[trials]\nseed = 3\npractice = 2\nbreak_every = 10\n': ("", "16923f221eeb", "879492dd4221"),
    'name = "b"\nprocedure = "constant"\n[levels]\nreference = 1.2\nvalues = [0.8, 1.0, 1.4]\n[trials]\n'
    'repetitions = 3\nseed = 4\npractice = 2\n[[conditions]]\nname = "one"\n[[conditions]]\nname = "two"\n': (
        "0ebb73713b20114b", "da2e4840a573", "1223731c073d",
    ),
    'name = "c"\nprocedure = "forced-choice"\n[trials]\nrepetitions = 3\norder = "counter-balanced"\nbreak_every = 4\n'
    '[[conditions]]\nname = "one"\n[[conditions]]\nname = "two"\n[[conditions]]\nname = "three"\n': (
        "82b3d5a95ac2f50a", "07e9d9df29ab", "e46a0135c482",
    ),
    'name = "d"\nprocedure = "staircase"\n[levels]\nreference = 1.2\nleast = 0.01\nmost = 1.0\nstart = 0.8\n'
    'trials = 12\n[trials]\npractice = 3\n[[conditions]]\nname = "one"\n[[conditions]]\nname = "two"\n': (
        "9347c08f0727bea1", "d30c90a4e5b2", "ffe7341cb0a6",
    ),
    'name = "e"\nprocedure = "rating"\n[trials]\norder = "blocked"\n[[conditions]]\nname = "one"\n[[conditions]]\n'
    'name = "two"\n': ("bf453737435d3757", "4cb491d77f60", "b75f2ef9afe5"),
}  # fmt: skip


@pytest.mark.parametrize("text", OLDER)
def test_a_study_of_an_older_version_keeps_its_digest_and_its_order(text: str, tmp_path: Path) -> None:
    digest, *plans = OLDER[text]
    older = next(one for one in list_older(study_of(text)) if not one.order_version)
    if digest:
        assert older.digest == digest
    assert [sha256(json.dumps(plan(older, n)).encode()).hexdigest()[:12] for n in (0, 1)] == plans
    # Its database has the file without a word on order; the same file, run again today, goes on with that study.
    assert study_of(older.text, stored=True).digest == older.digest
    engine = database(tmp_path / "s.db")
    with StoredSession(engine, older, "P01") as session:
        first = session.prompt
        assert first is not None
    kept = find_begun_version(engine, study_of(text))
    assert (kept.digest, kept.text) == (older.digest, older.text)
    with StoredSession(engine, kept, "P01") as session:
        assert session.prompt == first
    assert find_begun_version(database(tmp_path / "new.db"), study_of(text)).order_version == "2"


def test_check_prints_who_meets_what(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    Path("s.toml").write_text(study_with("staircase", "practice = 3\nbreak_every = 10").text)
    for words, code in (((), 0), (("--json",), 0), (("--people", "0"), 2)):
        try:
            ended = main(["study", "check", "s.toml", *words])
        except SystemExit as end:
            ended = int(end.code or 0)
        assert ended == code
    out = capsys.readouterr().out
    text, found = out[: out.index("{")], json.loads(out[out.index("{") :])
    assert "every 6 participants complete a Williams square" in text
    assert "one two three" in text
    table = text[text.index("Order, trial by trial") :].splitlines()
    assert max(map(len, table)) <= 80
    stored = study_of(Path("s.toml").read_text())
    assert found["order"]["sessions"] == [plan(stored, n) for n in range(6)]
    assert found["order"]["participants_for_balance"] == 6


def test_turns_that_name_nobody_are_refused() -> None:
    with pytest.raises(InputError, match="turns"):
        InterleavedProcedures((), (0,))
    assert draw_turns([], [], None) == []  # type: ignore[arg-type]
    assert balance_intervals(0, 3, 0, 0) == []
    assert [square_size(n) for n in (2, 3, 6)] == [2, 6, 6]
    assert balance_conditions(1, 7) == [0]
