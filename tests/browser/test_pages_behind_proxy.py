"""Other pages through HTTPS, below a path, and while the server is unreachable."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from browser.proxy import PREFIX, Proxy
from haptorb.web.server import PageAddress
from haptorb.web.view import Viewer
from haptorb_study.study_file import study_of
from oracles.made_recording import make_recording
from study.pages.test_pages import STUDY, StudyHost

pytestmark = [pytest.mark.browser, pytest.mark.realtime]
STATE = "window.study && study.view ? study.view.state : ''"


def wait_for(page: Any, expression: str, wanted: object, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while (found := page.evaluate(expression)) != wanted:
        assert time.monotonic() < end, (expression, found)
        page.wait_for_timeout(40)


@contextmanager
def open_page(browser: Any, url: str) -> Iterator[tuple[Any, list[str]]]:
    """The page at `url`, and what it asks for."""
    context = browser.new_context(ignore_https_errors=True)
    asked: list[str] = []
    page = context.new_page()
    page.on("request", lambda request: asked.append(request.url))
    page.on("websocket", lambda opened: asked.append(opened.url))
    page.goto(url, timeout=60_000)
    yield page, asked
    context.close()


@pytest.fixture
def serve_study(tmp_path: Path) -> Iterator[Callable[[PageAddress], StudyHost]]:
    hosts: list[StudyHost] = []

    def start(where: PageAddress) -> StudyHost:
        hosts.append(StudyHost(study_of(STUDY), tmp_path / "s.db", where))
        return hosts[-1]

    yield start
    for host in hosts:
        host.close()


@pytest.mark.parametrize("who", ["participant", pytest.param("experimenter", marks=pytest.mark.slow)])
def test_a_study_through_https_and_a_path(
    who: str, browser: Any, certificate: Path, serve_study: Callable[[PageAddress], StudyHost]
) -> None:
    proxy = Proxy(PREFIX, certificate)
    host = serve_study(PageAddress(address=f"https://127.0.0.1:{proxy.port}{PREFIX}/")).host
    proxy.target = host.port
    url = getattr(host, who)
    with open_page(browser, url) as (page, asked):
        wait_for(page, STATE, "waiting")
    place = f"127.0.0.1:{proxy.port}{PREFIX}/"
    assert all(one.split("//")[1].startswith(place) for one in asked if not one.startswith(("data:", "blob:")))
    assert f"wss://{place}ws/{who}" in asked
    assert all(url.partition("#")[2] not in one for one in asked)
    proxy.close()


def test_a_recording_through_https_and_a_path(browser: Any, certificate: Path, tmp_path: Path) -> None:
    make_recording(tmp_path / "run.mcap", 1.0)
    proxy = Proxy(PREFIX, certificate)
    where = PageAddress(address=f"https://127.0.0.1:{proxy.port}{PREFIX}/")
    with Viewer([tmp_path / "run.mcap"], 0, force_map=lambda *asked: paint_nothing(asked[-1]), where=where) as viewer:
        proxy.target = viewer.port
        serving = threading.Thread(target=viewer.serve)
        serving.start()
        with open_page(browser, viewer.url) as (page, asked):
            wait_for(page, "!!window.timeline && timeline.overview", 1)
            wait_for(page, "!!document.querySelector('iframe').contentWindow.player?.shown.settled", True)
        viewer.close()
        serving.join(10)
    place = f"127.0.0.1:{proxy.port}{PREFIX}/"
    asked = [one for one in asked if not one.startswith(("data:", "blob:"))]
    assert all(one.split("//")[1].startswith(place) for one in asked)
    assert any(one.startswith(f"wss://{place}ws?") for one in asked)
    assert all(viewer.token not in one for one in asked)
    proxy.close()


def paint_nothing(points: Any) -> Any:
    return np.zeros(len(points)), np.zeros(len(points), dtype=bool)


@pytest.mark.parametrize("who", ["participant", pytest.param("experimenter", marks=pytest.mark.slow)])
def test_a_study_that_is_slow_is_not_called_gone(
    who: str, browser: Any, serve_study: Callable[[PageAddress], StudyHost]
) -> None:
    proxy = Proxy("")
    host = serve_study(PageAddress()).host
    proxy.target = host.port
    url = getattr(host, who).replace(f":{host.port}/", f":{proxy.port}/")
    with open_page(browser, url) as (page, _):
        wait_for(page, STATE, "waiting")
        proxy.pause()
        wait_for(page, "document.body.innerText.includes('This page reconnects by itself.')", True)
        said = page.evaluate("document.body.innerText")
        assert "again" not in said.lower()
        assert "STOP" in said
        proxy.go_on()
        wait_for(page, STATE, "waiting")
        wait_for(page, "document.body.innerText.includes('No connection')", False)
    proxy.close()
