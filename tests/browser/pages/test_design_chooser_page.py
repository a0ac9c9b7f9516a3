"""Page of `haptorb design show`: choice by keyboard, and a console with coils off.

The servo is a fake; `tests/design/cli/test_show.py` starts a real one.
"""

from __future__ import annotations

import importlib.util
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from browser.proxy import PREFIX, Proxy
from haptorb.errors import InputError
from haptorb.web.console import Console
from haptorb.web.server import PageAddress
from haptorb_design import chooser as chooser_module
from haptorb_design.chooser import Chooser
from haptorb_design.results_table import ResultsTable
from haptorb_design.store import Results, Run
from oracles.designs.made_designs import make_design, make_evaluations

pytestmark = [pytest.mark.browser, pytest.mark.realtime]


def _paint_nothing(name: str, values: Any, model: str, points: Any) -> Any:
    """The force map; the process that paints it takes seconds to load."""
    return np.zeros(len(points)), np.zeros(len(points), dtype=bool)


def _imagine() -> Any:
    path = Path(__file__).parents[2] / "web" / "console" / "fake_servo.py"
    spec = importlib.util.spec_from_file_location("fake_servo", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)

    class ImaginedServo(module.FakeServo):  # type: ignore[misc]
        """Made, opened and closed as the real servo is."""

        made: ClassVar[list[Any]] = []

        def __init__(self, device: Any, record: bool) -> None:
            super().__init__()
            self.device, self.open = device, False
            ImaginedServo.made.append(self)

        def __enter__(self) -> Any:
            self.open = True
            return self

        def __exit__(self, *error: object) -> None:
            self.open = False

        def check(self) -> None:
            pass

        def check_end(self) -> None:
            pass

    return ImaginedServo


@pytest.fixture
def servos(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The servos that the chooser makes, as they come."""
    imagined = _imagine()
    monkeypatch.setattr(chooser_module, "Servo", imagined)
    monkeypatch.setattr(
        chooser_module, "Console", lambda servo, port, framed_by, where: Console(
            servo, port, force_map=_paint_nothing, framed_by=framed_by, where=where
        ),
    )  # fmt: skip
    made: list[Any] = imagined.made
    return made


@pytest.fixture
def chooser(servos: list[Any]) -> Iterator[Chooser]:
    with serve_chooser() as chooser:
        yield chooser
    assert not any(servo.open for servo in servos)


@contextmanager
def serve_chooser(**where: Any) -> Iterator[Chooser]:
    table = ResultsTable.of(Results(make_design(), (Run(1, "sobol", 1, {}, "", "", tuple(make_evaluations(60))),)))
    with Chooser(table, 0, **where) as chooser:
        serving = threading.Thread(target=chooser.serve)
        serving.start()
        yield chooser
        chooser.close()
        serving.join(10)


@pytest.fixture
def page(browser: Any, chooser: Chooser, kit: Any) -> Iterator[Any]:
    page = browser.new_page(viewport={"width": 1440, "height": 900})
    page.add_init_script(kit.QUARTER_RATE)
    troubles: list[str] = []
    page.on("pageerror", lambda mistake: troubles.append(str(mistake)))
    page.goto(chooser.url, timeout=60_000)
    _wait(page, page, "window.chooser && chooser.now && chooser.now.state === 'none'")
    yield page
    page.close()
    assert not troubles


def _wait(page: Any, frame: Any, expression: str, seconds: float = 60.0) -> Any:
    """Wait until it is true in `frame` of `page`. (The page's policy forbids Playwright's own way of waiting.)"""
    for _ in range(int(seconds / 0.05)):
        if value := frame.evaluate(expression):
            return value
        page.wait_for_timeout(50)
    raise AssertionError(f"never came true: {expression}; {page.evaluate('window.chooser')}")


def _find_frame(page: Any, url: str, seconds: float = 60.0) -> Any:
    """The frame of the console at `url`, once it is there."""
    for _ in range(int(seconds / 0.05)):
        for one in page.frames:
            if one.url.startswith(url.partition("#")[0]):
                return one
        page.wait_for_timeout(50)
    raise AssertionError(f"no frame shows {url}")


def test_a_design_is_chosen_seen_and_felt_only_after_it_was_engaged(page: Any, servos: list[Any]) -> None:
    page.get_by_role("slider").focus()
    page.keyboard.press("Home")
    page.keyboard.press("Enter")
    row = page.evaluate("chooser.marked")
    name = page.evaluate("document.querySelector('.numbers h3').textContent")
    first = _wait(page, page, "chooser.now.state === 'running' && chooser.now.url")
    frame = _find_frame(page, first)
    _wait(page, frame, "window.haptorb && haptorb.frames > 0 && haptorb.status === 'stopped'")
    assert name in frame.locator("header").inner_text()
    assert page.evaluate("chooser.now.row") == row
    assert name in page.locator("#state").inner_text()
    assert "SIMULATED" in page.locator("#state").inner_text()
    assert [servo.device.name for servo in servos] == [name]
    assert (servos[0].stops, servos[0].count("engage")) == (1, 0)
    page.get_by_role("button", name="STOP", exact=True).first.click()
    for width in (820, 390):
        page.set_viewport_size({"width": width, "height": 900})
        page.wait_for_timeout(100)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        stop = page.locator("#stop").bounding_box()
        assert stop["y"] >= 0
        assert stop["y"] + stop["height"] <= 900
    page.keyboard.press("Escape")
    for _ in range(200):
        if servos[0].stops == 3:
            return
        page.wait_for_timeout(20)
    raise AssertionError(servos[0].calls)


@pytest.mark.slow
def test_through_https_and_a_path_the_page_shows_the_console_through_another(
    servos: list[Any], browser: Any, certificate: Path
) -> None:
    page_proxy, console_proxy = Proxy(PREFIX, certificate), Proxy("/console", certificate)
    with socket.create_server(("127.0.0.1", 0)) as free:
        console_proxy.target = free.getsockname()[1]
    page_place = f"https://127.0.0.1:{page_proxy.port}{PREFIX}/"
    console_place = f"https://127.0.0.1:{console_proxy.port}/console/"
    with pytest.raises(InputError, match="--console-address"), serve_chooser(where=PageAddress(address=page_place)):
        pass
    where = {"where": PageAddress(address=page_place), "console_address": console_place}
    context = browser.new_context(ignore_https_errors=True)
    with serve_chooser(console_port=console_proxy.target, **where) as chooser:
        page_proxy.target = chooser.port
        assert chooser.url.startswith(f"{page_place}#")
        page = context.new_page()
        page.goto(chooser.url, timeout=60_000)
        _wait(page, page, "window.chooser && chooser.now && chooser.now.state === 'none'")
        page.locator("#feel").click()
        shown = _wait(page, page, "chooser.now.state === 'running' && chooser.now.url")
        assert shown.startswith(f"{console_place}#")
        frame = _find_frame(page, shown)
        _wait(page, frame, "window.haptorb && haptorb.frames > 0 && haptorb.status === 'stopped'")
        context.close()
    for proxy in (page_proxy, console_proxy):
        proxy.close()
