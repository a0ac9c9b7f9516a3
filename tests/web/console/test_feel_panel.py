"""A feel session over real sockets: one page rates, another observes and may stop; hidden designs stay hidden."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from websockets.sync.client import ClientConnection, connect

import haptorb_study.feel
from haptorb.web.console import Console
from haptorb_study.feel import FeelSession, load_designs
from haptorb_study.feel.live_session import FeelPanel, LiveSession

pytestmark = pytest.mark.realtime

EXAMPLE = Path(haptorb_study.feel.__file__).with_name("example.toml")


@pytest.fixture
def live(tmp_path: Path) -> LiveSession:
    session = FeelSession(tmp_path / "s", load_designs(EXAMPLE))
    return LiveSession(session, list(session.candidates.designs), person="P1", blind=True, seed=1)


@pytest.fixture
def console(servo: Any, live: LiveSession) -> Iterator[Console]:
    flat = lambda name, values, model, points: (0 * points[:, 0], points[:, 0] > 9)  # noqa: E731
    with Console(servo, 0, force_map=flat, designs=FeelPanel(live)) as console:
        serving = threading.Thread(target=console.serve)
        serving.start()
        yield console
        console.close()
        serving.join(10)


def join(console: Console) -> ClientConnection:
    headers = {"Authorization": f"Bearer {console.token}"}
    return connect(f"ws://127.0.0.1:{console.port}/ws", additional_headers=headers, close_timeout=0.3)


def receive(socket: ClientConnection, event: str, **wanted: Any) -> dict[str, Any]:
    """The next event of this kind that says what is wanted."""
    for _ in range(2000):
        message = socket.recv(timeout=10)
        if isinstance(message, str):
            told: dict[str, Any] = json.loads(message)
            if told["event"] == event and wanted.items() <= told.items():
                return told
    raise AssertionError(f"no '{event}' with {wanted}")


def test_one_page_rates_and_every_page_shows_it(console: Console, live: LiveSession, servo: Any) -> None:
    def do(socket: ClientConnection, **command: Any) -> None:
        socket.send(json.dumps({"do": "feel", **command}))

    headers = {"Authorization": f"Bearer {console.token}"}
    session = httpx.get(f"{console.origin}/api/session", headers=headers).json()
    assert session["feel"]["label"] == f"Design {session['feel']['number']}"
    assert session["world"]["values"] == {}
    assert session["world"]["scene"] is None
    with join(console) as first, join(console) as second:
        feeling = receive(first, "feel")["feeling"]
        receive(second, "role", control=False)
        do(second, act="rate", score=3, feeling=feeling)
        assert "another page is in control" in receive(second, "mistake")["text"]
        for wrong in (0, 8, "x"):
            do(first, act="rate", score=wrong, feeling=feeling)
            assert "whole number from 1 to 7" in receive(first, "mistake")["text"]
        do(first, act="rate", score=5, feeling=feeling)
        assert receive(second, "feel", score=5)["feeling"] == feeling
        receive(first, "feel", score=5)
        live.feel_next()  # in the terminal
        assert receive(first, "feel", score=None)["feeling"] != feeling
        do(first, act="rate", score=1, feeling=feeling)  # of what the page showed before
        assert "another design was chosen" in receive(first, "mistake")["text"]
        first.send(json.dumps({"do": "world", "name": "dome", "values": {}}))
        assert "Designs" in receive(first, "mistake")["text"]
        assert servo.count("world") == 0
        second.send(json.dumps({"do": "stop"}))
        receive(first, "stopped")
        do(first, act="finish")
        receive(second, "feel", finished=True)
