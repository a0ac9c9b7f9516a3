"""Server of the pages without a browser: access, content of each page, and stored data."""

from __future__ import annotations

import gzip
import importlib.util
import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import text
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from haptorb.control.trip_reasons import Trip
from haptorb.errors import InputError, RecordingError, ServoError
from haptorb.web.server import MAX_PAGES, PageAddress
from haptorb_study.columns import read_replies, tidy
from haptorb_study.database import database
from haptorb_study.pages.session_manager import SessionManager, try_step
from haptorb_study.pages.socket_hub import MAX_WAITING
from haptorb_study.pages.study_server import STATIC, StudyServer
from haptorb_study.study_file import Study, study_of

pytestmark = pytest.mark.realtime

STUDY = """
name = "short"
consent = "You may stop at any time."
[set_points]
points = [{ number = 1, theta_deg = 0 }, { number = 12, theta_deg = 36 }]
[trials]
repetitions = 1
pause_seconds = 0.0
[[questions]]
name = "tired"
text = "How tired are you, 0 to 10?"
low = 0
high = 10
"""


def _fake() -> Any:
    spec = importlib.util.spec_from_file_location("fake_servo", Path(__file__).parents[1] / "fake_servo.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.FakeServo()


class Page:
    """A page as the server sees it: a socket, and the newest of every event."""

    def __init__(self, url: str, token: str | None = None) -> None:
        self._stack = ExitStack()
        self.socket = self._stack.enter_context(connect(url, open_timeout=20))
        if token is not None:
            self.socket.send(token)
        self.about: dict[str, Any] = {}
        self.view: dict[str, Any] = {}
        self.pen: dict[str, Any] | None = None
        self.mistakes: list[str] = []
        self.heard: list[str] = []
        self._listening = threading.Thread(target=self._listen, daemon=True)
        self._listening.start()

    def _listen(self) -> None:
        try:
            for message in self.socket:
                self.heard.append(str(message))
                told = json.loads(message)
                match told["event"]:
                    case "about":
                        self.about = told
                    case "view":
                        self.view = told["is"]
                    case "pen":
                        self.pen = told["is"]
                    case "mistake":
                        self.mistakes.append(told["text"])
        except ConnectionClosed:
            return

    def do(self, command: str, **more: Any) -> None:
        self.socket.send(json.dumps({"do": command, **more}))

    def until(self, what: Callable[[Page], object]) -> None:
        end = time.monotonic() + 30
        while not what(self):
            assert time.monotonic() < end, (self.view, self.mistakes)
            time.sleep(0.01)

    def state(self, wanted: str, trial: int | None = None) -> None:
        self.until(lambda page: page.view.get("state") == wanted and trial in (None, page.view.get("trial")))

    def close(self) -> None:
        self._stack.close()
        self._listening.join(10)


class StudyHost:
    """A served study on an imagined servo."""

    def __init__(self, study: Study, place: Path, where: PageAddress = PageAddress()) -> None:
        self.place, self.study, self.servos = place, study, []
        self.engine = database(place)

        def start(recording: Path | None) -> Any:
            self.servos.append(_fake())
            return self.servos[-1]

        self.manager = SessionManager(self.engine, study, start, lambda session: Path(f"session-{session.id}.mcap"))
        self.host = StudyServer(self.manager, 0, more={"database": "here"}, where=where)
        self.failures: list[ServoError] = []  # with which the server ended by itself
        self._serving = threading.Thread(target=self._serve)
        self._serving.start()
        self._pages: list[Page] = []

    def _serve(self) -> None:
        try:
            self.host.serve()
        except ServoError as failure:
            self.failures.append(failure)

    @property
    def servo(self) -> Any:
        return self.servos[-1]

    @property
    def url(self) -> str:
        return self.host.participant.partition("#")[0]

    def participant(self, token: str | None = None) -> Page:
        return self._open("participant", self.host.participant, token)

    def experimenter(self, token: str | None = None) -> Page:
        return self._open("experimenter", self.host.experimenter, token)

    def _open(self, page: str, printed: str, token: str | None) -> Page:
        known = printed.partition("#")[2]
        self._pages.append(Page(self.url.replace("http", "ws") + f"ws/{page}", known if token is None else token))
        return self._pages[-1]

    def close(self) -> None:
        for page in self._pages:
            page.close()
        self.host.close()
        self._serving.join(20)
        self.host.__exit__(None, None, None)
        self.engine.dispose()
        assert not self._serving.is_alive()


@pytest.fixture
def host(tmp_path: Path) -> Iterator[StudyHost]:
    host = StudyHost(study_of(STUDY), tmp_path / "s.db")
    yield host
    host.close()


@pytest.fixture
def begun(host: StudyHost) -> tuple[StudyHost, Page, Page]:
    """P01 is in the first trial."""
    participant, experimenter = host.participant(), host.experimenter()
    experimenter.do("begin", code="P01")
    participant.state("consent")
    participant.do("agree", agreed=True)
    participant.state("running", 0)
    return host, participant, experimenter


def test_a_session_from_code_to_thanks(begun: tuple[StudyHost, Page, Page]) -> None:
    host, participant, experimenter = begun
    assert participant.about["consent"] == "You may stop at any time."
    participant.do("draft", value=12)
    experimenter.until(lambda page: page.view["draft"] == 12)
    participant.do("answer", trial=0, value=12)
    participant.state("running", 1)
    participant.do("answer", trial=1, value=1)
    participant.state("question")
    participant.do("reply", question="tired", reply="eleven")
    participant.until(lambda page: any("0 to 10" in mistake for mistake in page.mistakes))
    participant.do("reply", question="tired", reply="4")
    participant.state("done")
    columns = tidy(host.engine, host.study)
    assert columns["answer"].tolist() == [12, 1]
    assert columns["recording"][0].startswith("session-1.mcap#t=")
    assert read_replies(host.engine, host.study) == {"P01": {"tired": "4"}}
    prompted = [call[1] for call in host.servo.calls if call[0] == "dome"]
    assert prompted == [host.study.point(int(n)).direction for n in columns["set_point"]]
    experimenter.until(lambda page: host.servo.calls[-1] == "close")
    with host.engine.connect() as connection:
        kinds = connection.execute(text("SELECT kind FROM events ORDER BY id")).scalars().all()
        assert connection.execute(text("SELECT ended FROM sessions")).scalar_one()
    assert kinds == ["begin", "consent"]
    experimenter.do("begin", code="P01")
    experimenter.until(lambda page: any("another code" in mistake for mistake in page.mistakes))
    experimenter.until(lambda page: page.view["taken"])
    assert experimenter.view["taken"] == [{"code": "P01", "state": "finished", "answered": 2}]
    assert experimenter.view["free"] == "P02"
    assert not {"taken", "free"} & set(participant.view)
    experimenter.do("begin", code="P02")
    participant.state("consent")


def test_the_participants_page_is_never_told_what_is_prompted(begun: tuple[StudyHost, Page, Page]) -> None:
    _, participant, experimenter = begun
    experimenter.until(lambda page: page.view.get("prompt", {}).get("set_point"))
    participant.do("answer", trial=0, value=1)
    participant.state("running", 1)
    for message in participant.heard:
        told = json.loads(message)
        if told["event"] == "view":
            assert not {"prompt", "log", "set_point", "interval", "level", "condition", "code"} & set(told["is"])
            assert set(told["is"]["task"] or {}) <= {"kind", "ask", "numbers", "low", "high"}


def test_places_that_are_to_be_found_freely_are_not_drawn_for_the_participant(tmp_path: Path) -> None:
    host = StudyHost(
        study_of(STUDY.replace('name = "short"', 'name = "free"\nprocedure = "localisation"')), tmp_path / "s.db"
    )
    try:
        participant, experimenter = host.participant(), host.experimenter()
        participant.until(lambda page: page.about)
        experimenter.until(lambda page: page.about)
        assert participant.about["places"] == []
        assert [place["number"] for place in experimenter.about["places"]] == [1, 12]
        experimenter.do("begin", code="P01")
        participant.state("consent")
        participant.do("agree", agreed=True)
        participant.state("running", 0)
        participant.do("steer", x=0.0, y=36.0)
        participant.until(lambda page: host.servo.p[1] > 0.02)
        participant.do("answer", trial=0, value=None)
        participant.state("running", 1)
        columns = tidy(host.engine, host.study)
        assert columns["y_m"][0] == pytest.approx(0.05 * 0.5878, abs=1e-3)
        assert columns["distance_mm"][0] > 0
    finally:
        host.close()


@pytest.mark.parametrize("command", ["pause", "resume", "repeat", "engage", "leave", "abort", "begin"])
def test_a_participants_page_cannot_steer(begun: tuple[StudyHost, Page, Page], command: str) -> None:
    host, participant, _ = begun
    participant.do(command, code="P09")
    participant.until(lambda page: any("may not" in mistake for mistake in page.mistakes))
    assert host.manager.now == "running"
    assert not {"stop", "engage"} & {call for call in host.servo.calls if isinstance(call, str)}


@pytest.mark.parametrize("who", ["participant", "experimenter"])
@pytest.mark.parametrize("token", ["", "none", "x" * 22, '{"do": "abort"}', '{"do": "stop"}'])
def test_without_the_token_nobody_has_a_page(begun: tuple[StudyHost, Page, Page], who: str, token: str) -> None:
    """Other accounts of the computer reach the port, too: nothing is answered and nothing done."""
    host, _, _ = begun
    stranger = host.participant(token) if who == "participant" else host.experimenter(token)
    stranger._listening.join(10)
    assert not stranger.heard
    assert stranger.socket.close_code == 1008
    assert host.manager.now == "running"


def test_whoever_comes_before_the_participant_does_not_take_the_place(host: StudyHost) -> None:
    """A page without the token that is there first neither agrees nor answers, and the participant's page does."""
    with connect(host.url.replace("http", "ws") + "ws/participant", open_timeout=20) as stranger:
        participant, experimenter = host.participant(), host.experimenter()
        experimenter.do("begin", code="P01")
        participant.state("consent")
        assert not participant.view["watching"]
        stranger.send(json.dumps({"do": "agree", "agreed": True}))
        with pytest.raises(ConnectionClosed):
            stranger.recv(timeout=10)
        participant.do("stop")
        assert participant.view["state"] == "consent"


def test_connections_without_a_token_are_few_and_pages_have_a_number(host: StudyHost) -> None:
    url = host.url.replace("http", "ws") + "ws/participant"
    with ExitStack() as opened:
        waiting = [opened.enter_context(connect(url, open_timeout=20)) for _ in range(MAX_WAITING + 4)]
        for one in waiting[:4]:
            with pytest.raises(ConnectionClosed):
                one.recv(timeout=2.0)
    pages = [host.participant() for _ in range(MAX_PAGES)]
    pages[-1].until(lambda page: page.view)
    one_more = host.participant()
    one_more._listening.join(10)
    assert one_more.socket.close_code == 1013
    assert not one_more.heard


def test_pages_of_other_origins_get_403(host: StudyHost) -> None:
    for path in ("ws/participant", "ws/experimenter"):
        url = host.url.replace("http", "ws") + path
        with pytest.raises(InvalidStatus) as refused, connect(url, origin="http://evil.example"):  # type: ignore[arg-type]
            pass
        assert refused.value.response.status_code == 403
    assert httpx.get(host.url, headers={"host": "evil.example"}).status_code == 403


def test_the_token_is_in_no_file_that_is_served(host: StudyHost) -> None:
    tokens = [printed.split("#")[1] for printed in (host.host.participant, host.host.experimenter)]
    for path in ("", "experimenter", "static/experimenter.js", "static/participant.js", "static/study.css"):
        answer = httpx.get(host.url + path)
        assert answer.status_code == 200
        assert not any(token in answer.text for token in tokens)
    assert httpx.get(host.url + "static/../host.py").status_code == 404


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ({"do": "answer", "trial": 0, "value": 7}, "1, 12"),
        ({"do": "answer", "trial": 0, "value": None}, "choose the number"),
        ({"do": "answer", "trial": 0, "value": "12"}, "whole number"),
        ({"do": "answer", "trial": 0, "value": True}, "whole number"),
        ({"do": "steer", "x": "left", "y": 0}, "must be a number"),
        ({"do": "interval", "which": 2}, "no such interval"),
        ({"do": "interval", "which": "two"}, "interval"),
        ({"do": "interval"}, "interval"),
        ([], "JSON object"),
    ],
)
def test_bad_messages_are_told_and_change_nothing(
    begun: tuple[StudyHost, Page, Page], command: Any, words: str
) -> None:
    host, participant, _ = begun
    participant.socket.send(json.dumps(command))
    participant.until(lambda page: any(words in mistake for mistake in page.mistakes))
    participant.socket.send("not JSON")
    participant.until(lambda page: any("must be JSON" in mistake for mistake in page.mistakes))
    with pytest.raises(RecordingError, match="no answered trials"):
        tidy(host.engine, host.study)
    participant.do("answer", trial=0, value=1)
    participant.state("running", 1)


def test_a_second_click_does_not_answer_the_next_trial(begun: tuple[StudyHost, Page, Page]) -> None:
    host, participant, _ = begun
    for _ in range(5):
        participant.do("answer", trial=0, value=12)
    participant.state("running", 1)
    time.sleep(0.2)
    assert tidy(host.engine, host.study)["answer"].tolist() == [12]


def test_anyone_may_stop_but_only_the_experimenter_goes_on(begun: tuple[StudyHost, Page, Page]) -> None:
    host, participant, experimenter = begun
    participant.do("stop")
    participant.state("paused")
    assert host.servo.off
    participant.do("answer", trial=0, value=1)
    participant.until(lambda page: any("no answer is expected" in mistake for mistake in page.mistakes))
    experimenter.do("resume")
    participant.state("running", 0)
    assert not host.servo.off
    participant.do("answer", trial=0, value=1)
    participant.state("running", 1)
    assert tidy(host.engine, host.study)["safety"].tolist() == [""]


def test_a_closed_page_pauses_and_a_new_one_goes_on_there(begun: tuple[StudyHost, Page, Page]) -> None:
    host, participant, experimenter = begun
    participant.do("answer", trial=0, value=1)
    participant.state("running", 1)
    participant.close()
    experimenter.state("paused")
    assert host.servo.off
    again = host.participant()
    again.state("paused")
    experimenter.do("resume")
    again.state("running", 1)
    again.do("answer", trial=1, value=12)
    again.state("question")
    assert tidy(host.engine, host.study)["trial"].tolist() == [1, 2]


def test_a_second_participants_page_only_watches(begun: tuple[StudyHost, Page, Page]) -> None:
    host, participant, experimenter = begun
    second = host.participant()
    second.until(lambda page: page.view.get("watching"))
    second.do("answer", trial=0, value=1)
    second.until(lambda page: any("another participant's page" in mistake for mistake in page.mistakes))
    second.close()
    experimenter.until(lambda page: page.view["pages"] == 1)
    assert host.manager.now == "running"
    assert participant.view["trial"] == 0


def test_a_trip_is_shown_marked_and_left_to_the_experimenter(begun: tuple[StudyHost, Page, Page]) -> None:
    host, participant, experimenter = begun
    host.servo.trip(Trip.OVERHEATED)
    experimenter.until(lambda page: page.view.get("trips"))
    shown = experimenter.view["trips"][0]
    assert (shown["code"], shown["trial"]) == ("OVERHEATED", 0)
    assert shown["reason"] == Trip.OVERHEATED.text
    participant.state("device off", 0)
    participant.do("answer", trial=0, value=12)
    participant.until(lambda page: any("does not count" in mistake for mistake in page.mistakes))
    experimenter.do("engage")
    participant.state("running", 0)
    assert participant.view["repeats"] == 1
    participant.do("answer", trial=0, value=1)
    participant.state("running", 1)
    experimenter.until(lambda page: page.view["log"])
    assert experimenter.view["log"][0]["safety"] == ["OVERHEATED"]
    assert experimenter.view["log"][0]["repeats"] == 1
    columns = tidy(host.engine, host.study)
    assert [columns[name].tolist() for name in ("answer", "safety", "repeats")] == [[1], ["OVERHEATED"], [1]]
    with host.engine.connect() as connection:
        kept = connection.execute(text("SELECT trial, text FROM events WHERE kind = 'safety'")).all()
    assert len(kept) == 1
    assert kept[0].text.startswith("OVERHEATED")


def test_repeat_abort_and_leave(begun: tuple[StudyHost, Page, Page]) -> None:
    host, participant, experimenter = begun
    before = len([call for call in host.servo.calls if call[0] == "dome"])
    experimenter.do("repeat")
    experimenter.until(lambda page: len([t for t in host.servo.calls if t[0] == "dome"]) == before + 1)
    participant.do("answer", trial=0, value=1)
    participant.state("running", 1)
    experimenter.do("leave")
    participant.state("left")
    experimenter.do("begin", code="P01")
    participant.state("consent")
    assert participant.view["resumed"] is True
    participant.do("agree", agreed=True)
    participant.state("running", 1)
    experimenter.do("abort")
    participant.state("aborted")
    experimenter.do("begin", code="P01")
    experimenter.until(lambda page: any("aborted" in mistake for mistake in page.mistakes))
    assert tidy(host.engine, host.study)["trial"].tolist() == [1]


def test_who_does_not_agree_is_asked_nothing(host: StudyHost) -> None:
    participant, experimenter = host.participant(), host.experimenter()
    experimenter.do("begin", code="P01")
    participant.state("consent")
    participant.do("agree", agreed=False)
    participant.state("declined")
    assert participant.view["stored"] == 0
    experimenter.until(lambda page: [one["kind"] for one in page.view["incidents"]] == ["no consent"])
    assert host.servo.calls[-1] == "close"
    assert not [call for call in host.servo.calls if call[0] == "dome"]


def test_a_device_that_dies_ends_the_session_resumably(begun: tuple[StudyHost, Page, Page]) -> None:
    host, participant, experimenter = begun
    participant.do("answer", trial=0, value=1)
    participant.state("running", 1)
    host.servo.alive = False
    experimenter.state("failed")
    assert "pulled the plug" in experimenter.view["trouble"]
    experimenter.do("begin", code="P01")
    participant.state("consent")
    participant.do("agree", agreed=True)
    participant.state("running", 1)


@pytest.mark.parametrize("code", ["Anna", "", "../P1", "-01", "P01; DROP TABLE trials"])
def test_names_are_no_codes(host: StudyHost, code: str) -> None:
    experimenter = host.experimenter()
    experimenter.do("begin", code=code)
    experimenter.until(lambda page: any("never a name" in mistake for mistake in page.mistakes))
    assert not host.servos


def test_two_experimenters_are_two_pages_of_one_session(begun: tuple[StudyHost, Page, Page]) -> None:
    host, _, _ = begun
    second = host.experimenter()
    second.do("begin", code="P02")
    second.until(lambda page: any("end it first" in mistake for mistake in page.mistakes))
    other = StudyHost(host.study, host.place)
    try:
        page = other.experimenter()
        page.do("begin", code="P01")
        page.until(lambda page: any("another experimenter" in mistake for mistake in page.mistakes))
        assert not other.servos
    finally:
        other.close()


def test_a_taken_port_is_refused_before_anybody_sits_down(host: StudyHost) -> None:
    with pytest.raises(InputError, match="is in use"):
        StudyServer(host.manager, host.host.port)


def test_the_pages_are_small_and_fetch_nothing_from_elsewhere() -> None:
    files = [path for path in STATIC.iterdir() if path.suffix in (".js", ".css", ".html", ".svg")]
    assert {"participant.html", "experimenter.html"} <= {path.name for path in files}
    assert sum(len(gzip.compress(path.read_bytes())) for path in files) < 40_000
    for path in files:
        assert "https://" not in path.read_text(encoding="utf-8"), path.name


def test_a_step_that_fails_while_a_session_ends_is_reported_and_ends_nothing(capsys):
    def fail():
        raise OSError("disk is full")

    try_step(fail)
    assert "OSError: disk is full" in capsys.readouterr().err
