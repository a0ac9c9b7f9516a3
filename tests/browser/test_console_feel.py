"""Main use case, end to end: load the page, drag the stylus, read the dome's force, and stop."""

from __future__ import annotations

import math
import time
from contextlib import suppress

import numpy as np
import pytest

from haptorb.control.allocation import force_allocator
from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.simulation.force_map import force_map
from haptorb.worlds import Dome

pytestmark = [pytest.mark.browser, pytest.mark.realtime]

RIGHT = (math.sin(math.radians(62.0)), math.cos(math.radians(62.0)))  #: of the page's view, as it begins, in S


def tilt(p) -> float:
    return math.degrees(math.acos(p[2] / math.hypot(*p)))


def radial(force, p) -> float:
    return float(np.dot(force[:3], p) / np.linalg.norm(p))


def direction(degrees: float, azimuth: float = 30.0) -> list[float]:
    t, a = math.radians(degrees), math.radians(azimuth)
    return [math.sin(t) * math.cos(a), math.sin(t) * math.sin(a), math.cos(t)]


def axis_of(q) -> np.ndarray:
    """The mover's z axis for a quaternion."""
    x, y, z, w = q
    return np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])


def test_feel_the_dome_and_stop(live):
    screen, host = live
    page = screen.page
    assert page.get_by_text("SIMULATED", exact=True).is_visible()
    assert page.get_by_text("drag the stylus", exact=True).is_visible()
    screen.until("haptorb.status === 'running'")

    # The map is the one that the simulated device would really give: push inside θ1, pull beyond, nothing from θ2:
    # the core's own pull is compensated.
    screen.until("Number.isFinite(haptorb.forceAt([0, 0, 1]).force) && haptorb.forceAt([0, 0, 1]).force !== 0")
    device, dome = load("omni"), Dome()
    angles = (0.0, 10.0, 26.0, 36.0, 50.0, 58.0, 70.0)
    points = np.array([direction(angle) for angle in angles]) * device.contact_distance
    computed, _ = force_map(device, dome, points)
    painted = [screen.force_at(point) for point in points]
    assert painted == pytest.approx(computed, abs=0.06)  # the nearest vertex is up to 1.2° away
    assert painted[1] > 0.25
    assert painted[3] < -0.4
    assert painted[5] == pytest.approx(0.0, abs=0.01)

    # Drag it over to the other side: number, arrow and colour follow the law at the place where it gives way to.
    x, y = screen.hold()
    side = -1 if np.dot(screen.value("p")[:2], RIGHT) > 0 else 1
    x, y = drag(screen, x, y, side)
    screen.wait_until_still()
    expect_law(screen, device, dome)
    screen.until("haptorb.arrow")
    shown = float(page.locator("#asked").inner_text())
    assert shown == pytest.approx(np.linalg.norm(screen.value("wrench_commanded")[:3]), abs=0.02)
    before = screen.value("p")
    drag(screen, x, y, -side)
    screen.wait_until_still()
    expect_law(screen, device, dome)
    assert np.linalg.norm(np.subtract(before, screen.value("p"))) > 0.01

    # The paper's model instead of the exact one, while it is held.
    page.get_by_label("controller model").select_option("published")
    screen.until("haptorb.value('model')[0] === 2")
    screen.wait_until_still()
    expect_law(screen, device, dome)
    asked, given, p = (screen.value(name) for name in ("wrench_commanded", "wrench_actual", "p"))
    assert abs(radial(given, p) - radial(asked, p)) > 0.02

    # The pointer's goal and the stylus are two things: the hand is a spring, the gap is the force.
    gap = np.subtract(screen.value("hand_goal"), screen.value("p"))
    assert np.linalg.norm(gap) > 5e-4

    # Stop while it is held: nothing is asked any more, and what still flows is the sensor's noise.
    page.keyboard.press("Space")
    screen.until("haptorb.status === 'stopped'")
    page.wait_for_timeout(200)
    assert screen.value("current_commanded") == [0.0, 0.0, 0.0]
    assert max(map(abs, screen.value("current_measured"))) < 0.05
    assert host.latest("trip")[0] == Trip.STOPPED
    page.mouse.up()
    assert not screen.troubles


def drag(screen, x, y, side) -> tuple[float, float]:
    """Move the mouse from (x, y), where it holds the stylus, to one side, 1 for the right one, until the goal is 10 mm
    on that side of the dome's top, where the dome pulls; the mouse's place then. (The stylus that nobody holds slides
    about the dome: where a test takes it may be far in front of the top.)"""
    for _ in range(100):
        x += 4 * side
        screen.page.mouse.move(x, y)
        screen.page.wait_for_timeout(25)
        goal = screen.value("hand_goal")
        if side * np.dot(goal[:2], RIGHT) > 0.01 and 28.0 < tilt(goal) < 45.0:
            return x, y
    raise AssertionError(f"the stylus does not come there: {goal}")


def expect_law(screen, device, dome) -> None:
    row = screen.tell(
        "({p: haptorb.value('p'), q: haptorb.value('q'), asked: haptorb.value('wrench_commanded'), "
        "given: haptorb.value('wrench_actual')})"
    )
    state = State.at(row["p"], axis_of(row["q"]))
    expected = dome.for_device(device).wrench(state)
    assert row["asked"][:3] == pytest.approx(expected[:3], abs=0.02)
    given = np.array(row["asked"])
    if screen.value("model") == [2.0]:  # published: off by the size of coils and magnet and the core's pull
        currents = force_allocator(device).allocate(device.wrench_map(state, "published"), given).currents
        given = device.wrench_map(state, "exact").wrench(currents)
    assert radial(row["given"], row["p"]) == pytest.approx(radial(given, row["p"]), abs=0.05)


def move_to_middle(screen) -> None:
    """By keys, into the plane through the summit in which the keys left and right move the hand."""
    for _ in range(60):
        screen.page.keyboard.press("ArrowLeft")
        screen.page.keyboard.press("ArrowRight")
        screen.page.wait_for_timeout(100)
        near = float(np.dot(screen.value("hand_goal")[:2], (RIGHT[1], -RIGHT[0])))
        if abs(near) < 1e-3:
            return
        screen.page.keyboard.press(("Shift+" if abs(near) > 8e-3 else "") + ("ArrowUp" if near > 0 else "ArrowDown"))
    raise AssertionError(f"the hand does not come to the middle: {screen.value('hand_goal')}")


@pytest.mark.slow  # the law itself: tests/worlds
def test_radial_force_vanishes_at_theta_1_and_everything_from_theta_2(live):
    screen, host = live
    page = screen.page
    screen.until("haptorb.control && haptorb.status === 'running'")
    # A high dome may push the stylus round its summit; a low one, of the same shape, lets the hand pass over it.
    page.get_by_role("textbox", name="moment").fill("0.6")
    page.get_by_role("textbox", name="moment").press("Enter")
    screen.until("haptorb.forceAt([0, 0, 1]).force < 0.3")
    page.locator("#scene").focus()
    move_to_middle(screen)
    for _ in range(40):
        page.keyboard.press("Shift+ArrowRight")  # down one side, to the edge of the workspace
        page.wait_for_timeout(150)
        if tilt(screen.value("p")) > 55.0:
            break
    screen.wait_until_still()
    edge = screen.value("p")
    assert tilt(edge) > 54.5
    assert screen.value("wrench_commanded")[:3] == [0.0, 0.0, 0.0]
    cursor, _ = host.rows(0, "tick")
    page.wait_for_timeout(200)  # what is beyond the cut-off is to be seen too, however fast the hand then is
    parts = []
    for _ in range(60):
        page.keyboard.press("Shift+ArrowLeft")  # over the summit and down the other side
        page.wait_for_timeout(150)
        cursor, part = host.rows(cursor, "p", "wrench_commanded", "guard")
        parts.append(part)
        if tilt(part[0][-1]) > 55.0 and np.dot(part[0][-1, :2], edge[:2]) < 0:
            break
    p, asked, guard = (np.concatenate(column) for column in zip(*parts, strict=True))
    assert (guard == GuardState.RUNNING).all(), host.ask("trips")
    angles = np.degrees(np.arccos(p[:, 2] / np.linalg.norm(p, axis=1)))
    push = np.einsum("ij,ij->i", asked[:, :3], p)
    assert (push[angles < 17.8] > 0).all()
    assert (push[(angles > 18.2) & (angles < 53.8)] < 0).all()
    assert (asked[angles > 54.1] == 0).all()
    seen = {low: int(((angles > low) & (angles < high)).sum()) for low, high in ((0, 17), (19, 53), (54.2, 62))}
    assert min(seen.values()) > 50, (seen, float(angles.min()), float(angles.max()))


def test_stop_button_then_two_deliberate_steps(live):
    screen, host = live
    page = screen.page
    screen.until("haptorb.control && haptorb.status === 'running'")
    page.get_by_role("button", name="STOP").click()
    screen.until("haptorb.status === 'stopped'")
    page.get_by_role("alert").filter(has_text="Stopped by hand").wait_for(state="visible")  # a frame after the word
    assert page.get_by_role("button", name="Coils on now").count() == 0
    page.get_by_role("button", name="Re-engage").click()
    page.wait_for_timeout(300)
    assert screen.tell("haptorb.status") == "stopped", "one step is not enough"
    page.get_by_role("button", name="Coils on now").click()
    screen.until("haptorb.status === 'running'")
    assert host.latest("guard")[0] == GuardState.RUNNING


def test_escape_stops_even_while_typing(live):
    screen, _ = live
    screen.until("haptorb.control && haptorb.status === 'running'")
    screen.page.get_by_role("textbox", name="moment").focus()
    screen.page.keyboard.press("Escape")
    screen.until("haptorb.status === 'stopped'")


def test_sliders_act_at_once(live):
    screen, host = live
    page = screen.page
    screen.until("haptorb.control && haptorb.forceAt([0, 0, 1]).force > 0.2")
    moment = page.get_by_role("textbox", name="moment")
    moment.fill("-2")
    moment.press("Enter")
    screen.until("haptorb.forceAt([0, 0, 1]).force < -0.2")
    assert host.ask("world")[1]["moment"] == -2.0
    slider = page.get_by_role("slider", name="moment")
    slider.focus()
    slider.press("End")
    screen.until("haptorb.forceAt([0, 0, 1]).force > 0.5")
    assert host.ask("world")[1]["moment"] == pytest.approx(4.0)
    page.get_by_role("button", name="reset", exact=True).first.click()
    screen.until("Math.abs(haptorb.forceAt([0, 0, 1]).force - 0.59) < 0.08")
    tilted = page.get_by_role("textbox", name="summit tilt")
    tilted.fill("30")
    tilted.press("Enter")
    turned_to = page.get_by_role("textbox", name="summit azimuth")
    turned_to.fill("90")
    turned_to.press("Enter")
    screen.until("haptorb.forceAt([0, 0.5, 0.866]).force > 0.3")
    assert host.ask("world")[1]["summit"] == pytest.approx([0, 0.5, math.sqrt(0.75)], abs=1e-3)
    page.get_by_role("combobox", name="World").select_option("nothing")
    screen.until("Math.abs(haptorb.forceAt([0, 0, 1]).force) < 0.1")
    assert host.ask("world")[0] == "nothing"


def test_impossible_value_is_said_and_taken_back(live):
    screen, host = live
    screen.until("haptorb.control")
    cut = screen.page.get_by_role("textbox", name="cut off")
    cut.fill("6")
    cut.press("Enter")
    screen.page.get_by_role("alert").filter(has_text="must not be smaller").wait_for()
    assert host.ask("world")[1]["cut_off_deg"] == 54.0
    screen.until("document.getElementById('entry-cut_off_deg').value === '54'")


def test_page_that_goes_in_the_middle_of_a_drag_lets_go(live, browser):
    screen, host = live
    screen.until("haptorb.control && haptorb.status === 'running'")
    x, y = screen.hold()
    screen.page.mouse.move(x + 40, y)
    screen.page.wait_for_timeout(300)
    assert host.latest("guard")[0] == GuardState.RUNNING, host.ask("trips")
    with suppress(Exception):  # the page dies without a goodbye
        screen.page.goto("chrome://crash", timeout=3000)
    end = time.monotonic() + 20
    while host.latest("trip")[0] != Trip.POSE_EXPIRED:
        assert time.monotonic() < end, "the pose never expired"
        time.sleep(0.02)
    assert host.latest("guard")[0] == GuardState.TRIPPED
    time.sleep(0.2)
    assert host.latest("current_commanded") == [0.0, 0.0, 0.0]

    # Another page finds it tripped, says why, and can begin again.
    again = type(screen)(browser.new_page(), host.url)
    again.until("haptorb.status === 'tripped'")
    again.page.get_by_role("button", name="Re-engage").click()
    again.page.get_by_role("button", name="Coils on now").click()
    again.until("haptorb.status === 'running'")
    again.page.close()


def test_killed_servo_is_said_at_once(live):
    screen, host = live
    screen.until("haptorb.status === 'running'")
    host.ask("end servo")
    screen.until("['servo ended', 'disconnected'].includes(haptorb.status)")
    assert screen.page.locator("#given").inner_text() == "–"
