"""Console of a device without a known scene: axes, a draggable marker for the mover, and its numbers."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from haptorb.devices.registry import REGISTERED, register
from haptorb.runtime.servo import Servo
from haptorb.web.console import Console

pytestmark = [pytest.mark.browser, pytest.mark.realtime]

RAIL = Path(__file__).parents[1] / "rail"


def module(path: Path) -> ModuleType:
    """What another folder's tests share."""
    spec = importlib.util.spec_from_file_location(f"kit_{path.parent.name}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def rail(browser: Any) -> Iterator[tuple[Any, Servo]]:
    """A running magnet on a rail, and its page."""
    home = module(Path(__file__).with_name("conftest.py"))
    kind = module(RAIL / "conftest.py").load_rail().RAIL
    register(kind)
    try:
        servo = Servo(RAIL / "rail.toml", record=False, rate=500.0)
        with Console(servo, 0) as console, servo, home.serve(console):
            page = browser.new_page(viewport=home.DESK)
            yield home.Screen(page, f"{console.origin}/?detail=least#{console.token}"), servo
            page.close()
    finally:
        del REGISTERED[kind.name]


def test_drag_the_marker_along_the_rail_and_stop(rail):
    screen, _ = rail
    page = screen.page
    assert page.get_by_text("drag the marker", exact=True).is_visible()
    screen.until("haptorb.control && haptorb.status === 'running'")
    assert page.locator("#coils tbody tr").count() == 2
    assert page.locator("dl.tool dt").all_text_contents() == ["x", "y", "z"]

    x, y = screen.hold(0.0)
    for k in range(1, 16):
        page.mouse.move(x - 8 * k, y)
        page.wait_for_timeout(20)
    screen.until("haptorb.value('wrench_actual')[0] > 0.05")  # the wall at x = 0 pushes back
    assert screen.value("hand_goal")[0] < screen.value("p")[0] < 0.0
    assert screen.value("p")[1:] == [0.0, 0.0]
    screen.until("haptorb.arrow")
    place = page.locator("#tilt").text_content()
    assert place.startswith("−"), place
    page.mouse.up()
    page.keyboard.press("Escape")
    screen.until("haptorb.status === 'stopped'")
    screen.until("haptorb.value('wrench_actual').every((x) => Math.abs(x) < 1e-3)")
    assert screen.troubles == []
