"""STOP is on the screen, whole, at every size and with every badge; nothing lies over a safety message or a number."""

from __future__ import annotations

import numpy as np
import pytest
from browser.screen_check import find_faults

from haptorb.control.protection.trip import CoilState, GuardState, Trip

pytestmark = [pytest.mark.browser, pytest.mark.realtime]

#: what comes and goes by itself, shown at each look
NOTES = {
    "watching": "",
    "hint": "",
    "mistake": "Recording: the disk is full, 12 s are lost; the tracker refused 3 poses of another sender",
    "dropped": "12345 samples not shown: this page was too slow",
}


def test_stop_is_whole_and_no_text_lies_over_another(staged, fake):
    """With every badge, at every size: while it runs, warm, tripped, and with coils whose state is unknown."""
    fake.recording_trouble, fake.warning = "the disk is full", "the tracker refused 3 poses"
    screen = staged(query="?detail=layered")
    screen.until("haptorb.status === 'running' && haptorb.value('p')[2] > 0 && haptorb.control")
    screen.until("!document.getElementById('legend').hidden")
    screen.until("document.getElementById('loop').textContent.includes('not recording')")
    faults = {"running": find_faults(screen.page, NOTES)}
    fake.guard, fake.winding = GuardState.DERATED, np.array([322.0, 361.0, 311.0])
    screen.until("haptorb.status === 'derated'")
    faults["derated"] = find_faults(screen.page, NOTES)
    fake.guard, fake.trip = GuardState.TRIPPED, Trip.POSE_EXPIRED
    screen.until("haptorb.status === 'tripped'")
    screen.page.get_by_role("button", name="Re-engage").click()
    faults["tripped"] = find_faults(screen.page, NOTES)
    fake.coils = CoilState.UNKNOWN
    screen.until("haptorb.status === 'coil state unknown'")
    faults["unknown"] = find_faults(screen.page, NOTES)
    assert {state: found for state, found in faults.items() if found} == {}
