"""STOP is fully visible at every size and with every badge; no safety message or number is covered."""

from __future__ import annotations

import numpy as np
import pytest

from browser.screen_check import find_faults
from haptorb.control.trip_reasons import CoilState, GuardState, Trip

pytestmark = [pytest.mark.browser, pytest.mark.realtime(retry=False)]

#: what comes and goes by itself, shown at each look
NOTES = {
    "watching": "",
    "mistake": "Recording: the disk is full, 12 s are lost; the tracker refused 3 poses of another sender",
    "dropped": "12345 samples not shown: this page was too slow",
}
SMALL = [(640, 400), (844, 390), (390, 844)]


@pytest.mark.timeout(400)
def test_stop_is_whole_and_no_text_lies_over_another(shared):
    """With every badge, at every size: while it runs, derated, tripped, and with coils whose state is unknown."""
    screen, fake = shared
    fake.recording_trouble, fake.warning = "the disk is full", "the tracker refused 3 poses"
    page = screen.page
    screen.until("haptorb.status === 'running' && haptorb.value('p')[2] > 0 && haptorb.control")
    screen.until("!document.getElementById('legend').hidden && !document.getElementById('hint').hidden")
    screen.until("document.getElementById('loop').textContent.includes('not\u00a0recording')")
    for part in ("#simulated", "#arrows", "#scale", "#detail", "#view .camera", "#model"):
        assert page.locator(part).is_visible(), part
    faults = find_faults(page, NOTES)
    fake.guard, fake.winding = GuardState.DERATED, np.array([322.0, 361.0, 311.0])
    screen.until("haptorb.status === 'derated'")
    faults += find_faults(page, NOTES)
    fake.guard, fake.trip = GuardState.TRIPPED, Trip.POSE_EXPIRED
    screen.until("haptorb.status === 'tripped'")
    page.get_by_role("button", name="Re-engage").click()
    page.emulate_media(color_scheme="dark")
    faults += find_faults(page, NOTES)
    fake.coils = CoilState.UNKNOWN
    screen.until("haptorb.status === 'coil state unknown'")
    faults += find_faults(page, NOTES)
    assert not faults, "\n".join(faults)


def test_stop_works_beside_an_open_dialog(shared):
    screen, fake = shared
    page = screen.page
    screen.until("haptorb.control")
    for button in ("#ask", "#device"):
        page.locator(button).click()
        assert page.locator("dialog[open]").count() == 1
        faults = [fault for fault in find_faults(page, sizes=SMALL) if ": faults:" in fault]
        assert not faults, "\n".join(faults)
    page.locator("#stop").click()
    screen.until("haptorb.status === 'stopped'")
    page.get_by_role("button", name="Close").click()
    assert page.locator("dialog[open]").count() == 0
    page.locator("#ask").click()
    stops = fake.stops
    page.keyboard.press("Escape")
    assert page.locator("dialog[open]").count() == 0
    screen.wait_for(lambda: fake.stops > stops, lambda: "Escape closed the dialog without a stop")


#: what lies over the reason of a trip and its button, if anything
COVERED = """["#alert-text", "#engage button"].flatMap((part) => {
  const { left, top, right, bottom } = document.querySelector(part).getBoundingClientRect();
  return [[left + 8, top + 4], [(left + right) / 2, (top + bottom) / 2], [right - 8, bottom - 4]]
    .map(([x, y]) => document.elementFromPoint(x, y))
    .filter((over) => over === null || over.closest("#alert") === null)
    .map((over) => `${part} lies under ${over && (over.id || over.tagName)}`);
})"""


def test_a_trip_is_read_beside_an_open_dialog(shared):
    """The reason and the way back stay free; the dialog can be scrolled and closed."""
    screen, fake = shared
    page = screen.page
    screen.until("haptorb.status === 'running' && haptorb.control")
    page.locator("#ask").click()
    fake.guard, fake.trip = GuardState.TRIPPED, Trip.POSE_EXPIRED
    screen.until("haptorb.status === 'tripped'")
    screen.until("document.getElementById('hint').hidden")  # from the next frame on
    faults = []
    for width, height in [*SMALL, (820, 1180), (1440, 900)]:
        page.set_viewport_size({"width": width, "height": height})
        page.wait_for_timeout(400)  # the dialog makes room ten times a second
        faults += [f"{width}×{height}: {fault}" for fault in page.evaluate(COVERED)]
        assert page.locator("#help").bounding_box()["height"] > 90
    assert not faults, "\n".join(faults)
    page.get_by_role("button", name="Close").click()
    assert page.locator("dialog[open]").count() == 0


def test_forced_colours_keep_what_colours_mean(staged):
    """A system that replaces all colours leaves those of coils and arrows, and the border that makes STOP a button."""
    screen = staged()
    screen.until("haptorb.status === 'running' && !document.getElementById('legend').hidden")
    read = """[...document.querySelectorAll(".swatch, .arrow.given, .dot, .hatch")]
        .map((element) => getComputedStyle(element)).map((style) => style.backgroundColor + style.backgroundImage)"""
    before = screen.tell(read)
    assert len(set(before[:-3])) >= 3
    screen.page.emulate_media(forced_colors="active")
    assert screen.tell(read) == before
    bar = "[...document.getElementById('bar').getContext('2d').getImageData(9, 0, 1, 180).data].join()"
    assert len(set(screen.tell(bar).split(","))) > 20
    style = "getComputedStyle(document.getElementById('stop'))"
    assert screen.tell(f"parseFloat({style}.borderTopWidth)") >= 2
    assert screen.tell(f"{style}.borderTopStyle === 'solid' && {style}.borderTopColor !== {style}.backgroundColor")
