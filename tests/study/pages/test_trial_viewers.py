"""Recordings of trials from the experimenter's page: each is played by a separate viewer."""

from __future__ import annotations

import http.client
import threading
import time
import urllib.request

import pytest

from haptorb.errors import InputError
from haptorb.web.server import PageAddress
from haptorb_study.pages.report_server import ReportServer
from haptorb_study.pages.trial_viewers import TrialViewers
from haptorb_study.study_file import study_of
from oracles.made_recording import make_recording
from study.pages.test_pages import STUDY, StudyHost


def wait_for(condition):
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.fixture
def viewers():
    viewers = TrialViewers()
    yield viewers
    viewers.close()


@pytest.mark.realtime(retry=False)
def test_a_trial_is_played_at_its_address_until_the_study_ends(viewers, tmp_path):
    path = tmp_path / "session-1-1.mcap"
    make_recording(path)
    part, mistakes = f"{path}#t=3.500,4.250", []
    viewers.open(part, mistakes.append)
    assert viewers.urls == {part: ""}  # it starts
    viewers.open(part, mistakes.append)  # once is enough
    wait_for(lambda: viewers.urls.get(part))
    url, _, token = viewers.urls[part].partition("#")
    request = urllib.request.Request(f"{url}api/view", headers={"authorization": f"Bearer {token}"})
    with urllib.request.urlopen(request, timeout=10) as answer:
        assert b'"range":[0.5,1.25]' in answer.read()
    viewers.close()
    assert viewers.urls == {}
    assert not mistakes
    viewers.open(part, mistakes.append)  # too late
    assert viewers.urls == {}


@pytest.mark.slow
@pytest.mark.realtime(retry=False)
def test_from_another_computer_the_experimenters_page_leads_to_a_player_that_answers_there(tmp_path):
    """127.0.0.2 is an address of this computer at which nothing listens unless it is asked to."""
    path = tmp_path / "session-1-1.mcap"
    make_recording(path)
    host, mistakes = StudyHost(study_of(STUDY), tmp_path / "s.db", PageAddress("127.0.0.2")), []
    try:
        viewers = host.host._viewers
        viewers.open(f"{path}#t=3.500,4.250", mistakes.append)
        wait_for(lambda: all(viewers.urls.values()))
        ((_, where),) = viewers.urls.items()
        url, _, token = where.partition("#")
        assert url.startswith("http://127.0.0.2:")
        request = urllib.request.Request(f"{url}api/view", headers={"authorization": f"Bearer {token}"})
        with urllib.request.urlopen(request, timeout=10) as answer:
            assert b'"range":[0.5,1.25]' in answer.read()
    finally:
        host.close()
    assert not mistakes


def test_behind_a_proxy_the_page_says_how_to_play_a_recording(tmp_path):
    path = tmp_path / "session-1-1.mcap"
    path.touch()
    viewers = TrialViewers(PageAddress(address="https://lab.example/study/"))
    with pytest.raises(InputError, match="haptorb view") as told:
        viewers.open(f"{path}#t=1,2", lambda text: None)
    assert f"{path}#t=1,2" in str(told.value)
    assert viewers.urls == {}


def test_a_recording_that_is_gone_is_refused(viewers, tmp_path):
    with pytest.raises(InputError, match=r"gone\.mcap"):
        viewers.open(str(tmp_path / "gone.mcap#t=1,2"), lambda text: None)


@pytest.mark.realtime(retry=False)
def test_the_report_leads_to_each_recording_and_says_why_one_cannot_be_played(tmp_path):
    good, bad = tmp_path / "session-1-1.mcap", tmp_path / "session-2-1.mcap"
    make_recording(good)
    bad.write_bytes(b"nothing of a recording")
    server = ReportServer("<a href='play/0'>", [f"{good}#t=3.5,4.25", f"{bad}#t=1,2", str(tmp_path / "gone.mcap")], 0)
    thread = threading.Thread(target=server.serve)
    thread.start()
    _, _, address, token, _ = server.url.split("/")

    def get(path):
        connection = http.client.HTTPConnection(address, timeout=20)
        connection.request("GET", path)
        answer = connection.getresponse()
        content = answer.read().decode()
        connection.close()
        return answer.status, answer.getheader("location"), content

    try:
        wait_for(lambda: get(f"/{token}/")[2] == "<a href='play/0'>")
        wait_for(lambda: get(f"/{token}/play/0")[0] == 303)
        assert "/#" in get(f"/{token}/play/0")[1]  # the viewer's address with its token
        wait_for(lambda: "not an MCAP file" in get(f"/{token}/play/1")[2])
        assert get(f"/{token}/play/2")[0] == 404
        assert get(f"/{token}/play/3")[0] == 404
        for path in ("/", "/guess/", "/guess/play/0"):
            assert get(path)[0] in (403, 404)
    finally:
        server.close()
        thread.join(20)
    assert not thread.is_alive()
