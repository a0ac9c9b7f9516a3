"""Texts and layout of the console's page: words for every state, names, sizes, typed values."""

from __future__ import annotations

import time

import numpy as np
import pytest

from haptorb.control.trip_reasons import CoilState, GuardState, Trip
from haptorb.runtime.trackers.pose_filter import describe_trip

pytestmark = [pytest.mark.browser, pytest.mark.realtime]

SIZES = [(1280, 800), (1920, 1080), (820, 1180)]


def test_nothing_comes_from_elsewhere_and_nothing_goes_wrong(shared):
    screen, _ = shared
    screen.page.wait_for_timeout(500)
    assert screen.requests
    assert all(request.startswith((screen.url, screen.url.replace("http", "ws"))) for request in screen.requests)
    assert not screen.troubles


def test_every_state_has_its_word_and_its_way_out(shared):
    screen, fake = shared
    page = screen.page
    screen.until("haptorb.status === 'running'")
    assert page.get_by_role("alert").first.is_hidden()
    fake.winding = np.array([303.0, 341.0, 300.0])
    screen.until("haptorb.status === 'warm'")
    alert = page.locator("#alert")  # drawn with the next frame
    screen.wait_for(lambda: "68 °C" in alert.inner_text(), alert.inner_text)
    fake.guard, fake.winding = GuardState.DERATED, np.array([303.0, 361.15, 300.0])
    screen.until("haptorb.status === 'derated'")
    screen.wait_for(lambda: "70 %" in alert.inner_text(), alert.inner_text)
    for trip in Trip:
        if trip in (Trip.NONE, Trip.CLOSING):
            continue
        fake.guard, fake.trip = GuardState.TRIPPED, trip
        wanted = "stopped" if trip is Trip.STOPPED else "tripped"
        screen.until(f"haptorb.status === '{wanted}' && haptorb.value('trip')[0] === {int(trip)}")
        words = describe_trip(trip, fake.tracker)
        screen.wait_for(lambda words=words: words in alert.inner_text(), alert.inner_text)
        assert page.get_by_role("button", name="Re-engage").is_visible()
    fake.guard, fake.trip = GuardState.OFF, Trip.NONE
    screen.until("haptorb.status === 'off'")
    fake.guard = GuardState.RUNNING
    fake.winding[:] = 300.0
    screen.until("haptorb.status === 'running'")
    fake.silent = True
    screen.until("haptorb.status === 'waiting'")
    screen.wait_for(lambda: page.locator("#asked").inner_text() == "–")


def test_coils_that_are_confirmed_off_again_are_no_longer_unknown(shared):
    screen, fake = shared
    fake.guard, fake.trip, fake.coils = GuardState.TRIPPED, Trip.DRIVER_FAILED, CoilState.UNKNOWN
    screen.until("haptorb.status === 'coil state unknown'")
    fake.coils = CoilState.OFF
    screen.until("haptorb.status === 'tripped' && !document.getElementById('unknown').checkVisibility()")


def test_second_step_of_engaging_must_follow_soon_and_can_be_taken_back(shared):
    screen, fake = shared
    page = screen.page
    screen.until("haptorb.control")
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Re-engage").click()
    page.get_by_role("button", name="Cancel").click()
    assert page.get_by_role("button", name="Coils on now").count() == 0
    page.get_by_role("button", name="Re-engage").click()
    page.keyboard.press("Space")
    page.wait_for_timeout(200)
    assert page.get_by_role("button", name="Coils on now").count() == 0, "a stop takes the first step back"
    page.get_by_role("button", name="Re-engage").click()
    page.wait_for_timeout(6500)
    assert page.get_by_role("button", name="Coils on now").count() == 0
    assert fake.count("engage") == 0


def test_everything_has_a_name_and_can_be_reached_by_tab(shared):
    screen, _ = shared
    unnamed = screen.tell(
        """[...document.querySelectorAll('button, input, select, canvas[tabindex], [role=application]')].filter(e =>
             !(e.getAttribute('aria-label') || e.textContent.trim() || (e.labels && e.labels.length)))
             .map(e => e.outerHTML)"""
    )
    assert unnamed == []
    screen.page.locator("body").click(position={"x": 5, "y": 5})
    reached = set()
    for _ in range(60):
        screen.page.keyboard.press("Tab")
        reached.add(screen.tell("document.activeElement.id || document.activeElement.ariaLabel || ''"))
    wanted = {"device", "world", "sound", "rumble", "ask", "stop", "scene", "reset", "pause", "span", "export"}
    assert wanted <= reached


def test_help_lists_the_keys(shared):
    screen, _ = shared
    screen.page.locator("#scene").focus()
    screen.page.keyboard.press("?")
    text = screen.page.get_by_role("dialog", name="Keys and mouse").inner_text()
    assert "STOP" in text
    assert "move the stylus" in text


def test_those_who_listen_get_values_and_alerts(shared):
    screen, fake = shared
    screen.until("document.getElementById('polite').textContent.includes('newton delivered')")
    assert screen.page.locator("#polite").get_attribute("aria-live") == "polite"
    fake.stop()
    screen.until("!document.getElementById('alert').hidden")
    assert screen.page.locator("#alert").get_attribute("role") == "alert"


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_nothing_is_cut_off_or_too_small_to_read(shared, width, height):
    screen, _ = shared
    screen.page.set_viewport_size({"width": width, "height": height})
    screen.until("!document.getElementById('legend').hidden")  # the map comes when its process has loaded
    screen.page.wait_for_timeout(300)
    small = screen.tell(
        """[...document.querySelectorAll('body *')].filter(e => e.checkVisibility() && !e.closest('.sr')
             && [...e.childNodes].some(n => n.nodeType === 3 && n.textContent.trim())
             && parseFloat(getComputedStyle(e).fontSize) < 14).map(e => e.outerHTML)"""
    )
    assert small == []
    assert screen.tell("document.documentElement.scrollWidth <= innerWidth")
    outside = screen.tell(
        """['#stop', '#state', '#loop', '#simulated', '#given', '#remaining', '#coils', '#export', '#legend', '#scale',
            '.camera'].filter(s => { const b = document.querySelector(s).getBoundingClientRect();
            return b.width === 0 || b.left < 0 || b.top < 0
                || b.right > innerWidth + 1 || b.bottom > innerHeight + 1 })"""
    )
    assert outside == []
    hidden = screen.tell(
        """['aside', '.panel.world', '.panel.readouts', 'header'].filter(s => { const e = document.querySelector(s);
            return e.scrollHeight > e.clientHeight + 1 || e.scrollWidth > e.clientWidth + 1 })"""
    )
    assert hidden == []


def test_another_controller_model_is_chosen_with_the_keyboard(shared):
    screen, fake = shared
    screen.until("haptorb.status === 'running'")
    choice = screen.page.get_by_label("controller model")
    assert choice.input_value() == "exact"
    choice.focus()
    screen.page.keyboard.press("ArrowDown")
    screen.page.wait_for_function("() => document.getElementById('polite').textContent.includes('published')")
    assert choice.input_value() == "published"
    screen.wait_for(lambda: fake.model == "published")


def test_sound_and_rumble_are_off_until_switched_on(shared):
    screen, _ = shared
    for name in ("Sound", "rumble"):
        button = screen.page.get_by_role("button", name=name)
        assert button.get_attribute("aria-pressed") == "false"
        button.click()
        assert button.get_attribute("aria-pressed") == "true"
    screen.page.wait_for_timeout(300)
    for name in ("Sound", "rumble"):
        screen.page.get_by_role("button", name=name).click()
    assert not screen.troubles


def test_follows_light_and_dark(shared):
    screen, _ = shared
    light = screen.tell("getComputedStyle(document.documentElement).backgroundColor")
    screen.page.emulate_media(color_scheme="dark")
    dark = screen.tell("getComputedStyle(document.documentElement).backgroundColor")
    assert light != dark
    assert not screen.troubles


def test_space_stops_whatever_has_the_focus_and_does_nothing_else(shared):
    screen, fake = shared
    page = screen.page
    for focus in ("body", "#stop", "#sound", "#world", "#scene", "input[type=range]", "#pause"):
        fake.engage()
        screen.until("haptorb.control && haptorb.status === 'running'")
        if focus != "body":
            page.locator(focus).first.focus()
            focused = f"document.activeElement === document.querySelector('{focus}')"
            assert screen.tell(focused), focus
        world = fake.world
        page.keyboard.press("Space")
        screen.until("haptorb.status === 'stopped'")
        assert fake.world == world, focus
        for button in ("#sound", "#pause"):
            assert page.locator(button).get_attribute("aria-pressed") == "false", focus


def test_late_word_of_a_change_does_not_undo_the_next(shared, monkeypatch):
    screen, fake = shared
    screen.until("haptorb.control && haptorb.status === 'running'")
    page, promptly = screen.page, fake.set_world

    def late(*change):
        time.sleep(0.6)
        promptly(*change)

    monkeypatch.setattr(fake, "set_world", late)
    for name, value, pause in (("moment", "2", 50), ("summit tilt", "30", 700), ("summit azimuth", "90", 0)):
        entry = page.get_by_role("textbox", name=name)
        entry.fill(value)
        entry.press("Enter")
        page.wait_for_timeout(pause)
    end = time.monotonic() + 10
    while fake.world[1]["summit"] != pytest.approx([0, 0.5, 0.75**0.5], abs=1e-3):
        assert time.monotonic() < end, fake.world
        page.wait_for_timeout(50)
