"""Server of the viewer: access, and replies; a real socket, no browser."""

from __future__ import annotations

import gzip
import json
import socket
import urllib.request
from urllib.error import HTTPError

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from haptorb.errors import InputError
from haptorb.web.view import STATIC, Viewer
from oracles.made_recording import make_recording


def fetch(viewer, path, token=None, **headers):
    """Status and content of an answer."""
    shown = {"authorization": f"Bearer {viewer.token if token is None else token}"}
    request = urllib.request.Request(f"http://127.0.0.1:{viewer.port}{path}", headers=shown | headers)
    try:
        with urllib.request.urlopen(request, timeout=10) as answer:
            return answer.status, answer.read()
    except HTTPError as mistake:
        return mistake.code, mistake.read()


def talk(viewer, recording="0", token=None):
    headers = {"authorization": f"Bearer {viewer.token if token is None else token}"}
    address = f"ws://127.0.0.1:{viewer.port}/ws?recording={recording}"
    return connect(address, additional_headers=headers, close_timeout=0.3, max_size=None)


def ask(line, **question):
    """The answer to a question: a frame's (kind, number of the question, first row, rows), or an event."""
    line.send(json.dumps(question))
    return receive(line)


def receive(line):
    message = line.recv(timeout=10)
    if isinstance(message, str):
        return json.loads(message)
    kind, _ = np.frombuffer(message[4:8], "<u2")
    count, width = np.frombuffer(message[8:16], "<u4")
    echo, dropped = np.frombuffer(message[32:48], "<f8")
    rows = np.frombuffer(message[48:], "<f4").reshape(count, width) if kind == 1 else None
    return int(kind), echo, dropped, rows


def test_only_who_knows_the_token_comes_in(viewer):
    assert fetch(viewer, "/", "no")[0] == 200  # the page alone says nothing
    assert fetch(viewer, "/api/view")[0] == 200
    for path in ("/api/view", "/api/session", "/api/overview"):
        assert fetch(viewer, path, "wrong-token-0123456")[0] == 403
        assert fetch(viewer, path, origin="http://evil.example")[0] == 403
    assert fetch(viewer, "/api/view", host="evil.example")[0] == 403
    with pytest.raises(InvalidStatus, match="403"):
        talk(viewer, token="wrong-token-0123456")


def test_pages_stand_in_frames_of_this_server_only(viewer):
    with urllib.request.urlopen(f"http://127.0.0.1:{viewer.port}/player") as answer:
        policy = answer.headers["content-security-policy"]
    assert "frame-ancestors 'self'" in policy
    assert "frame-ancestors 'none'" not in policy


def test_describes_the_recording(viewer):
    _, told = fetch(viewer, "/api/view")
    (one,) = json.loads(told)["recordings"]
    assert one["rows"] == 3000
    assert one["seconds"] == pytest.approx(2.999)
    assert fetch(viewer, "/api/session?recording=1")[0] == 404
    assert fetch(viewer, "/api/overview?recording=x")[0] == 404


def test_answers_with_the_rows_of_the_file(viewer, made):
    _, rows = made
    with talk(viewer) as line:
        assert receive(line)[0] == 2  # the dome, once
        kind, echo, first, found = ask(line, do="at", n=5, t=1.5)
        assert (kind, echo, first, len(found)) == (1, 5, 1500, 1)
        kind, echo, first, found = ask(line, do="rows", n=6, first=2990, count=100)
        assert (echo, first, len(found)) == (6, 2990, 10)
        event = ask(line, do="world", change=1, model="exact")
        assert event["event"] == "world"
        assert event["values"]["moment"] == 1.0
        assert receive(line)[0] == 3  # its force map
    assert len(rows) == 3000


@pytest.mark.parametrize(
    ("question", "words"),
    [
        ({"do": "rows", "n": 1, "first": 0, "count": 10**6}, "count"),
        ({"do": "rows", "n": 1, "first": "0", "count": 1}, "first"),
        ({"do": "at", "n": 1, "t": "now"}, "seconds"),
        ({"do": "at", "t": 1}, "`n`"),
        ({"do": "world", "change": 0, "model": "wrong"}, "model"),
        ({"do": "engage"}, "unknown command"),
        ({"do": 3}, "state its action"),
    ],
)
def test_a_wrong_question_gets_the_reason_and_the_next_one_an_answer(viewer, question, words):
    with talk(viewer) as line:
        receive(line)
        event = ask(line, **question)
        assert event["event"] == "mistake"
        assert words in event["text"]
        assert ask(line, do="at", n=2, t=-1e300)[2] == 0


def test_a_recording_that_there_is_not_closes_the_socket(viewer):
    with talk(viewer, "7") as line, pytest.raises(ConnectionClosed):
        line.recv(timeout=5)


def test_a_port_in_use_and_wrong_numbers_of_recordings_are_refused(made):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        with pytest.raises(InputError, match="is in use"):
            Viewer([made[0]], other.getsockname()[1])
    with pytest.raises(InputError, match="one or two"):
        Viewer([made[0]] * 3, 0)


def test_a_part_is_on_the_loops_clock_and_must_be_in_the_recording(made, tmp_path):
    with Viewer([made[0]], 0, span=(4.0, 5.0)) as viewer:
        assert viewer.opening["range"] == pytest.approx((1.0, 2.0))
        assert viewer.opening["at"] == pytest.approx(1.0)
    with pytest.raises(InputError, match="has no ticks from 90 s"):
        Viewer([made[0]], 0, span=(90.0, 91.0))
    other = tmp_path / "other.mcap"
    make_recording(other, 0.2)
    with Viewer([made[0], other], 0, offset=0.5, at=0.1) as viewer:
        assert [one.name for one in viewer.recordings] == ["made.mcap", "other.mcap"]
        assert viewer.opening == {"at": 0.1, "range": None, "offset": 0.5}


def test_each_page_is_small():
    sizes = {path.name: len(gzip.compress(path.read_bytes(), 9)) for path in STATIC.glob("*.*")}
    player = sum(size for name, size in sizes.items() if name.startswith("player"))
    assert 50_000 < player < 200_000  # as the console's own page
    assert sum(size for name, size in sizes.items() if name.startswith("view")) < 15_000
