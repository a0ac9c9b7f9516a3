"""A drag on a busy computer: a pause of the mouse, of the page or of the processor trips no simulated device; a page
that hangs for longer, or is hidden, loses the mover."""

from __future__ import annotations

import importlib
import time
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

pytestmark = [pytest.mark.browser, pytest.mark.realtime]


@pytest.fixture
def benchmark_of_drags(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Found by the processes that it starts, too: they are given this one's path."""
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    return importlib.import_module("console_drag")


@pytest.mark.slow
def test_no_pose_trip_while_dragging_beside_a_busy_loop(benchmark_of_drags: ModuleType, browser: Any) -> None:
    # Poses last a second instead of 50 ms: the server's own pauses on an overloaded test machine are not tested here.
    found = benchmark_of_drags.measure(0.1, 1, "omni", browser, expiry=1.0)
    assert found["pose_trips"] == 0, found


def hang(page: Any, milliseconds: int) -> None:
    """The page's main thread does nothing else for so long."""
    page.evaluate(f"() => {{ const end = performance.now() + {milliseconds}; while (performance.now() < end); }}")


def points(fake: Any) -> int:
    return fake.count("point")


def test_a_page_that_hangs_is_bridged_for_a_second_and_no_longer(staged: Any, fake: Any) -> None:
    screen = staged(query="?detail=least")
    page = screen.page
    screen.until("haptorb.status === 'running' && haptorb.control")
    screen.hold()
    begun = points(fake)
    hang(page, 600)
    assert points(fake) - begun > 20, "the worker goes on without the page"
    page.evaluate("setTimeout(() => { const end = performance.now() + 4000; while (performance.now() < end); })")
    time.sleep(2.6)  # while it hangs
    before = points(fake)
    time.sleep(0.7)
    assert points(fake) == before, "nobody holds the mover for a page that hangs"


def test_a_hidden_page_lets_go_at_once(staged: Any, fake: Any) -> None:
    screen = staged(query="?detail=least")
    page = screen.page
    screen.until("haptorb.status === 'running' && haptorb.control")
    screen.hold()
    page.evaluate(
        "() => { Object.defineProperty(document, 'hidden', { get: () => true, configurable: true });"
        "document.dispatchEvent(new Event('visibilitychange')); }"
    )
    page.wait_for_timeout(200)
    assert page.locator("#scene.holding").count() == 0
    before = points(fake)
    page.wait_for_timeout(400)
    assert points(fake) == before


def test_what_is_waited_for_and_cooling_are_on_the_page(staged: Any, fake: Any) -> None:
    """The tracker's silence in words, in place of "off"; a button cools simulated coils."""
    from haptorb.control.trips import GuardState

    fake.guard, fake.missing_pose = GuardState.OFF, "waiting for a pose on OSC port 9109: 7 refused"
    screen = staged()
    screen.until("haptorb.status === 'no pose yet'")
    alert = screen.page.get_by_role("alert").filter(has_text="Waiting for a pose on OSC port 9109: 7 refused")
    alert.wait_for(state="visible")
    fake.guard, fake.missing_pose = GuardState.RUNNING, ""
    screen.until("haptorb.status === 'running' && haptorb.control")
    screen.page.get_by_role("button", name="cool coils").click()
    screen.wait_for(lambda: fake.count("cool") > 0)
    assert fake.count("cool") == 1


def expect_presses(screen: Any, fake: Any, *wanted: tuple[str, ...]) -> None:
    """Wait for as many changes of the buttons as are `wanted`, and compare."""

    def presses() -> list[tuple[str, ...]]:
        return [call[1] for call in fake.calls if call[0] == "press"]

    screen.wait_for(lambda: len(presses()) >= len(wanted), presses)
    assert presses() == list(wanted)


def test_programs_that_are_connected_are_on_the_page_and_see_its_buttons(staged: Any, fake: Any) -> None:
    """Who is connected, how often each asks and who commands; keys 1, 2, 3 are held down for them."""
    one = {"name": "teleoperator", "session": 1, "rate_hz": 812.4, "holds": True}
    two = {"name": "watcher", "session": 2, "rate_hz": 20.0, "holds": False}
    fake.connections = [
        {"server": "haply", "address": "ws://127.0.0.1:10001", "count": 2, "clients": [two, one], "dropped": 0}
    ]
    screen = staged()
    screen.until("haptorb.status === 'running' && haptorb.control")
    badge = screen.page.locator("#connected")
    badge.wait_for(state="visible")
    assert badge.inner_text() == "haply: 812 Hz teleoperator +1"
    title = badge.get_attribute("title") or ""
    assert "812 Hz teleoperator, commands" in title
    assert "20 Hz watcher, watches" in title
    screen.page.keyboard.down("1")
    screen.page.keyboard.down("3")
    screen.page.keyboard.up("1")
    screen.page.keyboard.up("3")
    expect_presses(screen, fake, ("a",), ("a", "c"), ("c",), ())
    fake.calls.clear()
    pen = "(type, kind, buttons) => dispatchEvent(new PointerEvent(type, { pointerType: kind, buttons }))"
    for event in (("pointermove", "mouse", 2), ("pointerdown", "pen", 1), ("pointermove", "pen", 3),
                  ("pointermove", "pen", 35), ("pointermove", "pen", 33), ("pointercancel", "pen", 33)):  # fmt: skip
        screen.page.evaluate(f"(event) => ({pen})(...event)", event)
    expect_presses(screen, fake, ("a",), ("a", "b"), ("b",), ())
