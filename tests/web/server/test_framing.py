"""Framing of pages by other pages: forbidden by default."""

import asyncio

import pytest

from haptorb.web.access import AccessGate


def _ask(**options):
    """The directives of the policy of an answer."""
    sent = []

    async def app(scope, receive, send):
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def send(message):
        sent.append(message)

    scope = {"type": "http", "path": "/", "headers": [(b"host", b"127.0.0.1:1")]}
    asyncio.run(AccessGate(app, **options)(scope, None, send))
    headers = dict(sent[0]["headers"])
    return dict(one.split(" ", 1) for one in headers[b"content-security-policy"].decode().split("; "))


@pytest.mark.parametrize(
    ("options", "ancestors", "frames"),
    [
        ({}, "'none'", None),
        ({"framed": True}, "'self'", "'self'"),
        ({"framed_by": "http://127.0.0.1:8764"}, "http://127.0.0.1:8764", None),
        ({"frames": "http://127.0.0.1:*"}, "'none'", "http://127.0.0.1:*"),
    ],
)
def test_frames_are_allowed_one_by_one(options, ancestors, frames):
    policy = _ask(**options)
    assert policy["frame-ancestors"] == ancestors
    assert policy.get("frame-src") == frames
    assert policy["default-src"] == "'none'"
