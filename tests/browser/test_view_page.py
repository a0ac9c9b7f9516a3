"""A recording in a real browser: play, scrub and step; two recordings side by side; no servo needed."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from haptorb.recording.row import RowLayout
from haptorb.web.view import Viewer
from oracles.made_recording import TRIP, WORLD, make_recording

pytestmark = [pytest.mark.browser, pytest.mark.realtime(retry=False)]

LAYOUT = RowLayout(3, 9, 0, 32)


class Screen:
    """A page with the timeline, and the pages of recordings in it."""

    def __init__(self, page: Any, url: str) -> None:
        self.page = page
        self.troubles: list[str] = []
        page.on("pageerror", lambda mistake: self.troubles.append(str(mistake)))
        page.on("console", lambda line: self.troubles.append(line.text) if line.type == "error" else None)
        page.goto(url, timeout=60_000)
        self.until("window.timeline && [...document.querySelectorAll('iframe')].every("
                   "(one) => one.contentWindow.player?.shown.settled)")  # fmt: skip
        self.until("timeline.overview === 1")

    def tell(self, expression: str) -> Any:
        return self.page.evaluate(expression.replace("player", "document.querySelector('iframe').contentWindow.player"))

    def until(self, expression: str, seconds: float = 30.0) -> None:
        end = time.monotonic() + seconds
        while not self.page.evaluate(expression):
            assert time.monotonic() < end, f"never came true: {expression}; troubles {self.troubles}"
            self.page.wait_for_timeout(40)

    def settle(self, tick: int, recording: int = 0) -> None:
        """Wait until the page shows `tick`, with the plots before it."""
        shown = f"document.querySelectorAll('iframe')[{recording}].contentWindow.player.shown"
        self.until(f"{shown}.tick === {tick} && {shown}.settled")


@pytest.fixture
def played(browser: Any, tmp_path: Path) -> Iterator[Callable[..., tuple[Screen, np.ndarray]]]:
    """A function that shows recordings of so many seconds on a page, and the rows of the first."""
    ends = []

    def show(*seconds: float, width: int = 1280, height: int = 860, **options: Any) -> tuple[Screen, np.ndarray]:
        paths = [tmp_path / f"run-{number}.mcap" for number in range(len(seconds))]
        rows = [make_recording(path, long) for path, long in zip(paths, seconds, strict=True)]

        def push(name: str, values: Any, model: str, points: Any) -> Any:
            return np.full(len(points), values["moment"]), np.zeros(len(points), dtype=bool)

        viewer = Viewer(paths, 0, force_map=push, **options)
        ready = threading.Event()
        serving = threading.Thread(target=lambda: viewer.serve(ready=ready.set))
        serving.start()
        assert ready.wait(30)
        page = browser.new_page(viewport={"width": width, "height": height})
        ends.append((page, viewer, serving))
        return Screen(page, viewer.url), rows[0]

    yield show
    for page, viewer, serving in ends:
        page.close()
        with viewer:
            viewer.close()
            serving.join(10)


def test_keys_and_pointer_show_the_tick_and_its_numbers(played):
    screen, rows = played(3.0)
    page = screen.page
    assert page.locator("#slider").get_attribute("role") == "slider"
    page.focus("#slider")
    for key, tick in [
        ("ArrowRight", 1), ("ArrowRight", 2), ("ArrowLeft", 1), ("ArrowUp", 101), ("Shift+ArrowRight", 201),
        ("ArrowDown", 101), ("End", 2999), ("Home", 0), ("PageUp", 2999), ("PageDown", 0),
        ("]", TRIP), ("]", WORLD), ("[", TRIP),
    ]:  # fmt: skip
        page.keyboard.press(key)
        screen.settle(tick)
        np.testing.assert_allclose(screen.tell("player.value('p')"), rows[tick, LAYOUT["p"]], atol=1e-6)
        np.testing.assert_allclose(
            screen.tell("player.value('wrench_actual')"), rows[tick, LAYOUT["wrench_actual"]], atol=1e-6
        )
    # At the trip the page says what the guard had said, and nothing can be switched on.
    assert screen.tell("player.status") == "stopped"
    frame = page.frame_locator("iframe")
    assert "As recorded" in frame.locator("#alert").inner_text()
    assert frame.locator("#engage button").count() == 0
    for gone in ("#stop", "#reset", "#pause"):
        assert frame.locator(gone).is_hidden()
    for gone in ("#cool", "#sound", "#rumble"):
        assert frame.locator(gone).count() == 0
    assert frame.locator("#sliders input").first.is_disabled()
    assert frame.locator("#world").get_attribute("title").startswith("A recording")
    page.wait_for_timeout(300)
    assert f"tick {TRIP}" in page.locator("#slider").get_attribute("aria-valuetext")
    assert page.locator("#marks option").all_inner_texts()[1].endswith("Stopped by hand")

    # The map follows the world of the time.
    box = page.locator("#slider").bounding_box()
    page.mouse.click(box["x"] + 0.9 * box["width"], box["y"] + box["height"] / 2)
    screen.until("document.querySelector('iframe').contentWindow.player.forceAt([0, 0, 1]) === 1")
    assert screen.tell("player.shown.tick") == pytest.approx(0.9 * 2999, abs=6)
    screen.until("document.querySelector('iframe').contentWindow.player.samples > 2600")
    # A key acts from within the recording's page, too; there it is also told.
    frame.locator("#ask").click()
    assert "one tick back or forward" in frame.locator("#help").inner_text()
    assert not screen.troubles


def test_plays_at_its_speed_repeats_a_part_and_rests(played):
    screen, _ = played(3.0, span=(3.5, 4.0))  # on the loop's clock, which began at 3 s
    page = screen.page
    assert screen.tell("timeline.loop")
    assert screen.tell("timeline.time") == pytest.approx(0.5)
    page.select_option("#speed", "0.5")
    page.keyboard.press("Space")
    seen = []
    for _ in range(40):
        page.wait_for_timeout(50)
        seen.append(screen.tell("player.shown.t"))
    page.keyboard.press("Space")
    assert not screen.tell("timeline.playing")
    assert all(0.5 - 1e-6 <= t <= 1.03 for t in seen)
    assert min(np.diff(seen)) < -0.3  # it began again
    steps = np.diff(seen)
    assert len(np.unique(seen)) > 10
    assert np.median(steps[steps > 0]) < 0.2
    page.click("#loop")
    page.keyboard.press("End")
    page.click("#play")  # from the end it begins again
    screen.until("timeline.time > 0 && timeline.time < 2")
    assert not screen.troubles


def test_two_are_side_by_side_with_one_timeline_and_below_each_other_on_a_phone(played):
    screen, _ = played(3.0, 1.0, offset=0.5)
    page = screen.page
    screen.tell("timeline.go(1.2)")
    screen.settle(1200, 0)
    screen.settle(700, 1)
    page.fill("#offset", "-0.25")
    page.keyboard.press("Tab")
    screen.tell("timeline.go(0.6)")
    screen.settle(600, 0)
    screen.settle(850, 1)
    screen.tell("timeline.go(2.0)")  # the second has ended: its last tick stays
    screen.settle(2000, 0)
    screen.settle(999, 1)
    left, right = (one.bounding_box() for one in page.locator("iframe").all())
    assert left["x"] + left["width"] <= right["x"] + 1
    page.set_viewport_size({"width": 390, "height": 844})
    page.wait_for_timeout(300)
    above, below = (one.bounding_box() for one in page.locator("iframe").all())
    assert above["y"] + above["height"] <= below["y"] + 1
    assert above["width"] > 380
    assert not screen.troubles
