"""Text typed into the pages is stored unchanged, or rejected with a reason."""

from __future__ import annotations

import importlib.util
import sqlite3
import threading
import time
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

import pytest

import haptorb_study.feel
from haptorb.web.console import Console
from haptorb_study.database import database
from haptorb_study.feel import FeelSession, load_designs
from haptorb_study.feel.live_session import FeelPanel, LiveSession
from haptorb_study.pages.session_manager import SessionManager
from haptorb_study.pages.study_server import StudyServer
from haptorb_study.study_file import study_of
from typed_texts import TEXTS

_SPEC = importlib.util.spec_from_file_location(
    "study_fake_servo", Path(__file__).parents[1] / "study" / "fake_servo.py"
)
assert _SPEC is not None
assert _SPEC.loader is not None
_MODULE = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(_MODULE)
FakeServo: Any = _MODULE.FakeServo

pytestmark = [pytest.mark.browser, pytest.mark.realtime]

EXAMPLE = Path(haptorb_study.feel.__file__).with_name("example.toml")
MAGNITUDE = """
name = "typed"
procedure = "magnitude"
[levels]
reference = 1.0
values = [1.0, 2.0]
[trials]
repetitions = 200
pause_seconds = 0.0
"""
RATING = 'name = "typed"\nprocedure = "rating"\n[trials]\nrepetitions = 400\npause_seconds = 0.0\n'
QUESTION = '[[questions]]\nname = "q{0}"\ntext = "Question {0}?"\nwhen = "before"\n'
WORDS = 'name = "typed"\n[trials]\nrepetitions = 1\n' + "".join(
    QUESTION.format(n) + ("low = -5\nhigh = 1000000\n" if n % 2 else "") for n in range(198)
)


@contextmanager
def served(place: Path, text: str) -> Iterator[StudyServer]:
    manager = SessionManager(database(place), study_of(text), lambda recording: FakeServo())
    host = StudyServer(manager, 0)
    thread = threading.Thread(target=host.serve)
    with host:
        thread.start()
        try:
            yield host
        finally:
            host.close()
            thread.join(20)


def until(page: Any, condition: str) -> None:
    end = time.monotonic() + 60
    while not page.evaluate(condition):
        assert time.monotonic() < end, (condition, page.evaluate("JSON.stringify(study.view)"))
        page.wait_for_timeout(5)


def begin(browser: Any, host: StudyServer) -> tuple[Any, Any]:
    """Participant's and experimenter's pages, in a session of P01 that was agreed to."""
    pages = [browser.new_page() for _ in range(2)]
    for page, url in zip(pages, (host.participant, host.experimenter), strict=True):
        page.goto(url)
        until(page, "!!study.view && study.view.state === 'waiting'")
    pages[1].fill("#code", "P01")
    pages[1].keyboard.press("Enter")
    until(pages[0], "study.view.state === 'consent'")
    pages[0].locator("#message-buttons button").first.click()
    return pages[0], pages[1]


def stored(place: Path, query: str) -> list[tuple[Any, ...]]:
    with sqlite3.connect(place) as raw:
        found = raw.execute(query).fetchall()
    raw.close()
    return found


def same(typed: str, value: float) -> bool:
    """Whether `value` is the number that was typed, digit for digit."""
    try:
        return Decimal(typed.replace(",", ".")) == Decimal(repr(value)) and typed.strip() == typed
    except InvalidOperation:
        return False


def texts(slow: bool) -> tuple[str, ...]:
    return TEXTS if slow else TEXTS[::12]


AMOUNTS = [pytest.param(False, id="some"), pytest.param(True, id="all", marks=[pytest.mark.slow])]


@pytest.mark.timeout(900)
@pytest.mark.parametrize("everything", AMOUNTS)
@pytest.mark.parametrize("study", [MAGNITUDE, RATING], ids=["magnitude", "rating"])
def test_an_answer(browser: Any, tmp_path: Path, study: str, everything: bool) -> None:
    place, count = tmp_path / "s.db", 0
    with served(place, study) as host:
        page, other = begin(browser, host)
        page.set_viewport_size({"width": 390, "height": 844})
        until(page, "study.view.state === 'running'")
        for typed in texts(everything):
            page.evaluate("document.getElementById('typed').value = ''")
            page.focus("#typed")
            page.keyboard.insert_text(typed)
            trial = page.evaluate("study.view.trial")
            page.evaluate("document.getElementById('mistake').hidden = true")  # that of the text before
            page.keyboard.press("Enter")
            until(page, f"study.view.trial !== {trial} || !document.getElementById('mistake').hidden")
            rows = stored(place, "SELECT answer FROM trials ORDER BY number")
            if len(rows) == count:
                assert page.locator("#mistake").inner_text(), typed
                box = page.locator("#mistake").bounding_box()
                assert 0 <= box["y"] <= box["y"] + box["height"] <= 845, "the message is not on the screen"
            else:
                assert len(rows) == count + 1
                assert same(typed, rows[-1][0]), (typed, rows[-1])
                count += 1
                until(page, f"study.view.trial === {count} && study.view.state === 'running'")
        assert count > 0
        page.close()
        other.close()


@pytest.mark.timeout(900)
@pytest.mark.parametrize("everything", AMOUNTS)
def test_a_question_in_words_or_numbers(browser: Any, tmp_path: Path, everything: bool) -> None:
    place, count = tmp_path / "s.db", 0
    with served(place, WORDS) as host:
        page, other = begin(browser, host)
        until(page, "study.view.state === 'question'")
        for typed in [text for text in texts(everything) for _ in range(2)][:380]:
            if count >= 190:
                break
            name = page.evaluate("study.view.question.name")
            field = page.locator(".question input, .question textarea")
            field.fill("")
            field.focus()
            page.keyboard.insert_text(typed)
            seen = field.input_value()
            page.locator(".question .sure").click()
            until(page, f"study.view.question?.name !== {name!r} || !document.getElementById('mistake').hidden")
            rows = stored(place, "SELECT reply FROM replies ORDER BY id")
            if len(rows) == count:
                assert page.locator("#mistake").inner_text(), typed
                page.evaluate("document.getElementById('mistake').hidden = true")
            else:
                assert rows[-1][0] == typed == seen, (typed, seen)
                count += 1
        assert count > 0
        page.close()
        other.close()


@pytest.mark.timeout(900)
@pytest.mark.parametrize("everything", AMOUNTS)
def test_a_code(browser: Any, tmp_path: Path, everything: bool) -> None:
    place, count = tmp_path / "s.db", 0
    with served(place, RATING) as host:
        page = browser.new_page()
        page.goto(host.experimenter)
        until(page, "!!study.view && study.view.state === 'waiting'")
        for typed in texts(everything):
            page.evaluate("document.getElementById('last').textContent = ''")
            page.fill("#code", "")
            page.focus("#code")
            page.keyboard.insert_text(typed)
            page.keyboard.press("Enter")
            until(page, "study.view.code || document.getElementById('last').textContent")
            codes = [code for (code,) in stored(place, "SELECT code FROM participants ORDER BY id")]
            if not page.evaluate("study.view.code"):
                assert len(codes) == count, typed
                assert page.locator("#last").inner_text(), typed
            else:  # the same letters, also where an accent was typed on its own; then it is the same code
                assert unicodedata.normalize("NFC", typed) in codes
                count = len(codes)
                until(page, "study.view.state === 'consent'")
                page.click("#leave")
                until(page, "study.view.state === 'left'")
        assert count > 0
        page.close()


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("everything", AMOUNTS)
def test_a_parameter_of_the_console(browser: Any, fake: Any, painting: Any, kit: Any, everything: bool) -> None:
    with Console(fake, 0, force_map=painting) as console, kit.serve(console):
        screen = kit.Screen(browser.new_page(viewport=kit.DESK), console.url)
        screen.until("haptorb.control")
        used = 0
        for typed in texts(everything):
            before = float(fake.world[1]["moment"])
            field = screen.page.locator("#entry-moment")
            field.fill("")
            field.focus()
            screen.page.keyboard.insert_text(typed)
            screen.page.keyboard.press("Enter")
            if screen.page.locator("#entry-moment-mistake").is_visible():
                assert screen.page.locator("#entry-moment-mistake").inner_text()
                screen.page.wait_for_timeout(50)
                assert float(fake.world[1]["moment"]) == before, typed
            else:
                value = float(typed)
                screen.wait_for(lambda value=value: float(fake.world[1]["moment"]) == value)  # type: ignore[misc]
                used += 1
        assert used > 0
        assert not screen.troubles
        screen.page.close()


@pytest.mark.timeout(900)
@pytest.mark.parametrize("everything", AMOUNTS)
def test_the_person_of_a_feel_session(
    browser: Any, fake: Any, painting: Any, kit: Any, tmp_path: Path, everything: bool
) -> None:
    session = FeelSession(tmp_path / "s", load_designs(EXAMPLE))
    live = LiveSession(session, list(session.candidates.designs), person="P0", seed=1)
    with Console(fake, 0, force_map=painting, designs=FeelPanel(live)) as console, kit.serve(console):
        screen = kit.Screen(browser.new_page(viewport=kit.DESK), console.url)
        page, used = screen.page, 0
        screen.until("haptorb.control")
        for typed in (*texts(everything), "b7"):
            before = live.person
            live.rate(3)  # belongs to whoever is named now
            page.evaluate("document.getElementById('mistake').hidden = true")
            page.fill("#feel-person", "")
            page.focus("#feel-person")
            page.keyboard.insert_text(typed)
            page.keyboard.press("Enter")
            end = time.monotonic() + 20
            while live.person != typed and not page.locator("#mistake").is_visible():
                assert time.monotonic() < end, typed
                page.wait_for_timeout(5)
            assert live.person in (typed, before)
            used += live.person != before
            assert session.ratings()[-1].person == before
        assert used > 0
        assert not screen.troubles
        page.close()
