"""`haptorb design show` as a user has it: a design is chosen by keyboard, its real servo starts with its coils off."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from oracles.designs.made_designs import make_results

pytestmark = [pytest.mark.browser, pytest.mark.realtime]

COMMAND = [sys.executable, "-c", "import sys; from haptorb.apps.cli import main; sys.exit(main())", "design", "show"]


@pytest.fixture
def program(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    results = make_results(tmp_path / "r.sqlite", 60)
    process = subprocess.Popen([*COMMAND, str(results), "--port", "0"], stderr=subprocess.PIPE, text=True)
    yield process
    if process.poll() is None:
        process.kill()
    process.communicate()


def _wait(page: Any, expression: str, seconds: float = 60.0) -> Any:
    for _ in range(int(seconds / 0.05)):
        if value := page.evaluate(expression):
            return value
        page.wait_for_timeout(50)
    raise AssertionError(f"never came true: {expression}; {page.evaluate('window.chooser')}")


def test_a_design_is_chosen_seen_and_felt_only_after_it_was_engaged(program: Any, browser: Any) -> None:
    assert program.stderr is not None
    line = program.stderr.readline()
    url = next(word for word in line.split() if word.startswith("http"))
    page = browser.new_page(viewport={"width": 1440, "height": 900})
    troubles: list[str] = []
    page.on("pageerror", lambda mistake: troubles.append(str(mistake)))
    page.goto(url)
    _wait(page, "window.chooser && chooser.now && chooser.now.state === 'none'")
    page.get_by_role("slider").focus()
    page.keyboard.press("Home")
    page.keyboard.press("Enter")
    row = page.evaluate("chooser.marked")
    first = _wait(page, "chooser.now.state === 'running' && chooser.now.url")
    frame = next(one for one in page.frames if one.url.startswith(first.partition("#")[0]))
    name = page.evaluate("document.querySelector('.numbers h3').textContent")
    for _ in range(600):
        if frame.evaluate("window.haptorb && haptorb.frames > 3 && haptorb.status") == "stopped":
            break
        page.wait_for_timeout(50)
    assert frame.evaluate("haptorb.status") == "stopped"
    assert name in frame.locator("header").inner_text()
    assert page.evaluate("chooser.now.row") == row
    assert name in page.locator("#state").inner_text()
    assert "SIMULATED" in page.locator("#state").inner_text()
    page.get_by_role("button", name="STOP").click()  # stays stopped
    for width in (820, 390):
        page.set_viewport_size({"width": width, "height": 900})
        page.wait_for_timeout(100)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        stop = page.locator("#stop").bounding_box()
        assert stop["y"] >= 0
        assert stop["y"] + stop["height"] <= 900
    assert not troubles
    page.close()
    os.kill(program.pid, signal.SIGINT)
    _, err = program.communicate(timeout=30)
    assert program.returncode == 130
    assert "Traceback" not in err
