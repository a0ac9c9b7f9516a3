"""Without the token only the page's files are served."""

from __future__ import annotations

import asyncio

import pytest
from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse

from haptorb.errors import InputError
from haptorb.web.access import TOKEN, AccessGate, choose_token, is_authorized

KEY = "a-token_of-22-letters0"


def test_every_start_has_its_own(monkeypatch):
    monkeypatch.delenv(TOKEN, raising=False)
    assert choose_token() != choose_token()
    assert len(choose_token()) >= 16


def test_one_may_be_chosen(monkeypatch):
    monkeypatch.setenv(TOKEN, KEY)
    assert choose_token() == KEY


@pytest.mark.parametrize("given", ["short", "with a space in it at least", "with,comma-and-16-characters", "ä" * 20])
def test_what_cannot_be_one_is_refused(monkeypatch, given):
    monkeypatch.setenv(TOKEN, given)
    with pytest.raises(InputError, match="at least 16 letters"):
        choose_token()


@pytest.mark.parametrize(
    ("headers", "known"),
    [
        ({"authorization": f"Bearer {KEY}"}, True),
        ({"sec-websocket-protocol": f"haptorb, token.{KEY}"}, True),
        ({"sec-websocket-protocol": f"haptorb,token.{KEY}"}, True),
        ({}, False),
        ({"authorization": KEY}, False),
        ({"authorization": "Bearer "}, False),
        ({"authorization": f"Bearer {KEY}x"}, False),
        ({"authorization": "Bearer \xff"}, False),
        ({"sec-websocket-protocol": "haptorb, token."}, False),
        ({"sec-websocket-protocol": KEY}, False),
        ({"cookie": f"token={KEY}"}, False),
    ],
)
def test_where_it_is_shown(headers, known):
    assert is_authorized(Headers(headers), KEY) is known


@pytest.mark.parametrize("kind", ["http", "websocket"])
@pytest.mark.parametrize(
    ("path", "shown", "passes"),
    [
        ("/", "", True),
        ("/static/console.js", "", True),
        ("/api/session", "", False),
        ("/api/session", KEY, True),
        ("/ws", "", False),
        ("/ws", "another-token-of-22-le", False),
        ("/ws", KEY, True),
        ("/staticky", "", False),
        ("//", "", False),
    ],
)
def test_only_pages_and_their_files_are_open(kind, path, shown, passes):
    came = []

    async def answer(scope, receive, send):
        came.append(scope["path"])
        if kind == "http":
            await PlainTextResponse("in")(scope, receive, send)

    sent = []

    async def send(message):
        sent.append(message)

    async def receive():
        raise AssertionError("nobody reads")

    headers = [(b"host", b"127.0.0.1:8765")] + ([(b"authorization", f"Bearer {shown}".encode())] if shown else [])
    asyncio.run(AccessGate(answer, token=KEY)({"type": kind, "path": path, "headers": headers}, receive, send))
    assert bool(came) is passes
    if not passes:
        assert sent[0].get("status", 403) == 403
        assert "terminal printed" in str(sent)
