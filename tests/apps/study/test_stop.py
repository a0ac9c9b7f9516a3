"""Stop in a study: from every page, in every state, before any check, queue or database; and whatever else fails."""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from sqlalchemy import event, text

from haptorb.apps.study.model.study_file import Study
from haptorb.apps.study.model.study_reader import study_of
from haptorb.apps.study.session.halt import StopSwitch
from haptorb.apps.study.session.keys import Keyboard, name_keys
from haptorb.apps.study.session.stored_session import StoredSession
from haptorb.apps.study.store.columns import tidy
from haptorb.apps.study.store.database import database
from haptorb.errors import InputError, RecordingError


def _module(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


FakeServo: Any = _module("fake_servo").FakeServo
pages = _module("test_pages")
STUDY = f'{pages.STUDY}[[questions]]\nname = "words"\ntext = "Anything else?"\n'


def _until(holds: Callable[[], object], after: str = "") -> None:
    end = time.monotonic() + 30
    while not holds():
        assert time.monotonic() < end, f"it did not come to pass after {after[:60]!r}"
        time.sleep(0.005)


class Desk:
    """A served study whose database and whose device's start wait for as long as a test wants."""

    def __init__(self, study: Study, place: Path) -> None:
        self.served = pages.Desk(study, place)
        self.reception, self.engine = self.served.reception, self.served.engine
        self.first, self.second = self.served.participant(), self.served.participant()
        self.second.until(lambda page: page.view.get("watching"))
        self.experimenter = self.served.experimenter()
        self._waits, self._go_on = threading.Event(), threading.Event()
        self._locked = False
        event.listen(self.engine, "before_cursor_execute", self._hold)

    @property
    def servo(self) -> Any:
        return self.served.servo

    def trial(self) -> None:
        """P01 is in the first trial."""
        self.experimenter.do("begin", code="P01")
        self.first.state("consent")
        self.first.do("agree", agreed=True)
        self.first.state("running", 0)

    def _hold(self, connection: Any, cursor: Any, statement: str, *rest: Any) -> None:
        if self._locked and statement.startswith(("INSERT", "BEGIN IMMEDIATE")):
            self._waits.set()
            assert self._go_on.wait(60)

    @contextmanager
    def lock(self) -> Iterator[threading.Event]:
        """The database waits with the next thing that is to be kept; the event: it does."""
        self._locked = True
        try:
            yield self._waits
        finally:
            self._locked = False
            self._go_on.set()

    def kinds(self) -> list[tuple[str, str]]:
        """What is on record."""
        with self.engine.connect() as connection:
            return [tuple(row) for row in connection.execute(text("SELECT kind, text FROM events ORDER BY id")).all()]


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    desk = Desk(study_of(STUDY), tmp_path / "s.db")
    yield desk
    desk.served.close()


def _stop(desk: Desk, who: str) -> None:
    page = {"first": desk.first, "second": desk.second, "experimenter": desk.experimenter}[who]
    page.do("stop")


@pytest.mark.parametrize("who", ["first", "second", "experimenter"])
def test_stop_of_any_page_comes_before_the_database(desk: Desk, who: str) -> None:
    desk.trial()
    with desk.lock() as waits:
        desk.first.do("answer", trial=0, value=1)
        assert waits.wait(30)  # the thread of the sessions is held up
        _stop(desk, who)
        _until(lambda: desk.servo.off)
        desk.first.state("paused")
        desk.experimenter.state("paused")
        assert desk.first.view["stopped"] == ("by the experimenter" if who == "experimenter" else "by the participant")
    desk.experimenter.until(lambda page: page.view["log"])
    assert desk.reception.now == "paused"
    assert desk.servo.off
    desk.experimenter.do("resume")
    desk.first.state("running", 1)
    assert not desk.servo.off
    _until(lambda: [kind for kind, _ in desk.kinds()] == ["begin", "consent", "pause", "resume"])
    assert tidy(desk.engine, desk.served.study)["safety"].tolist() == [""]


def test_a_resume_that_was_asked_for_before_a_stop_is_dropped_and_told(desk: Desk) -> None:
    desk.trial()
    with desk.lock() as waits:
        desk.first.do("answer", trial=0, value=1)
        assert waits.wait(30)
        desk.first.do("stop")
        _until(lambda: desk.servo.off)
        desk.experimenter.do("resume")
        desk.experimenter.do("nothing")  # told when the resume has arrived
        desk.experimenter.until(lambda page: any("unknown command" in mistake for mistake in page.mistakes))
        desk.second.do("stop")
        _until(lambda: desk.servo.stops >= 2)
    desk.experimenter.until(lambda page: any("Stop was pressed" in mistake for mistake in page.mistakes))
    assert desk.servo.off
    assert desk.reception.now == "paused"
    desk.experimenter.do("resume")
    desk.first.state("running", 1)


def test_a_page_that_goes_away_stops_before_the_database(desk: Desk) -> None:
    desk.trial()
    with desk.lock() as waits:
        desk.first.do("answer", trial=0, value=1)
        assert waits.wait(30)
        desk.first.close()
        _until(lambda: desk.servo.off)
    desk.second.until(lambda page: page.view["watching"] is False)
    desk.second.state("paused", 1)
    _until(lambda: ("pause", "the participant's page was closed") in desk.kinds())


@pytest.mark.parametrize("end", ["leave", "abort"])
def test_ending_a_session_stops_before_the_database(desk: Desk, end: str) -> None:
    desk.trial()
    with desk.lock() as waits:
        desk.experimenter.do(end)
        _until(lambda: desk.servo.off)
        assert waits.wait(30)
        assert desk.servo.told[-1] == "stop"
    desk.first.state({"leave": "left", "abort": "aborted"}[end])


def test_closing_the_server_stops_before_the_database(desk: Desk) -> None:
    desk.trial()
    with desk.lock() as waits:
        desk.first.do("answer", trial=0, value=1)
        assert waits.wait(30)
        closing = threading.Thread(target=desk.reception.close)
        closing.start()
        _until(lambda: desk.servo.off)
        assert closing.is_alive()
    closing.join(30)
    assert desk.servo.told[-1] == "close"


@pytest.mark.parametrize("state", ["consent", "running", "question", "break", "pause"])
def test_stop_holds_in_every_state_until_somebody_resumes(tmp_path: Path, state: str) -> None:
    rest = {"break": "break_every = 1\nbreak_seconds = 300", "pause": "pause_seconds = 300"}.get(state, "")
    study = STUDY.replace("pause_seconds = 0.0", rest or "pause_seconds = 0.0")
    if state == "question":
        study = study.replace("low = 0", 'when = "before"\nlow = 0')
    desk = Desk(study_of(study), tmp_path / "s.db")
    try:
        desk.experimenter.do("begin", code="P01")
        desk.first.state("consent")
        if state != "consent":
            desk.first.do("agree", agreed=True)
        if state in ("break", "pause"):
            desk.first.state("running", 0)
            desk.first.do("answer", trial=0, value=1)
        desk.first.state(state)
        assert not desk.servo.off
        desk.second.do("stop")
        desk.first.state("paused")
        assert desk.servo.off
        desk.first.do("agree", agreed=True)
        desk.first.do("skip")
        desk.experimenter.do("repeat")
        desk.experimenter.do("engage")
        desk.experimenter.until(lambda page: page.mistakes)
        assert desk.servo.off
        assert desk.reception.now == "paused"
        desk.experimenter.do("resume")
        desk.first.state(state)
        assert not desk.servo.off
        after = ["pause", "resume", "repeat"] if state == "running" else ["pause", "resume"]
        _until(lambda: [kind for kind, _ in desk.kinds()][-len(after) :] == after)
    finally:
        desk.served.close()


def test_a_stop_while_the_device_starts_holds_once_it_runs(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    opening, go_on = threading.Event(), threading.Event()
    make = desk.reception._start

    def start(recording: Path | None) -> Any:
        servo = make(recording)

        def open_() -> None:
            opening.set()
            assert go_on.wait(60)

        servo.open = open_
        return servo

    monkeypatch.setattr(desk.reception, "_start", start)
    desk.experimenter.do("begin", code="P01")
    assert opening.wait(30)
    desk.first.do("stop")
    _until(lambda: desk.servo.stops == 1)
    desk.first.until(lambda page: page.view["state"] == "starting" and page.view["stopped"])
    go_on.set()
    desk.first.state("paused")
    assert desk.servo.off
    desk.experimenter.do("resume")
    desk.first.state("consent")
    assert not desk.servo.off


def test_a_begin_that_was_asked_for_before_a_stop_begins_stopped(desk: Desk) -> None:
    with desk.lock() as waits:
        desk.experimenter.do("begin", code="P01")
        assert waits.wait(30)
        assert not desk.served.servos
        desk.first.do("stop")
        desk.first.do("nothing")
        desk.first.until(lambda page: page.mistakes)
    desk.first.state("paused")
    assert desk.servo.off
    _until(lambda: desk.kinds()[-1] == ("pause", "by the participant"))


HOSTILE = [
    '{"do":[]}',
    '{"do":{}}',
    '{"do":null}',
    "[]",
    '{"do":"steer","x":1' + "0" * 400 + ',"y":0}',
    '{"do":"steer","x":NaN,"y":1e400}',
    '{"do":"draft","value":1' + "0" * 400 + "}",
    '{"do":"answer","trial":0,"value":1' + "0" * 400 + "}",
    '{"do":"answer","trial":[],"value":{}}',
    '{"do":"interval","which":[]}',
    '{"do":"reply","question":[],"reply":[]}',
    '{"do":"agree","agreed":"\\ud800"}',
    "[" * 30_000,
    "",
    "\x00",
    '{"do":"\\ud800"}',
]


def test_no_message_takes_stop_or_the_place_from_a_page(desk: Desk) -> None:
    desk.trial()
    for message in HOSTILE:
        for page in (desk.first, desk.second, desk.experimenter):
            page.socket.send(message)
            page.socket.send(message.encode())
            page.do("stop")
            _until(lambda: desk.servo.off, message)
            desk.first.state("paused")
            desk.experimenter.state("paused")
            desk.experimenter.do("resume")
            desk.first.state("running", 0)
            desk.experimenter.state("running")  # else the next round takes this pause for its own
    desk.first.close()
    desk.second.until(lambda page: page.view["watching"] is False)
    desk.experimenter.until(lambda page: page.view["pages"] == 1)
    desk.experimenter.do("resume")
    desk.second.state("running", 0)
    desk.second.do("answer", trial=0, value=1)
    desk.second.state("running", 1)


@pytest.mark.parametrize("who", ["first", "experimenter"])
def test_a_fault_that_a_message_meets_takes_no_stop_from_its_page(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, who: str
) -> None:
    desk.trial()
    page = getattr(desk, who)

    def fault(command: dict[str, Any], told: Any) -> None:
        raise ZeroDivisionError("nobody foresaw it")

    monkeypatch.setattr(desk.reception, "ask", fault)
    page.do("skip")
    page.until(lambda page: any("ZeroDivisionError" in mistake for mistake in page.mistakes))
    page.do("stop")
    _until(lambda: desk.servo.off)


def test_a_message_that_is_no_json_but_says_stop_stops(desk: Desk) -> None:
    desk.trial()
    desk.first.socket.send('{"do" : "stop", "why": "\\ud800')
    _until(lambda: desk.servo.off)


def test_replies_that_cannot_be_kept_are_refused_and_the_next_is_kept(desk: Desk) -> None:
    desk.trial()
    for trial in (0, 1):
        desk.first.do("answer", trial=trial, value=1)
        desk.first.until(lambda page, n=trial: page.view.get("trial", 0) > n or page.view["state"] == "question")
    desk.first.do("reply", question="tired", reply="--5")
    desk.first.do("reply", question="tired", reply="9" * 5000)
    desk.first.do("reply", question="tired", reply=["4"])
    desk.first.until(lambda page: len(page.mistakes) == 3)
    desk.first.do("reply", question="tired", reply="4")
    desk.first.until(lambda page: (page.view["question"] or {}).get("name") == "words")
    desk.first.socket.send('{"do":"reply","question":"words","reply":"a\\ud800b"}')
    desk.first.until(lambda page: len(page.mistakes) == 4)
    desk.first.do("reply", question="words", reply="ä€🙂")
    desk.first.state("done")


def test_the_thread_outlives_a_fault_that_nobody_foresaw(desk: Desk) -> None:
    desk.trial()

    def fault(name: str, values: Any = None) -> None:
        raise ZeroDivisionError("nobody foresaw \ud800")

    desk.servo.set_world = fault
    desk.first.do("answer", trial=0, value=1)
    desk.first.until(lambda page: any("ZeroDivisionError" in mistake for mistake in page.mistakes))
    desk.experimenter.state("failed")
    assert desk.servo.off
    assert desk.servo.told[-1] == "close"
    _until(lambda: desk.kinds()[-1][0] == "failed")
    desk.experimenter.do("begin", code="P01")
    desk.first.state("consent")
    desk.first.do("agree", agreed=True)
    desk.first.state("running", 1)


def test_a_thread_that_dies_ends_the_server_with_the_coils_off(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    desk.trial()

    def die(wait: float = 0.0) -> None:
        raise SystemExit

    monkeypatch.setattr(type(desk.reception), "step", lambda self, wait: die())
    desk.experimenter.state("failed")
    assert "thread ended" in desk.experimenter.view["trouble"]
    assert desk.servo.off
    assert desk.servo.told[-1] == "close"
    desk.experimenter._listening.join(30)
    desk.first._listening.join(30)
    _until(lambda: desk.served.failures)
    assert "enter the same code to continue" in str(desk.served.failures[0])
    assert not desk.experimenter._listening.is_alive()
    with pytest.raises(InputError, match="has failed"):
        desk.reception.ask({"do": "begin", "code": "P02"}, print)


def test_what_a_locked_database_did_not_take_is_kept_later_in_order(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    other = database(tmp_path / "s.db")
    with StoredSession(engine, identify, "P01") as sitting:
        with engine.connect() as connection:
            connection.execute(text("PRAGMA busy_timeout = 10"))
        with other.connect() as connection:
            connection.execute(text("BEGIN EXCLUSIVE"))
            sitting.note("pause", "early", at="2026-01-01T00:00:00.000+00:00", later=True)
            sitting.note("resume", later=True)
            with pytest.raises(RecordingError, match="locked"):
                sitting.note("consent")
            connection.rollback()
        sitting.keep_late()
        with other.connect() as connection:
            assert connection.execute(text("SELECT count(*) FROM events")).scalar_one() == 3, (
                "nothing else was kept yet"
            )
        sitting.note("repeat")
    with other.connect() as connection:
        rows = connection.execute(text("SELECT kind, at FROM events ORDER BY id")).all()
    assert [row[0] for row in rows] == ["begin", "pause", "resume", "repeat"]
    assert rows[1][1] == "2026-01-01T00:00:00.000+00:00"
    engine.dispose()
    other.dispose()


@pytest.fixture
def typed(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """The end of a pipe into which a test types; the other end is standard input."""
    reading, writing = os.pipe()
    with os.fdopen(reading) as source:
        monkeypatch.setattr("sys.stdin", source)
        yield writing
    os.close(writing)


@pytest.mark.parametrize("key", [b" ", b"\x1b", b"q"])
def test_a_key_stops_while_nobody_takes_keys(typed: int, key: bytes) -> None:
    servo, halt = FakeServo(), StopSwitch()
    halt.attach(servo, halt.ask())
    with Keyboard(halt) as keys:
        os.write(typed, b"e" + key)
        _until(lambda: servo.off)
        assert keys.next_key(30) == "e"
        with pytest.raises(InputError, match="Stop was pressed"):
            halt.engage(keys.asked)  # type: ignore[arg-type]
        assert servo.off


def test_space_is_a_letter_while_words_are_typed_and_escape_stops(typed: int) -> None:
    servo, halt = FakeServo(), StopSwitch()
    halt.attach(servo, halt.ask())
    with Keyboard(halt, lambda: True) as keys:
        os.write(typed, b"a q")
        assert [keys.next_key(30) for _ in range(3)] == ["a", "space", "q"]
        assert not servo.off
        os.write(typed, b"\x1b[3~\x1b")
        _until(lambda: servo.off)
    assert name_keys("\x1b[A\x1bOB\x1b[1;5Cx") == ["up", "down", "x"]


def test_ctrl_c_stops_before_the_main_thread_hears_of_it(typed: int) -> None:
    servo, halt = FakeServo(), StopSwitch()
    halt.attach(servo, halt.ask())
    before = signal.signal(signal.SIGINT, lambda number, frame: None)
    try:
        with Keyboard(halt):
            signal.raise_signal(signal.SIGINT)
            _until(lambda: servo.off)
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_page_that_asks_for_too_much_is_told_so_and_stops_all_the_same(desk: Desk) -> None:
    desk.trial()
    with desk.lock() as waits:
        desk.first.do("answer", trial=0, value=1)
        assert waits.wait(30)
        for _ in range(300):
            desk.first.socket.send(json.dumps({"do": "skip"}))
        desk.first.until(lambda page: any("too many" in mistake for mistake in page.mistakes))
        desk.first.do("stop")
        _until(lambda: desk.servo.off)
