"""Foreign connections are closed soon, occupy no place, and are not reported."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
import time

import httpx
import pytest
from starlette.applications import Starlette
from starlette.responses import PlainTextResponse
from starlette.routing import Route, WebSocketRoute
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from haptorb.web import server as connection
from haptorb.web.server import bind_socket, configure, make_connections, server

pytestmark = pytest.mark.realtime(retry=False)


@pytest.fixture
def port(monkeypatch):
    """Of a server with an answer of a megabyte, and a socket that echoes; strangers may stay for half a second."""
    monkeypatch.setattr(connection, "MAX_LIFETIME_S", 0.5)

    async def large(request):
        return PlainTextResponse("x" * 1_000_000)

    async def echo(page):
        await page.accept()
        with contextlib.suppress(Exception):
            while True:
                await page.send_text(await page.receive_text())

    listening = bind_socket(0)
    serving = server(Starlette(routes=[Route("/", large), WebSocketRoute("/ws", echo)]))
    thread = threading.Thread(target=lambda: asyncio.run(serving.serve(sockets=[listening])))
    thread.start()
    while not serving.started:
        time.sleep(0.01)
    yield listening.getsockname()[1]
    serving.should_exit = True
    thread.join(10)
    listening.close()


def open_socket(port, words=b""):
    one = socket.create_connection(("127.0.0.1", port), timeout=10)
    one.sendall(words)
    return one


def is_ended(one):
    """Whether the server ends the connection; what it said until then is read away."""
    with contextlib.suppress(ConnectionResetError), one:
        while one.recv(65536):
            pass
    return True


HALF = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n"
UPGRADE = (
    b"GET /ws HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
    b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
)


@pytest.mark.parametrize(
    "words",
    [
        b"",
        HALF,
        b"\0\xff garbage \r\n\r\n",
        HALF + b"X: " + b"y" * 200_000,
        UPGRADE + b"".join(b"X-%d: y\r\n" % k for k in range(300)) + b"\r\n",
        UPGRADE + b"X: " + b"y" * 20_000 + b"\r\n\r\n",
        UPGRADE.replace(b"13", b"99") + b"\r\n",
        UPGRADE.replace(b"AAAAAAAAAAAAAAAAAAAAAA==", b"?") + b"\r\n",
    ],
)
def test_a_stranger_is_gone_soon_and_is_no_news(port, words, capfd, caplog):
    assert is_ended(open_socket(port, words))
    assert httpx.get(f"http://127.0.0.1:{port}/").status_code == 200
    assert "Traceback" not in capfd.readouterr().err
    assert not [record for record in caplog.records if record.name.startswith(("uvicorn", "asyncio"))]


@pytest.mark.parametrize(
    "frame",
    [
        b"\xff" * 100,
        b"\x81\x82\0\0\0\0\xff\xff",  # a text that is no Unicode
        b"\x82\xff" + b"\x7f" * 12,  # of exabytes
        b"\x81\x05hello",  # without a mask
    ],
)
def test_a_frame_that_is_none_ends_its_page_and_is_no_news(port, frame, capfd, caplog):
    one = open_socket(port, UPGRADE + b"\r\n")
    assert b" 101 " in one.recv(1000)
    one.sendall(frame)
    assert is_ended(one)
    assert "Traceback" not in capfd.readouterr().err
    assert not [record for record in caplog.records if record.name.startswith(("uvicorn", "asyncio"))]


def test_what_comes_together_with_a_handshake_is_not_lost(port):
    hello = b"\x81\x85\0\0\0\0hello"  # masked with zeros
    with open_socket(port, UPGRADE + b"\r\n" + hello) as one:
        found = b""
        while not found.endswith(b"\x81\x05hello"):
            more = one.recv(1000)
            assert more, found
            found += more


def test_a_connection_whose_life_is_renewed_lasts_while_it_asks_and_no_longer():
    async def app(scope, receive, send):
        await PlainTextResponse("here")(scope, receive, send)

    async def run():
        config = configure(app, life=0.5, renewed=True, lifespan="off")
        serving = await asyncio.get_running_loop().create_server(make_connections(config), "127.0.0.1", 0)
        host, number = serving.sockets[0].getsockname()
        (asking, writer), (trickling, other) = [await asyncio.open_connection(host, number) for _ in range(2)]
        begin, ended = time.monotonic(), 0.0
        for _ in range(10):
            writer.write(HALF + b"\r\n")
            assert b"200 OK" in await asking.readuntil(b"here")
            with contextlib.suppress(ConnectionError):
                other.write(b"G")
            await asyncio.sleep(0.1)
            if not ended and trickling.at_eof():
                ended = time.monotonic() - begin
        assert 0.4 < ended < 0.9
        assert await asyncio.wait_for(asking.read(), 5) == b""
        for one in (writer, other):
            one.close()
        serving.close()
        await asyncio.sleep(0.05)

    asyncio.run(run())


def test_who_never_reads_is_cut_off(port):
    one = open_socket(port, HALF + b"\r\n")
    one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    end = time.monotonic() + 20
    with one:
        while True:  # the server's end of it is gone when writing fails
            assert time.monotonic() < end
            try:
                one.send(b"x")
            except OSError:
                break
            time.sleep(0.05)


def test_many_silent_ones_take_nobodys_place(port):
    silent = [open_socket(port) for _ in range(3 * connection.MAX_CONNECTIONS)]
    assert httpx.get(f"http://127.0.0.1:{port}/").status_code == 200
    with connect(f"ws://127.0.0.1:{port}/ws") as page:
        more = [open_socket(port) for _ in range(3 * connection.MAX_CONNECTIONS)]
        time.sleep(1.0)  # longer than a stranger may stay: a page may
        page.send("still here")
        assert page.recv(timeout=10) == "still here"
    assert all(is_ended(one) for one in silent + more)


def test_what_is_too_large_ends_a_page_and_no_other(port):
    with connect(f"ws://127.0.0.1:{port}/ws") as page, connect(f"ws://127.0.0.1:{port}/ws") as other:
        page.send("x" * 100_000)
        with pytest.raises(ConnectionClosed):
            page.recv(timeout=10)
        other.send("here")
        assert other.recv(timeout=10) == "here"
