"""Console of `haptorb run planar`: every coil is drawn, and the tool at the servo's position."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from haptorb.devices.loader import load
from oracles.fork_server import get_fork_server

pytestmark = [pytest.mark.browser, pytest.mark.realtime]


@pytest.fixture
def url(tmp_path: Path) -> Iterator[str]:
    """The page of a running `planar`."""
    process = get_fork_server().start_haptorb(
        *("run", "planar", "--port", "0"), cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    assert process.stdout is not None
    try:
        for line in process.stdout:
            if found := [word for word in line.split() if word.startswith("http")]:
                yield found[0]
                break
        else:
            raise AssertionError("the program ended without a page")
    finally:
        os.kill(process.pid, signal.SIGINT)
        process.communicate(timeout=30)


def _wait(page: Any, expression: str, seconds: float = 60.0) -> Any:
    for _ in range(int(seconds / 0.05)):
        if value := page.evaluate(expression):
            return value
        page.wait_for_timeout(50)
    raise AssertionError(f"never came true: {expression}")


def test_all_coils_are_drawn_and_the_tool_follows_the_keys(url: str, browser: Any, kit: Any) -> None:
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    page.add_init_script(kit.QUARTER_RATE)
    troubles: list[str] = []
    page.on("pageerror", lambda mistake: troubles.append(str(mistake)))
    page.goto(url)
    _wait(page, "window.haptorb && haptorb.control && haptorb.status === 'running'")
    planar = load("planar")
    assert page.evaluate("haptorb.picture().coils") == planar.channels
    _wait(page, "haptorb.picture().mover.every(Number.isFinite)")
    start = page.evaluate("haptorb.picture().mover")
    assert start[2] >= planar.contact_height - 1e-3
    page.locator("#scene").focus()
    for _ in range(8):
        page.keyboard.press("Shift+ArrowRight")
    _wait(page, f"Math.hypot(haptorb.value('p')[0] - {start[0]}, haptorb.value('p')[1] - {start[1]}) > 0.01")
    _wait(page, f"Math.hypot(haptorb.picture().mover[0] - {start[0]}, haptorb.picture().mover[1] - {start[1]}) > 0.01")
    assert page.evaluate("haptorb.value('q')[3]") > 0.98  # the tool stands upright, wherever it is
    assert page.get_by_text("coil current, A").is_visible()
    assert troubles == []
    page.close()
