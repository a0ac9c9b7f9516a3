"""A drag on a busy computer: a pause of the mouse, of the page or of the processor trips no simulated device; a page
that hangs for longer, or is hidden, loses the mover."""

from __future__ import annotations

import importlib
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from firmware.make_firmware import make_firmware
from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.runtime.drivers.emulator_process import Emulator

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
    fake.guard, fake.trip, fake.trip_program = GuardState.TRIPPED, Trip.OVERHEATED, "floor.py (process 7)"
    fake.connections = [
        {"server": "native", "address": "run", "count": 0, "clients": [], "dropped": 0, "programs": [
            {"name": "floor.py (process 7)", "session": 1, "start_s": 0.5, "end_s": 2.0, "end": "exited"}]}
    ]  # fmt: skip
    screen.until("document.getElementById('alert-text').innerText.includes('Program: floor.py (process 7).')")
    assert badge.inner_text() == "native: nobody (floor.py (process 7): exited)"
    assert "floor.py (process 7): commanded from 0.5 s to 2.0 s (exited)" in (badge.get_attribute("title") or "")
    fake.guard, fake.trip = GuardState.RUNNING, Trip.NONE
    screen.until("haptorb.status === 'running'")
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


PUSH = "import numpy as np\n\n\ndef push(state):\n    return np.array([0.0, 0.0, 0.3, 0.0, 0.0, 0.0])\n"


@pytest.mark.slow
def test_a_browser_that_is_killed_in_a_drag_leaves_no_current_in_a_boards_coils(tmp_path: Path, chromium: str) -> None:
    """The whole program on the emulated board; the pointer is the tool's tracker, and the browser gets SIGKILL."""
    built = make_firmware("all", "emulator")
    (tmp_path / "world.py").write_text(PUSH)
    errors = tmp_path / "errors"
    # In a process of its own: Playwright waits for its browser, and another test has one already.
    with Emulator(built, tmp_path / "board") as board, errors.open("wb") as said:
        board.set_pace(1.0)
        run = subprocess.Popen(
            [sys.executable, "-P", "-m", "haptorb", "run", "omni", "--driver", f"serial:{board.port}", "--tracker",
             "pointer", "--world", f"{tmp_path / 'world.py'}:push", "--port", "0"],
            stdout=subprocess.DEVNULL, stderr=said,
        )  # fmt: skip
        pages = []
        try:
            page = subprocess.Popen(
                [sys.executable, Path(__file__).with_name("dragging_browser.py"), chromium, wait_for_address(errors)],
                stdout=subprocess.PIPE, text=True,
            )  # fmt: skip
            pages.append(page)
            assert page.stdout is not None
            browser = int(page.stdout.readline())  # it holds the stylus now
            wait_until(lambda: board.status()["on"] == "1")
            time.sleep(0.5)
            assert board.status()["on"] == "1", errors.read_text()
            board.discard_lines()
            board.execute("mark")
            os.kill(browser, signal.SIGKILL)
            off = dict(re.findall(r"(\w+)=([-\d.]+)", board.expect_line("@off", 10.0)))
            assert float(off["since_mark_ms"]) < 350.0
            time.sleep(1.0)
            assert board.status()["on"] == "0", "what was lost stays off until a person engages"
        finally:
            for page in pages:
                page.kill()
                page.communicate()
            run.send_signal(signal.SIGINT)
            run.wait(30)


def wait_until(condition: Any, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def wait_for_address(errors: Path) -> str:
    """The page's address, as the program prints it."""
    found: list[str] = []
    wait_until(lambda: found.extend(re.findall(r"http://127\.0\.0\.1:\d+/#\S+", errors.read_text())) or found)
    return found[0]
