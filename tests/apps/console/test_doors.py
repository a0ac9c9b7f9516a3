"""Nobody but this server's own page comes in."""

from __future__ import annotations

import httpx
import pytest
from starlette.datastructures import Headers
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from haptorb.apps.web.doors import Doors

OWN = "127.0.0.1:8765"


@pytest.mark.parametrize(
    ("host", "origin"),
    [
        (OWN, None),
        (OWN, f"http://{OWN}"),
        ("localhost:8765", "http://localhost:8765"),
        ("LOCALHOST:8765", "http://localhost:8765"),
        ("[::1]:8765", "http://[::1]:8765"),
        ("localhost.:8765", None),
    ],
)
def test_own_page_comes_in(host, origin):
    headers = {"host": host} | ({"origin": origin} if origin else {})
    assert Doors.refusal(Headers(headers)) is None


@pytest.mark.parametrize(
    ("host", "origin"),
    [
        (OWN, "http://evil.example"),
        (OWN, "https://127.0.0.1:8765"),
        (OWN, "http://127.0.0.1:9999"),
        (OWN, "http://localhost:8765"),
        (OWN, "null"),
        (OWN, ""),
        (OWN, "http://127.0.0.1:8765.evil.example"),
        ("evil.example", None),
        ("evil.example:8765", "http://evil.example:8765"),
        ("127.0.0.1.evil.example", None),
        ("", None),
        ("2130706433:8765", None),
    ],
)
def test_strangers_stay_outside(host, origin):
    headers = {"host": host} | ({"origin": origin} if origin is not None else {})
    assert Doors.refusal(Headers(headers)) is not None


def test_foreign_websocket_gets_403(console):
    with pytest.raises(InvalidStatus) as refused:
        connect(f"ws://127.0.0.1:{console.port}/ws", origin="http://evil.example")
    assert refused.value.response.status_code == 403


def test_name_that_was_bent_to_this_computer_gets_403(console):
    answer = httpx.get(console.url + "api/session", headers={"host": "evil.example"})
    assert answer.status_code == 403
    assert "evil.example" in answer.text


def test_page_may_load_nothing_from_elsewhere(console):
    answer = httpx.get(console.url)
    assert answer.status_code == 200
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "http" not in policy
    assert answer.headers["x-content-type-options"] == "nosniff"


def test_listens_on_this_computer_only(console):
    assert console._socket.getsockname()[0] == "127.0.0.1"
