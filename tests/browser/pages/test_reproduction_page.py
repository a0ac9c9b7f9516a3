"""Page of `haptorb reproduce` in a real browser: folded sections, print, and use without a mouse."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from haptorb_papers.reproduce import Item, ReproductionResult, report_page, reproductions

pytestmark = [pytest.mark.browser, pytest.mark.realtime(retry=False)]

FORCE = Item("x", "bai2012", "Fig. 8", "a force " + 12 * "of some kind ", 1.0, 1.04, "N", 0.05, why="as stiff as that")
ROWS = 14  #: per part: about as many as there are
HEIGHT = "document.documentElement.scrollHeight"
SHOWN = "[...document.querySelectorAll('tbody tr')].filter(row => row.checkVisibility()).length"


def draw(path: Path) -> Path:
    path.write_text("<svg xmlns='http://www.w3.org/2000/svg' width='900' height='500'/>")
    return path


@pytest.fixture
def page(browser: Any, tmp_path: Path) -> Any:
    """As many parts as both papers have, one statement of each differing."""
    made = []
    for n, one in enumerate(reproductions()):
        items = [replace(FORCE, id=f"p{n}-{k}", paper=one.paper) for k in range(ROWS)]
        made.append(ReproductionResult(one, (*items, replace(items[0], id=f"bad{n}", computed=3.0)), draw))
    path = tmp_path / "reproduction.html"
    path.write_text(report_page(made), encoding="utf-8")
    page = browser.new_page(viewport={"width": 1200, "height": 800})
    page.goto(path.as_uri())
    yield page
    page.close()


def test_folded_unfolded_and_on_paper(page: Any) -> None:
    rows = (ROWS + 1) * len(reproductions())
    assert page.evaluate(HEIGHT) < 10_000
    assert page.evaluate(SHOWN) == 0
    # by keyboard: to the first part, and open
    page.locator("summary").first.focus()
    page.keyboard.press("Enter")
    assert page.evaluate(SHOWN) == ROWS + 1
    page.keyboard.press("Enter")
    # a link to a statement unfolds its part and shows the row, each time it is followed
    for _ in range(2):
        page.locator("a[href='#bai2012-bad3']").click()
        assert page.locator("[id='bai2012-bad3']").is_visible()
        assert page.evaluate("document.querySelector(':target').getBoundingClientRect().top") < 800
        page.get_by_role("button", name="Fold all", exact=True).click()
        assert page.evaluate(SHOWN) == 0
    page.get_by_role("button", name="Unfold all").click()
    assert page.evaluate(SHOWN) == rows
    page.get_by_role("button", name="Fold all", exact=True).click()
    page.emulate_media(media="print")
    assert page.evaluate(SHOWN) == rows
    page.emulate_media(media="screen")
    for width in (390, 820, 1440):
        page.set_viewport_size({"width": width, "height": 800})
        page.get_by_role("button", name="Unfold all").click()
        assert page.evaluate("document.documentElement.scrollWidth") <= width, width
