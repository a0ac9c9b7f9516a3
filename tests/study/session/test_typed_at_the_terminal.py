"""Text typed at the terminal is stored unchanged, or rejected with a message."""

from __future__ import annotations

import importlib.util
import re
import sqlite3
import unicodedata
from contextlib import closing
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

import pytest

import haptorb_study.feel
from haptorb.cli import main
from haptorb_study.database import database
from haptorb_study.feel import FeelSession, load_designs
from haptorb_study.feel.live_session import LiveSession, read_lines
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import study_of
from haptorb_study.terminal_session import END, Keys, TerminalSession, View, name_keys
from haptorb_study.trial_device import TrialDevice
from typed_texts import TEXTS

_SPEC = importlib.util.spec_from_file_location("fake_servo", Path(__file__).parents[1] / "fake_servo.py")
assert _SPEC is not None
assert _SPEC.loader is not None
_MODULE = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(_MODULE)
FakeServo: Any = _MODULE.FakeServo

AMOUNTS = [pytest.param(TEXTS[::96], id="some"), pytest.param(TEXTS, id="all", marks=[pytest.mark.slow])]
DESIGNS = Path(haptorb_study.feel.__file__).with_name("example.toml")
TRIALS = "[trials]\nrepetitions = 500\npause_seconds = 0.0\n"
PROCEDURES = {
    "identification": f'name = "typed"\n{TRIALS}',
    "rating": f'name = "typed"\nprocedure = "rating"\n{TRIALS}',
    "magnitude": f'name = "typed"\nprocedure = "magnitude"\n[levels]\nreference = 1.0\nvalues = [1.0, 2.0]\n{TRIALS}',
    "comparison": f'name = "typed"\nprocedure = "constant"\n[levels]\nreference = 1.0\nvalues = [0.8, 1.2]\n{TRIALS}',
}
QUESTION = '[[questions]]\nname = "q{0}"\ntext = "Question?"\nwhen = "before"\n{1}'


class Typed(Keys):
    """Keys before, those of a text, Enter, and the end."""

    def __init__(self, text: str, before: list[str]) -> None:
        self._keys = [*before, *name_keys(text), "enter", END]

    def next_key(self, wait: float) -> str | None:
        return self._keys.pop(0) if self._keys else END


def type_text(engine: Any, study: Any, text: str) -> list[View]:
    """A session that goes on, in which `text` and Enter are typed; what the screen showed."""
    views: list[View] = []
    servo = FakeServo()
    with StoredSession(engine, study, "P01") as session:
        keys = Typed(text, ["tab"] if study.procedure == "constant" else [])  # both intervals are felt
        TerminalSession(session, TrialDevice(study, servo), keys, views.append).run()
    return views


def stored(place: Path, query: str) -> list[Any]:
    with closing(sqlite3.connect(place)) as raw:
        return [one for (one,) in raw.execute(query)]


def is_number(typed: str, value: float) -> bool:
    """Whether `value` is the number that was typed, digit for digit."""
    try:
        return Decimal(typed.replace(",", ".")) == Decimal(repr(value)) and typed.strip() == typed
    except InvalidOperation:
        return False


@pytest.mark.parametrize("texts", AMOUNTS)
@pytest.mark.parametrize("procedure", PROCEDURES)
def test_an_answer(tmp_path: Path, procedure: str, texts: tuple[str, ...]) -> None:
    place, study = tmp_path / "s.db", study_of(PROCEDURES[procedure])
    engine, count = database(place), 0
    for typed in (*texts, "1", "2", "3"):
        views = type_text(engine, study, typed)
        answers = stored(place, "SELECT answer FROM trials ORDER BY number")
        if len(answers) == count:
            assert any(view.message or view.state == "abort?" for view in views), typed
        else:
            assert len(answers) == count + 1
            assert is_number(typed, answers[-1]), (typed, answers[-1])
            count += 1
    assert count > 0
    engine.dispose()


@pytest.mark.parametrize("texts", AMOUNTS)
def test_a_question_in_words_or_numbers(tmp_path: Path, texts: tuple[str, ...]) -> None:
    most = min(2 * len(texts), 200)
    questions = (QUESTION.format(n, "low = -5\nhigh = 1000000\n" if n % 2 else "") for n in range(most))
    place, study = tmp_path / "s.db", study_of(f'name = "typed"\n{TRIALS}' + "".join(questions))
    engine, count = database(place), 0
    for typed in [text for text in texts for _ in range(2)][: most - 1]:
        views = type_text(engine, study, typed)
        replies = stored(place, "SELECT reply FROM replies ORDER BY id")
        if len(replies) == count:
            assert any(view.message for view in views), typed
        else:
            assert replies[-1] == typed
            assert len(replies) == count + 1
            count += 1
    assert count > 0
    engine.dispose()


def code_of(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    """Exit code and messages of a command."""
    code: Any = 0
    try:
        code = main([*words]) or 0
    except SystemExit as ended:
        code = ended.code or 0
    return code, capsys.readouterr().err


@pytest.mark.parametrize("texts", AMOUNTS)
def test_the_code_of_a_person_who_takes_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], texts: tuple[str, ...]
) -> None:
    monkeypatch.setattr("haptorb_study.terminal_session.run_session", lambda *_: "left")
    monkeypatch.setattr("haptorb_study.cli.print_forecast", lambda _: True)  # half a second each time
    (tmp_path / "s.toml").write_text('name = "typed"\n')
    place, known = tmp_path / "s.db", list[str]()
    for typed in texts:
        code, said = code_of(
            capsys, "study", "run", str(tmp_path / "s.toml"), "--terminal", f"--participant={typed}", "--db", str(place)
        )
        now = stored(place, "SELECT code FROM participants ORDER BY id") if place.exists() else []
        if code:
            assert now == known, typed
            assert said.strip(), typed
        else:
            assert unicodedata.normalize("NFC", typed) in now
            assert len(now) <= len(known) + 1
        known = now
    assert known


@pytest.mark.parametrize("texts", AMOUNTS)
def test_the_code_of_a_person_who_withdraws(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], texts: tuple[str, ...]
) -> None:
    place, study = tmp_path / "s.db", study_of('name = "typed"\n')
    engine = database(place)
    for code in ("P01", "Anna7", "vp-7", "a1.", "Ä3", "12", "x1x1", "被験者12"):
        StoredSession(engine, study, code).close()
    engine.dispose()
    known = stored(place, "SELECT code FROM participants ORDER BY id")
    for typed in dict.fromkeys((*texts, "p01", "P1", "PO1", "vp_7", "P01", "Ä3")):
        code, said = code_of(capsys, "study", "withdraw", "--yes", "--", str(place), typed)
        now = stored(place, "SELECT code FROM participants ORDER BY id")
        if code:
            assert now == known, typed
            assert said.strip(), typed
        else:
            assert now == [one for one in known if one != unicodedata.normalize("NFC", typed)] != known, typed
        known = now
    assert len(known) < 8, said


@pytest.mark.parametrize("texts", AMOUNTS)
def test_a_person_and_a_score_of_a_feel_session(tmp_path: Path, texts: tuple[str, ...]) -> None:
    kept = FeelSession(tmp_path / "s", load_designs(DESIGNS))
    live = LiveSession(kept, list(kept.candidates.designs), seed=1)
    people, scores = 0, 0
    for typed in texts:
        said: list[str] = []
        before = live.person
        read_lines(live, iter([f"person {typed}"]), said.append)
        people += live.person != before
        assert live.person in (typed, before)
        assert said or live.person == typed, typed
        said, count = [], len(kept.ratings())
        given = live.current
        read_lines(live, iter([typed]), said.append)
        rated = kept.ratings()[count:]
        if rated:
            assert [str(one.score) for one in rated] == [typed]
            assert rated[0].person == live.person
            scores += 1
        else:
            same = re.fullmatch(r"\s*[ab]?\s*", typed)  # nothing, or a command: the design that is felt already
            assert said or live.current != given or same, typed
    assert people > 0
    assert scores > 0 or texts is not TEXTS


@pytest.mark.parametrize("texts", AMOUNTS)
def test_a_score_on_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], texts: tuple[str, ...]
) -> None:
    for typed in texts:
        code, said = code_of(
            capsys, "feel", str(DESIGNS), "--session", str(tmp_path / "s"), "--headless", "--duration", "0",
            f"--rate=plain={typed}",
        )  # fmt: skip
        assert code, typed
        assert ("--duration" in said) == (typed in tuple("1234567")), (typed, said)
