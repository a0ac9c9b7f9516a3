"""Access control: only this server's own page connects."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import httpx
import pytest
from starlette.datastructures import Headers
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from haptorb.web import server
from haptorb.web.access import AccessGate

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
    assert AccessGate.refusal(Headers(headers)) is None


@pytest.mark.parametrize(
    ("host", "origin"),
    [
        (OWN, "http://evil.example"),
        (OWN, "https://127.0.0.1:8765"),
        (OWN, "http://127.0.0.1:9999"),
        (OWN, "http://localhost:8765"),
        (OWN, "null"),
        (OWN, ""),
        (OWN, "http://["),
        (OWN, "http://[::1"),
        (OWN, "//"),
        (OWN, "http://\xff"),
        ("[", "http://["),
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
    assert AccessGate.refusal(Headers(headers)) is not None


def test_foreign_websocket_gets_403(console):
    with pytest.raises(InvalidStatus) as refused:
        connect(f"ws://127.0.0.1:{console.port}/ws", origin="http://evil.example")
    assert refused.value.response.status_code == 403


def test_an_origin_that_is_no_address_gets_403(console):
    answer = httpx.get(console.origin, headers={"origin": "http://["})
    assert answer.status_code == 403


STRANGER = """
import json, os, socket, sys
port, uid = int(sys.argv[1]), int(sys.argv[2])
if uid:
    os.setgid(uid)
    os.setuid(uid)
told = {"uid": os.getuid()}
def asked(path, more=""):
    with socket.socket() as one:
        one.settimeout(20)
        one.connect(("127.0.0.1", port))
        one.sendall(f"GET {path} HTTP/1.1\\r\\nHost: 127.0.0.1\\r\\n{more}\\r\\n".encode())
        one.sendall(b"\\x81\\x8e\\0\\0\\0\\0" + b'{"do": "stop"}')
        return int(one.recv(1000).split()[1])
for path in ("/", "/api/session", "/ws", "/nothing"):
    told[path] = asked(path)
upgrade = "Connection: Upgrade\\r\\nUpgrade: websocket\\r\\nSec-WebSocket-Version: 13\\r\\n"
upgrade += "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\\r\\n"
guess = "a-guess_of-22-letters0"
for shown in ("", f"Authorization: Bearer {guess}\\r\\n", f"Sec-WebSocket-Protocol: haptorb, token.{guess}\\r\\n"):
    told["socket " + shown] = asked("/ws", upgrade + shown)
print(json.dumps(told))
"""


def test_another_account_gets_the_empty_page_and_nothing_else(console, servo):
    """Without the token it can neither look nor drive; nor stop: that would let it end what others do."""
    nobody = 65534 if os.getuid() == 0 else 0  # who is not root cannot become another, and is one without the token
    done = subprocess.run(
        [sys.executable, "-c", STRANGER, str(console.port), str(nobody)],
        capture_output=True, text=True, timeout=60, cwd="/",
    )  # fmt: skip
    told = json.loads(done.stdout or done.stderr)
    assert told.pop("uid") == (nobody or os.getuid())
    assert told.pop("/") == 200
    assert set(told.values()) == {403}
    assert servo.calls == []


def test_the_address_says_the_token_where_no_server_hears_it(console):
    assert console.url == f"{console.origin}/#{console.token}"
    assert console.token not in httpx.get(console.url).text


def test_a_browser_is_sent_there_by_a_file_of_ones_own(console, monkeypatch):
    """What stands on a command line is everybody's to read."""
    opened = []

    def look(url):
        path = Path(url.removeprefix("file://"))
        opened.append((url, path.read_text(), path.parent.stat().st_mode & 0o077))

    monkeypatch.setattr(server.webbrowser, "open", look)
    monkeypatch.setattr(server, "_BROWSER_START_S", 0.0)
    server.open_browser_at(console.url)
    ((url, text, others),) = opened
    assert console.token not in url
    assert console.url in text
    assert others == 0
    assert not Path(url.removeprefix("file://")).exists()


def test_name_that_was_bent_to_this_computer_gets_403(console):
    shown = {"host": "evil.example", "authorization": f"Bearer {console.token}"}
    answer = httpx.get(f"{console.origin}/api/session", headers=shown)
    assert answer.status_code == 403
    assert "evil.example" in answer.text


def test_page_may_load_nothing_from_elsewhere(console):
    answer = httpx.get(console.origin)
    assert answer.status_code == 200
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "http" not in policy
    assert answer.headers["x-content-type-options"] == "nosniff"


def test_listens_on_this_computer_only(console):
    assert console._socket.getsockname()[0] == "127.0.0.1"
