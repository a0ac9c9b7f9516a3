"""Page of `examples/clients` in a real browser with the simulated Omni: its wall pushes the tool, as displayed."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from serve.served_run import ServedRun

CLIENTS = Path(__file__).resolve().parents[3] / "examples" / "clients"

#: the page answers as fast as it can, and so do servers: there would be little time left for a test's questions
PAUSE = """{
  const send = WebSocket.prototype.send;
  WebSocket.prototype.send = function (data) { setTimeout(() => send.call(this, data), 4); };
}"""

pytestmark = [pytest.mark.browser, pytest.mark.realtime]


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing."""


@pytest.fixture
def site() -> Iterator[str]:
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(CLIENTS))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://localhost:{server.server_port}"
        server.shutdown()


def test_the_wall_of_the_page_pushes_the_tool_back(browser: Any, site: str) -> None:
    with ServedRun("haply:0:0") as run:
        page = browser.new_page()
        page.add_init_script(PAUSE)
        troubles: list[str] = []
        page.on("pageerror", lambda mistake: troubles.append(str(mistake)))
        page.goto(f"{site}/wall.html?address=ws://localhost:{run.port('haply')}")
        page.wait_for_function("felt.answers > 50")
        assert page.evaluate("felt.force") == 0
        # The wall comes to the tool and beyond: it is pushed out, to the left.
        page.fill("#place", "-8")
        page.fill("#stiffness", "100")
        page.wait_for_function("felt.force < -0.1 && felt.place.x - felt.centre.x < -0.0005")
        page.wait_for_function("document.getElementById('status').textContent.includes('replies per second')")
        report = run.end()
        page.wait_for_function("!felt.connected")
        assert "No server" in page.inner_text("#status")
        page.close()
    assert report["peak_force_n"] > 0.1
    assert troubles == []
