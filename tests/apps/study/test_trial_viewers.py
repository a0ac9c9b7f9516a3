"""Recordings of trials from the experimenter's page: each is played by a viewer of its own."""

from __future__ import annotations

import time
import urllib.request

import pytest

from haptorb.apps.study.pages.trial_viewers import TrialViewers
from haptorb.errors import InputError
from oracles.made_recording import make_recording


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


def test_a_recording_that_is_gone_is_refused(viewers, tmp_path):
    with pytest.raises(InputError, match="not there any more"):
        viewers.open(str(tmp_path / "gone.mcap#t=1,2"), lambda text: None)


@pytest.mark.realtime(retry=False)
def test_a_viewer_that_cannot_start_says_why(viewers, tmp_path):
    path = tmp_path / "session-1-1.mcap"
    path.write_bytes(b"nothing of a recording")
    mistakes = []
    viewers.open(f"{path}#t=1,2", mistakes.append)
    wait_for(lambda: mistakes)
    assert "not an MCAP file" in mistakes[0]
    assert viewers.urls == {}
