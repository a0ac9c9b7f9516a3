"""Page of a motor, end to end: drag the handle, feel the plug, change the mode, release, and stop."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from browser.screen_check import find_faults
from haptorb.control.trip_reasons import Trip
from haptorb.runtime.servo import Servo

pytestmark = [pytest.mark.browser, pytest.mark.realtime]


@pytest.fixture
def motor(open_servo: Any) -> Iterator[tuple[Any, Servo]]:
    """A running motor and its page."""
    with open_servo("pmsm", "outlet") as opened:
        yield opened


def pull(screen: Any, dx: float, steps: int = 15) -> None:
    """Take the handle's end and drag it aside by so many pixels."""
    x, y = screen.hold(1.0)
    for k in range(1, steps + 1):
        screen.page.mouse.move(x + dx * k / steps, y)
        screen.page.wait_for_timeout(20)
    screen.page.wait_for_timeout(600)


@pytest.mark.slow
def test_pull_the_plug_turn_it_and_stop(motor):
    screen, servo = motor
    page = screen.page
    assert page.get_by_text("drag the handle", exact=True).is_visible()
    screen.until("haptorb.control && haptorb.status === 'running'")
    assert page.get_by_role("button", name="translate").get_attribute("aria-pressed") == "true"
    assert page.locator("#coils tbody td").count() == 24

    # Tilting the handle pulls the plug; friction holds it back, a hook is bent open, and the hand feels a torque. (How
    # far the other hook is bent hangs on how far aside the guided motion had brought the plug.)
    known = "haptorb.value('object').every(Number.isFinite)"
    pull(screen, -140)  # all the way home, wherever the guided motion was
    screen.until(f"{known} && haptorb.plug().place[0] < 7.5e-3")
    page.mouse.up()
    home = screen.tell("haptorb.plug().place[0]")
    pull(screen, 40)
    screen.until(f"{known} && haptorb.plug().place[0] - {home} > 5e-4")
    # Looked at in one go: a hook may let go at the next look.
    bent = f"{known} && Math.max(...haptorb.plug().bent) > 1e-3"
    row = screen.until(f"{bent} ? {{object: haptorb.value('object'), drawn: haptorb.plug()}} : null")
    assert row["drawn"]["place"] == pytest.approx(row["object"], abs=1e-4)
    at = servo.layout
    _, rows = servo.rows(0)
    moved = rows[rows[:, at["mode"].start] == 1]
    torque = np.linalg.norm(moved[:, at["wrench_commanded"]][:, 3:], axis=1)
    assert np.percentile(torque, 98) > 0.1, "the pull of an outlet is about 0.23 N·m at the handle"
    assert (moved[:, at["wrench_commanded"]][:, :3] == 0).all(), "the bearing carries every force"
    page.mouse.up()

    # The other mode: the plug turns, and stays where it is.
    page.keyboard.press("r")
    screen.until(
        "haptorb.value('mode')[0] === 2 && haptorb.value('clutch_share')[1] === 1"
        " && haptorb.value('clutch_share')[0] === 0"
    )
    assert page.get_by_role("button", name="rotate").first.get_attribute("aria-pressed") == "true"
    before = screen.value("object")
    _, _, end = screen.tell("haptorb.stylus()")
    page.mouse.move(end["x"], end["y"])
    for _ in range(3):
        page.mouse.wheel(0, 100)
        page.wait_for_timeout(120)
    screen.until("Math.abs(haptorb.value('object_q')[2]) > 3e-3")
    assert screen.value("object") == pytest.approx(before, abs=1e-6)
    screen.until(
        "Math.abs(haptorb.value('wrench_commanded')[5]) > 0.005"
    )  # the hooks on a turned plug are felt in the spin

    # Let go while C is down: the handle turns back, the plug does not.
    page.locator("#target-scene").click(position={"x": 200, "y": 300})
    page.keyboard.down("c")
    screen.until("haptorb.value('engaged')[0] === 0 && haptorb.value('clutch_share').every((x) => x === 0)")
    screen.until("document.getElementById('clutch-word').textContent === 'released'")
    turned, handle = screen.value("object_q"), screen.value("q")
    for _ in range(3):
        page.keyboard.press("q")
        page.wait_for_timeout(120)
    screen.until(f"Math.abs(haptorb.value('q')[2] - {handle[2]}) > 0.02")
    assert screen.value("object_q") == pytest.approx(turned, abs=1e-6)
    page.keyboard.up("c")
    screen.until("haptorb.value('engaged')[0] === 1 && haptorb.value('clutch_share')[1] === 1")

    page.keyboard.press("t")
    screen.until("haptorb.value('mode')[0] === 1")

    page.keyboard.press("Space")
    screen.until("haptorb.status === 'stopped'")
    page.wait_for_timeout(300)
    assert screen.value("current_commanded") == [0.0] * 12
    assert max(map(abs, screen.value("current_measured"))) < 0.01
    assert servo.latest()[at["trip"].start] == Trip.STOPPED

    # STOP, the trip's text and both pictures' texts at every size; with 15 parameters the numbers stay in view.
    faults = find_faults(page, {"watching": "", "mistake": "Recording: the disk is full"})
    assert not faults, "\n".join(faults)
    assert page.locator(".slider").count() >= 15
    for width, height in ((900, 700), (1024, 768), (1280, 800), (1440, 900)):
        page.set_viewport_size({"width": width, "height": height})
        for number in ("#asked", "#tilt", "#coils tr:last-child td:last-child", "#remaining"):
            box = page.locator(number).bounding_box()
            assert box["y"] + box["height"] <= height, f"{number} is out of view at {width}×{height}"
    assert not screen.troubles
