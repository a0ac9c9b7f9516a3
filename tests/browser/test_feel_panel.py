"""Panel of a feel session at every screen size: STOP fully visible, no overlaps; keys and names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import haptorb_study.feel
from browser.screen_check import find_faults
from haptorb.web.console import Console
from haptorb_study.feel import FeelSession, load_designs
from haptorb_study.feel.live_session import FeelPanel, LiveSession

pytestmark = [pytest.mark.browser, pytest.mark.realtime]

EXAMPLE = Path(haptorb_study.feel.__file__).with_name("example.toml")


def test_the_panel_fits_every_screen_and_is_worked_with_keys(
    browser: Any, fake: Any, painting: Any, kit: Any, tmp_path: Path
) -> None:
    session = FeelSession(tmp_path / "s", load_designs(EXAMPLE))
    live = LiveSession(session, list(session.candidates.designs), person="P1", seed=1)
    with Console(fake, 0, force_map=painting, designs=FeelPanel(live)) as console, kit.serve(console):
        page = browser.new_page(viewport=kit.DESK)
        screen = kit.Screen(page, console.url)
        screen.until("haptorb.control")
        assert not page.locator("#world").is_visible()
        feel = page.get_by_role("region", name="Cover clip")
        page.keyboard.press("6")
        screen.until("document.querySelector('#feel-scores [aria-pressed=true]')?.value === '6'")
        assert session.ratings()[0].score == 6
        before = page.locator("#feel-now").inner_text()
        page.keyboard.press("n")
        screen.until(f"document.getElementById('feel-now').textContent !== {before!r}")
        person = feel.get_by_label("person")
        person.fill("b7")  # digits and letters that are typed rate nothing
        person.press("Enter")
        feel.get_by_text("0 of 4 rated by b7").wait_for()
        assert len(session.ratings()) == 1
        assert find_faults(page) == []
        feel.get_by_label("hide names").check()
        screen.until("document.getElementById('feel-now').textContent.startsWith('Design ')")
        assert not page.locator(".plots").is_visible()
        assert find_faults(page) == []
        assert not screen.troubles
        page.close()
