"""Attacks on a console in use: the reduced form of tests/fuzz/hostile_web.py."""

from __future__ import annotations

import importlib.util
import math
import struct
import threading
import time
from contextlib import suppress

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from haptorb.web import server
from haptorb.web.server import MAX_PAGES as PAGES

pytestmark = pytest.mark.realtime(retry=False)


@pytest.fixture
def hostile(root):
    spec = importlib.util.spec_from_file_location("hostile_web", root / "tests" / "fuzz" / "hostile_web.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_many_that_mean_no_good_take_neither_place_nor_control(console, servo, hostile, monkeypatch, capfd, caplog):
    monkeypatch.setattr(server, "MAX_LIFETIME_S", 1.0)
    at_once = []
    address = f"ws://127.0.0.1:{console.port}/ws"
    with connect(address, additional_headers={"Authorization": f"Bearer {console.token}"}, close_timeout=0.3) as page:
        over = threading.Event()

        def hold() -> None:
            while not over.wait(0.01):
                page.send(struct.pack("<9d", math.nan, 0.01, 0.0, 0.047, *[math.nan] * 4, 1.0))
                with suppress(RuntimeError):  # the set changed while it was copied
                    held = list(console._server.server_state.connections)
                    at_once.append(sum(not each.transport.is_closing() for each in held))

        def receive() -> None:
            with suppress(ConnectionClosed):
                for _ in page:
                    pass

        holding, hearing = threading.Thread(target=hold), threading.Thread(target=receive)
        holding.start()
        hearing.start()
        try:
            answers = hostile.attack(console.port, 400, 3.0, console.token, 100)
        finally:
            over.set()
            holding.join()
        assert sum(answers.values()) == 500
        assert max(at_once) <= 2 * server.MAX_CONNECTIONS + PAGES + 8
        assert not [call for call in servo.calls if call[0] in ("stop", "engage", "world", "release")]
        page.send('{"do": "engage"}')  # it still has the control
        end = time.monotonic() + 10
        while not servo.count("engage"):
            assert time.monotonic() < end
            time.sleep(0.01)
    hearing.join()
    assert "Traceback" not in capfd.readouterr().err
    assert not [record for record in caplog.records if record.name.startswith(("uvicorn", "asyncio"))]


def test_what_another_account_is_answered(console, servo, hostile):
    assert set(hostile.ask_without_token(console.port).values()) == {403}
    assert servo.calls == []
