"""Report of a design in a real browser: pointer and keys, filters, all sizes, light and dark."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from haptorb_design.report import BestDesign, make_page
from haptorb_design.results_table import ResultsTable
from haptorb_design.store import Results, Run
from oracles.designs.made_designs import make_design, make_evaluations

#: keeps where every text was drawn, in pixels of the page: window.texts, text → [left, top, right, bottom]
TEXTS = """
window.texts = {};
const draw = CanvasRenderingContext2D.prototype.fillText;
CanvasRenderingContext2D.prototype.fillText = function (text, x, y, ...rest) {
  const { width } = this.measureText(text), to = this.getTransform(), scale = devicePixelRatio;
  const left = x - { left: 0, center: width / 2, right: width }[this.textAlign];
  const [across, up] = [(to.e + to.a * left) / scale, (to.f + to.d * y) / scale];
  window.texts[text] = [across, up - 12, across + width, up];
  draw.call(this, text, x, y, ...rest);
};
"""

pytestmark = [pytest.mark.browser, pytest.mark.realtime(retry=False)]


@pytest.fixture
def table() -> ResultsTable:
    run = Run(1, "sobol", 1, {}, "0.1.0", "2026-01-01", tuple(make_evaluations(300)))
    return ResultsTable.of(Results(make_design(), (run,)))


@pytest.fixture
def page(browser: Any, tmp_path: Path, table: ResultsTable) -> Iterator[Any]:
    best = [BestDesign(one.row, table.name(one.row), one.reason, "name = 'x'\n", "card", b"") for one in table.picks]
    path = tmp_path / "report.html"
    path.write_text(make_page(table, best), encoding="utf-8")
    page = browser.new_page(viewport={"width": 1440, "height": 900})
    troubles: list[str] = []
    page.on("pageerror", lambda mistake: troubles.append(str(mistake)))
    page.on("console", lambda line: troubles.append(line.text) if line.type == "error" else None)
    page.on("request", lambda request: troubles.append(request.url) if request.url.startswith("http") else None)
    page.goto(path.as_uri())
    _wait(page, "report.ready")
    yield page
    page.close()
    assert not troubles


@pytest.mark.parametrize("end", [np.min, pytest.param(np.max, marks=pytest.mark.slow)])
def test_the_name_of_the_base_device_lies_inside_the_plot(
    browser: Any, tmp_path: Path, table: ResultsTable, end: Callable[..., float]
) -> None:
    name = "omni-of-the-other-laboratory"
    columns = tuple(replace(one, base=float(end(one.values))) for one in table.columns)
    changed = replace(table, columns=columns, design=replace(table.design, base=name), remark="it is old")
    path = tmp_path / "report.html"
    path.write_text(make_page(changed, []), encoding="utf-8")
    page = browser.new_page(viewport={"width": 1440, "height": 900})
    page.add_init_script(TEXTS)
    page.goto(path.as_uri())
    _wait(page, "report.ready")
    left, top, right, bottom = page.evaluate(f"texts['{name} *']")
    box = page.locator(".points").bounding_box()
    page.close()
    assert 74 <= left < right <= box["width"] - 18
    assert 12 <= top < bottom <= box["height"] - 46


def _wait(page: Any, expression: str) -> None:
    """The page's policy forbids Playwright's own way of waiting."""
    for _ in range(200):
        if page.evaluate(expression):
            return
        page.wait_for_timeout(20)
    raise AssertionError(f"never came true: {expression}")


def test_keys_walk_along_the_front_and_say_where_they_are(page: Any, table: ResultsTable) -> None:
    slider = page.get_by_role("slider", name="Designs of the Pareto front")
    slider.focus()
    pull = next(one for one in table.columns if one.name == "core_pull")
    order = sorted(table.front, key=lambda row: pull.values[row])
    for key, row in (("Home", order[0]), ("ArrowRight", order[1]), ("ArrowLeft", order[0]), ("End", order[-1])):
        page.keyboard.press(key)
        assert page.evaluate("report.marked") == row
    assert slider.get_attribute("aria-valuenow") == str(len(order))
    told = slider.get_attribute("aria-valuetext")
    assert table.name(order[-1]) in told
    assert "continuous force" in told
    assert page.locator(".numbers h3").inner_text() == table.name(order[-1])
    page.keyboard.press("Enter")  # the best force is one of the five
    best = page.locator(".best").filter(has_text="best continuous force").bounding_box()
    assert 0 <= best["y"] < 500
    assert page.locator("a[download]").count() == 5


def test_the_pointer_marks_and_a_filter_narrows(page: Any, table: ResultsTable) -> None:
    box = page.locator(".points").bounding_box()
    marked = set()
    for share in range(3, 10):
        page.mouse.move(box["x"] + 0.1 * share * box["width"], box["y"] + 0.6 * box["height"])
        marked.add(page.evaluate("report.marked"))
    assert len(marked) > 3
    page.get_by_label("Show only").select_option(label="core radius [mm]")
    page.get_by_label("from").fill("14")
    page.get_by_role("button", name="Filter", exact=True).click()
    core = table.columns[0].values
    status = page.locator(".parallel [role=status]")
    assert f"{(core >= 14).sum()} of {len(core)} designs" in status.inner_text()
    page.get_by_label("Show only").select_option(label="rate")  # a choice, by its name
    page.get_by_label("which is").select_option(label="high & dear")
    page.get_by_role("button", name="Filter", exact=True).click()
    dear = (core >= 14) & (next(one for one in table.columns if one.name == "rate").values == 1)
    assert f"{dear.sum()} of {len(core)} designs" in status.inner_text()
    assert "rate high & dear" in status.inner_text()
    page.get_by_role("button", name="Clear all filters").click()
    assert page.get_by_label("which is").input_value() == "-1"
    lines = page.locator(".lines").bounding_box()
    x = lines["x"] + 0.5 / 6 * lines["width"]  # the first of six axes
    page.mouse.move(x, lines["y"] + 40)
    page.mouse.down()
    page.mouse.move(x, lines["y"] + 160)
    page.mouse.up()
    assert "core radius" in status.inner_text()
    page.mouse.click(x, lines["y"] + 40)
    assert "Drag along an axis" in status.inner_text()


def test_fits_every_screen_in_light_and_dark_and_every_control_has_a_name(page: Any) -> None:
    for scheme, width in (("light", 1440), ("dark", 820), ("light", 390)):
        page.emulate_media(color_scheme=scheme)
        page.set_viewport_size({"width": width, "height": 900})
        page.wait_for_timeout(100)
        assert page.evaluate("document.documentElement.scrollWidth") <= width, width
    session = page.context.new_cdp_session(page)
    nodes = session.send("Accessibility.getFullAXTree")["nodes"]
    controls = {"slider", "combobox", "checkbox", "spinbutton", "button", "link"}
    told = [(n["role"]["value"], n.get("name", {}).get("value", "")) for n in nodes if not n["ignored"]]
    assert [role for role, name in told if role in controls and not name.strip()] == []
    assert {role for role, _ in told} >= controls
