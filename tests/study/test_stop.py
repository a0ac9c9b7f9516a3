"""Stop in a study: from every page, in every state, before any check, queue or database, despite any failure."""

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

from haptorb.errors import InputError, RecordingError
from haptorb_study.columns import tidy
from haptorb_study.database import database
from haptorb_study.stop_switch import StopSwitch
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import Study, study_of
from haptorb_study.terminal_session import Keyboard, name_keys


def _module(name: str, folder: str = "") -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, Path(__file__).parent / folder / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


FakeServo: Any = _module("fake_servo").FakeServo
pages = _module("test_pages", "pages")
STUDY = f'{pages.STUDY}[[questions]]\nname = "words"\ntext = "Anything else?"\n'


def _until(holds: Callable[[], object], after: str = "") -> None:
    end = time.monotonic() + 30
    while not holds():
        assert time.monotonic() < end, f"it did not come to pass after {after[:60]!r}"
        time.sleep(0.005)


class StudyHost:
    """A served study whose database and whose device's start wait for as long as a test wants."""

    def __init__(self, study: Study, place: Path) -> None:
        self.served = pages.StudyHost(study, place)
        self.manager, self.engine = self.served.manager, self.served.engine
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
def host(tmp_path: Path) -> Iterator[StudyHost]:
    host = StudyHost(study_of(STUDY), tmp_path / "s.db")
    yield host
    host.served.close()


def _stop(host: StudyHost, who: str) -> None:
    page = {"first": host.first, "second": host.second, "experimenter": host.experimenter}[who]
    page.do("stop")


@pytest.mark.parametrize("who", ["first", "second", "experimenter"])
def test_stop_of_any_page_comes_before_the_database(host: StudyHost, who: str) -> None:
    host.trial()
    with host.lock() as waits:
        host.first.do("answer", trial=0, value=1)
        assert waits.wait(30)  # the thread of the sessions is held up
        _stop(host, who)
        _until(lambda: host.servo.off)
        host.first.state("paused")
        host.experimenter.state("paused")
        assert host.first.view["stopped"] == ("by the experimenter" if who == "experimenter" else "by the participant")
    host.experimenter.until(lambda page: page.view["log"])
    assert host.manager.now == "paused"
    assert host.servo.off
    host.experimenter.do("resume")
    host.first.state("running", 1)
    assert not host.servo.off
    _until(lambda: [kind for kind, _ in host.kinds()] == ["begin", "consent", "pause", "resume"])
    assert tidy(host.engine, host.served.study)["safety"].tolist() == [""]


def test_a_resume_that_was_asked_for_before_a_stop_is_dropped_and_told(host: StudyHost) -> None:
    host.trial()
    with host.lock() as waits:
        host.first.do("answer", trial=0, value=1)
        assert waits.wait(30)
        host.first.do("stop")
        _until(lambda: host.servo.off)
        host.experimenter.do("resume")
        host.experimenter.do("nothing")  # told when the resume has arrived
        host.experimenter.until(lambda page: any("unknown command" in mistake for mistake in page.mistakes))
        host.second.do("stop")
        _until(lambda: host.servo.stops >= 2)
    host.experimenter.until(lambda page: any("Stop was pressed" in mistake for mistake in page.mistakes))
    assert host.servo.off
    assert host.manager.now == "paused"
    host.experimenter.do("resume")
    host.first.state("running", 1)


def test_a_page_that_goes_away_stops_before_the_database(host: StudyHost) -> None:
    host.trial()
    with host.lock() as waits:
        host.first.do("answer", trial=0, value=1)
        assert waits.wait(30)
        host.first.close()
        _until(lambda: host.servo.off)
    host.second.until(lambda page: page.view["watching"] is False)
    host.second.state("paused", 1)
    _until(lambda: ("pause", "the participant's page was closed") in host.kinds())


@pytest.mark.parametrize("end", ["leave", "abort"])
def test_ending_a_session_stops_before_the_database(host: StudyHost, end: str) -> None:
    host.trial()
    with host.lock() as waits:
        host.experimenter.do(end)
        _until(lambda: host.servo.off)
        assert waits.wait(30)
        assert host.servo.calls[-1] == "stop"
    host.first.state({"leave": "left", "abort": "aborted"}[end])


def test_closing_the_server_stops_before_the_database(host: StudyHost) -> None:
    host.trial()
    with host.lock() as waits:
        host.first.do("answer", trial=0, value=1)
        assert waits.wait(30)
        closing = threading.Thread(target=host.manager.close)
        closing.start()
        _until(lambda: host.servo.off)
        assert closing.is_alive()
    closing.join(30)
    assert host.servo.calls[-1] == "close"


@pytest.mark.parametrize("state", ["consent", "running", "question", "break", "pause"])
def test_stop_holds_in_every_state_until_somebody_resumes(tmp_path: Path, state: str) -> None:
    rest = {"break": "break_every = 1\nbreak_seconds = 300", "pause": "pause_seconds = 300"}.get(state, "")
    study = STUDY.replace("pause_seconds = 0.0", rest or "pause_seconds = 0.0")
    if state == "question":
        study = study.replace("low = 0", 'when = "before"\nlow = 0')
    host = StudyHost(study_of(study), tmp_path / "s.db")
    try:
        host.experimenter.do("begin", code="P01")
        host.first.state("consent")
        if state != "consent":
            host.first.do("agree", agreed=True)
        if state in ("break", "pause"):
            host.first.state("running", 0)
            host.first.do("answer", trial=0, value=1)
        host.first.state(state)
        assert not host.servo.off
        host.second.do("stop")
        host.first.state("paused")
        assert host.servo.off
        host.first.do("agree", agreed=True)
        host.first.do("skip")
        host.experimenter.do("repeat")
        host.experimenter.do("engage")
        host.experimenter.until(lambda page: page.mistakes)
        assert host.servo.off
        assert host.manager.now == "paused"
        host.experimenter.do("resume")
        host.first.state(state)
        assert not host.servo.off
        after = ["pause", "resume", "repeat"] if state == "running" else ["pause", "resume"]
        _until(lambda: [kind for kind, _ in host.kinds()][-len(after) :] == after)
    finally:
        host.served.close()


def test_a_stop_while_the_device_starts_holds_once_it_runs(host: StudyHost, monkeypatch: pytest.MonkeyPatch) -> None:
    opening, go_on = threading.Event(), threading.Event()
    make = host.manager._start

    def start(recording: Path | None) -> Any:
        servo = make(recording)

        def open_() -> None:
            opening.set()
            assert go_on.wait(60)

        servo.open = open_
        return servo

    monkeypatch.setattr(host.manager, "_start", start)
    host.experimenter.do("begin", code="P01")
    assert opening.wait(30)
    host.first.do("stop")
    _until(lambda: host.servo.stops == 1)
    host.first.until(lambda page: page.view["state"] == "starting" and page.view["stopped"])
    go_on.set()
    host.first.state("paused")
    assert host.servo.off
    host.experimenter.do("resume")
    host.first.state("consent")
    assert not host.servo.off


def test_a_begin_that_was_asked_for_before_a_stop_begins_stopped(host: StudyHost) -> None:
    with host.lock() as waits:
        host.experimenter.do("begin", code="P01")
        assert waits.wait(30)
        assert not host.served.servos
        host.first.do("stop")
        host.first.do("nothing")
        host.first.until(lambda page: page.mistakes)
    host.first.state("paused")
    assert host.servo.off
    _until(lambda: host.kinds()[-1] == ("pause", "by the participant"))


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


def test_no_message_takes_stop_or_the_place_from_a_page(host: StudyHost) -> None:
    host.trial()
    for message in HOSTILE:
        for page in (host.first, host.second, host.experimenter):
            page.socket.send(message)
            page.socket.send(message.encode())
            page.do("stop")
            _until(lambda: host.servo.off, message)
            host.first.state("paused")
            host.experimenter.state("paused")
            host.experimenter.do("resume")
            host.first.state("running", 0)
            host.experimenter.state("running")  # else the next round takes this pause for its own
    host.first.close()
    host.second.until(lambda page: page.view["watching"] is False)
    host.experimenter.until(lambda page: page.view["pages"] == 1)
    host.experimenter.do("resume")
    host.second.state("running", 0)
    host.second.do("answer", trial=0, value=1)
    host.second.state("running", 1)


@pytest.mark.parametrize("who", ["first", "experimenter"])
def test_a_fault_that_a_message_meets_takes_no_stop_from_its_page(
    host: StudyHost, monkeypatch: pytest.MonkeyPatch, who: str
) -> None:
    host.trial()
    page = getattr(host, who)

    def fault(command: dict[str, Any], told: Any) -> None:
        raise ZeroDivisionError("nobody foresaw it")

    monkeypatch.setattr(host.manager, "enqueue", fault)
    page.do("skip")
    page.until(lambda page: any("ZeroDivisionError" in mistake for mistake in page.mistakes))
    page.do("stop")
    _until(lambda: host.servo.off)


def test_a_message_that_is_no_json_but_says_stop_stops(host: StudyHost) -> None:
    host.trial()
    host.first.socket.send('{"do" : "stop", "why": "\\ud800')
    _until(lambda: host.servo.off)


@pytest.mark.parametrize("who", ["first", "experimenter"])
@pytest.mark.parametrize("binary", [False, True])
def test_a_stop_may_be_spelled_with_escapes(host: StudyHost, who: str, binary: bool) -> None:
    host.trial()
    text = r'{"do": "\u0073top"}'
    getattr(host, who).socket.send(text.encode() if binary else text)
    _until(lambda: host.servo.off)


def test_a_pause_may_be_spelled_with_escapes(host: StudyHost) -> None:
    host.trial()
    host.experimenter.socket.send(r'{"do": "p\u0061use"}')
    _until(lambda: host.servo.off)


def test_replies_that_cannot_be_kept_are_refused_and_the_next_is_kept(host: StudyHost) -> None:
    host.trial()
    for trial in (0, 1):
        host.first.do("answer", trial=trial, value=1)
        host.first.until(lambda page, n=trial: page.view.get("trial", 0) > n or page.view["state"] == "question")
    host.first.do("reply", question="tired", reply="--5")
    host.first.do("reply", question="tired", reply="9" * 5000)
    host.first.do("reply", question="tired", reply=["4"])
    host.first.until(lambda page: len(page.mistakes) == 3)
    host.first.do("reply", question="tired", reply="4")
    host.first.until(lambda page: (page.view["question"] or {}).get("name") == "words")
    host.first.socket.send('{"do":"reply","question":"words","reply":"a\\ud800b"}')
    host.first.until(lambda page: len(page.mistakes) == 4)
    host.first.do("reply", question="words", reply="ä€🙂")
    host.first.state("done")


def test_the_thread_outlives_a_fault_that_nobody_foresaw(host: StudyHost) -> None:
    host.trial()

    def fault(name: str, values: Any = None) -> None:
        raise ZeroDivisionError("nobody foresaw \ud800")

    host.servo.set_world = fault
    host.first.do("answer", trial=0, value=1)
    host.first.until(lambda page: any("ZeroDivisionError" in mistake for mistake in page.mistakes))
    host.experimenter.state("failed")
    assert host.servo.off
    assert host.servo.calls[-1] == "close"
    _until(lambda: host.kinds()[-1][0] == "failed")
    host.experimenter.do("begin", code="P01")
    host.first.state("consent")
    host.first.do("agree", agreed=True)
    host.first.state("running", 1)


@pytest.mark.parametrize("end", ["leave", "abort"])
def test_the_end_of_a_session_does_not_stop_the_next_one_that_waits(
    end: str, host: StudyHost, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A slow database: the experimenter ends a session and begins the next one before the first has ended."""
    host.trial()
    step, waits, go = type(host.manager).step, threading.Event(), threading.Event()

    def wait(self: Any, seconds: float = 0.0) -> None:
        waits.set()
        go.wait(20)
        step(self, seconds)

    monkeypatch.setattr(type(host.manager), "step", wait)
    assert waits.wait(20)
    host.experimenter.do(end)
    host.experimenter.do("begin", code="P02")
    _until(lambda: host.manager._queue.qsize() == 2)
    go.set()
    host.experimenter.until(lambda page: page.view["code"] == "P02")
    host.experimenter.state("consent")
    assert len(host.served.servos) == 2
    assert host.served.servos[0].off
    assert not host.servo.off


def test_a_thread_that_dies_ends_the_server_with_the_coils_off(
    host: StudyHost, monkeypatch: pytest.MonkeyPatch
) -> None:
    host.trial()

    def die(wait: float = 0.0) -> None:
        raise SystemExit

    monkeypatch.setattr(type(host.manager), "step", lambda self, wait: die())
    host.experimenter.state("failed")
    assert "thread ended" in host.experimenter.view["trouble"]
    assert host.servo.off
    assert host.servo.calls[-1] == "close"
    host.experimenter._listening.join(30)
    host.first._listening.join(30)
    _until(lambda: host.served.failures)
    assert "enter the same code to continue" in str(host.served.failures[0])
    assert not host.experimenter._listening.is_alive()
    with pytest.raises(InputError, match="has failed"):
        host.manager.enqueue({"do": "begin", "code": "P02"}, print)


def test_what_a_locked_database_did_not_take_is_kept_later_in_order(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    other = database(tmp_path / "s.db")
    with StoredSession(engine, identify, "P01") as session:
        with engine.connect() as connection:
            connection.execute(text("PRAGMA busy_timeout = 10"))
        with other.connect() as connection:
            connection.execute(text("BEGIN EXCLUSIVE"))
            session.record_event("pause", "early", at="2026-01-01T00:00:00.000+00:00", later=True)
            session.record_event("resume", later=True)
            with pytest.raises(RecordingError, match="locked"):
                session.record_event("consent")
            connection.rollback()
        session.store_late_events()
        with other.connect() as connection:
            assert connection.execute(text("SELECT count(*) FROM events")).scalar_one() == 3, (
                "nothing else was kept yet"
            )
        session.record_event("repeat")
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
    halt.attach(servo, halt.read_count())
    with Keyboard(halt) as keys:
        os.write(typed, b"e" + key)
        _until(lambda: servo.off)
        assert keys.next_key(30) == "e"
        with pytest.raises(InputError, match="Stop was pressed"):
            halt.engage(keys.asked)  # type: ignore[arg-type]
        assert servo.off


def test_a_stop_while_a_session_starts_has_its_own_cause_though_the_one_before_was_stopped() -> None:
    first, second, halt = FakeServo(), FakeServo(), StopSwitch()
    halt.attach(first, halt.read_count())
    halt.stop(None)  # the experimenter leaves
    halt.detach()
    asked = halt.read_count()  # the next session is requested
    for why in ("the participant's page was closed", "by the experimenter"):
        halt.stop(why)
    halt.attach(second, asked)
    assert (halt.active, halt.why, second.off) == (True, "the participant's page was closed", True)
    assert [one.why for one in halt.pop_unrecorded()] == ["the participant's page was closed"]
    halt.detach()
    halt.attach(FakeServo(), halt.read_count())
    assert (halt.active, halt.why) == (False, "")


def test_space_is_a_letter_while_words_are_typed_and_escape_stops(typed: int) -> None:
    servo, halt = FakeServo(), StopSwitch()
    halt.attach(servo, halt.read_count())
    with Keyboard(halt, lambda: True) as keys:
        os.write(typed, b"a q")
        assert [keys.next_key(30) for _ in range(3)] == ["a", "space", "q"]
        assert not servo.off
        os.write(typed, b"\x1b[3~\x1b")
        _until(lambda: servo.off)
    assert name_keys("\x1b[A\x1bOB\x1b[1;5Cx") == ["up", "down", "x"]


def test_ctrl_c_stops_before_the_main_thread_hears_of_it(typed: int) -> None:
    servo, halt = FakeServo(), StopSwitch()
    halt.attach(servo, halt.read_count())
    before = signal.signal(signal.SIGINT, lambda number, frame: None)
    try:
        with Keyboard(halt):
            signal.raise_signal(signal.SIGINT)
            _until(lambda: servo.off)
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_page_that_asks_for_too_much_is_told_so_and_stops_all_the_same(host: StudyHost) -> None:
    host.trial()
    with host.lock() as waits:
        host.first.do("answer", trial=0, value=1)
        assert waits.wait(30)
        for _ in range(300):
            host.first.socket.send(json.dumps({"do": "skip"}))
        host.first.until(lambda page: any("too many" in mistake for mistake in page.mistakes))
        host.first.do("stop")
        _until(lambda: host.servo.off)
