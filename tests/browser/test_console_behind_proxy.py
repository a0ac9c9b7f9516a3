"""Console through HTTPS, below a path, and at another port, as with nginx, JupyterHub or `ssh -L`."""

from __future__ import annotations

import os
import re
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from browser.proxy import PREFIX, Proxy
from haptorb.web.console import Console
from haptorb.web.server import PageAddress

pytestmark = [pytest.mark.browser, pytest.mark.realtime]

NGINX_PROGRAM = shutil.which("nginx") or shutil.which("nginx", path="/usr/sbin")


@pytest.fixture
def open_console(fake: Any, painting: Any) -> Iterator[Callable[[PageAddress], Console]]:
    opened: list[tuple[Console, threading.Thread]] = []

    def start(where: PageAddress) -> Console:
        console = Console(fake, 0, force_map=painting, where=where)
        serving = threading.Thread(target=console.serve)
        serving.start()
        opened.append((console, serving))
        return console

    yield start
    for console, serving in opened:
        console.close()
        serving.join(10)
        console.__exit__(None, None, None)


def count_frames(browser: Any, url: str) -> tuple[int, list[str]]:
    """Frames that the page at `url` shows, and what it asks for."""
    context = browser.new_context(ignore_https_errors=True)
    asked: list[str] = []
    try:
        page = context.new_page()
        page.on("request", lambda request: asked.append(request.url))
        page.on("websocket", lambda made: asked.append(made.url))
        page.goto(url)
        frames, end = 0, time.monotonic() + 60.0
        while frames <= 3 and time.monotonic() < end:
            page.wait_for_timeout(50)
            frames = int(page.evaluate("window.haptorb ? haptorb.frames : 0"))
        return frames, asked
    finally:
        context.close()


def test_https_and_a_path(browser: Any, certificate: Path, open_console: Callable[[PageAddress], Console]) -> None:
    proxy = Proxy(PREFIX, certificate)
    console = open_console(PageAddress(address=f"https://127.0.0.1:{proxy.port}{PREFIX}/"))
    proxy.target = console.port
    assert console.url.startswith(f"https://127.0.0.1:{proxy.port}{PREFIX}/#")
    frames, asked = count_frames(browser, console.url)
    assert frames > 3
    assert all(url.split("?")[0].split("//")[1].startswith(f"127.0.0.1:{proxy.port}{PREFIX}/") for url in asked)
    assert all(console.token not in url for url in asked)
    proxy.close()


NGINX = """
daemon off; pid nginx.pid; error_log stderr; {user}
events {{}}
http {{
    access_log off;
    client_body_temp_path body; proxy_temp_path proxy; fastcgi_temp_path f; uwsgi_temp_path u; scgi_temp_path s;
    server {{
        listen 127.0.0.1:{port} ssl;
        ssl_certificate {certificate}; ssl_certificate_key {certificate};
        {location}
    }}
}}
"""


@pytest.mark.skipif(NGINX_PROGRAM is None, reason="nginx is not installed (Debian: nginx-light)")
def test_nginx_as_the_page_says(
    browser: Any, certificate: Path, open_console: Callable[[PageAddress], Console], root: Path, tmp_path: Path
) -> None:
    page = (root / "docs" / "how-to" / "reach-the-page.md").read_text(encoding="utf-8")
    (location,) = re.findall(r"^location /haptorb/ \{.*?^\}", page, re.DOTALL | re.MULTILINE)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    console = open_console(PageAddress(address=f"https://127.0.0.1:{port}/haptorb/"))
    text = NGINX.format(
        port=port, certificate=certificate, location=location.replace("8765", str(console.port)),
        user="user root;" if os.geteuid() == 0 else "",
    )  # fmt: skip
    (tmp_path / "nginx.conf").write_text(text, encoding="utf-8")
    nginx = subprocess.Popen(
        [str(NGINX_PROGRAM), "-p", str(tmp_path), "-c", "nginx.conf"], stderr=subprocess.PIPE, text=True
    )
    try:
        frames, asked = count_frames(browser, console.url)
    finally:
        nginx.terminate()
        _, err = nginx.communicate(timeout=10)
    assert frames > 3, err
    assert any(url.startswith("wss:") for url in asked)


def test_another_port_of_this_computer(browser: Any, open_console: Callable[[PageAddress], Console]) -> None:
    """`ssh -L 9000:127.0.0.1:8765` needs no option."""
    proxy = Proxy("")
    console = open_console(PageAddress())
    proxy.target = console.port
    assert count_frames(browser, f"http://localhost:{proxy.port}/#{console.token}")[0] > 3
    proxy.close()


def test_a_server_that_is_slow_is_not_called_gone(browser: Any, open_console: Callable[[PageAddress], Console]) -> None:
    proxy = Proxy("")
    console = open_console(PageAddress())
    proxy.target = console.port
    page = browser.new_page()
    page.goto(f"http://localhost:{proxy.port}/#{console.token}")

    def wait_for(status: str) -> str:
        end = time.monotonic() + 60.0
        while (found := page.evaluate("window.haptorb ? haptorb.status : ''")) != status and time.monotonic() < end:
            page.wait_for_timeout(50)
        return str(found)

    assert wait_for("running") == "running"
    proxy.pause()
    assert wait_for("slow, retrying") == "slow, retrying"
    assert "retries by itself" in page.locator("#alert").inner_text()
    assert "start" not in page.locator("#alert").inner_text().lower()
    proxy.go_on()
    assert wait_for("running") == "running"
    page.close()
    proxy.close()
