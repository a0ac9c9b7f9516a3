"""Reports in a notebook: one line of text, and the command's output as HTML."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import haptorb
from haptorb import worlds
from haptorb.cli.cards import card
from haptorb.cli.check_computer import Fitness, Machine, StolenTime
from haptorb.cli.check_world import Setting, judge_world
from haptorb_bench import load_result
from haptorb_papers.reproduce import ReproductionResult
from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.registry import find_reproduction

REPORT: dict[str, Any] = {
    "device": "omni", "rate_hz": 1000.0, "ticks": 29_999, "missed": 1, "success_rate": 0.99997,
    "lateness_us": {"p50": 2.0, "p99": 30.0, "p999": 90.0}, "compute_us": {"p50": 50.0, "p99": 80.0, "p999": 120.0},
    "ahead_us": {}, "trips": [], "scheduler": {"policy": "SCHED_FIFO", "memory_locked": True},
}  # fmt: skip


def show(report: Any) -> tuple[str, str]:
    """The line and the HTML of `report`; both are checked for what a notebook needs."""
    line, html = repr(report), report._repr_html_()
    assert line == str(report)
    assert line.startswith("<")
    assert line.endswith(">")
    assert len(line) <= 200
    assert "\n" not in line
    ElementTree.fromstring(html.replace("<br>", "<br/>"))
    return line, html


def test_the_fitness_of_a_computer() -> None:
    machine = Machine("a <fast> processor", 4, "6.1 PREEMPT", True, False, "performance", "3.11")
    line, html = show(Fitness(REPORT, machine, StolenTime(0, 0.0, 1.0), 30.0, True))
    assert "fit: ticks on time 99.997 %, lateness, 99 % 30 µs" in line
    assert "This computer is fit" in html
    assert "a &lt;fast&gt; processor" in html
    assert "[µs]" in html


def test_the_verdict_on_a_world() -> None:
    wall = worlds.Wall(stiffness=400.0, damping=0.0, greatest=20.0)
    verdict = judge_world(haptorb.load("omni"), wall, Setting())
    line, html = show(verdict)
    assert f"{verdict.verdict} the boundary" in line
    assert "N/m" in html


def test_the_card_of_a_device() -> None:
    line, html = show(card(haptorb.load("omni")))
    assert line.startswith("<ElectromagnetCard of omni: ")
    assert "[mN]" in html
    assert "Ω at 20 °C" in html


def test_benchmarks(root: Path) -> None:
    found = load_result(root / "docs" / "benchmarks.json")
    line, html = show(found)
    assert found.day in line
    assert "µs" in html


def test_a_reproduction() -> None:
    item = Item("x", "bai2012", "Fig. 4", "a < b", 1.0, 1.0, "N·m", 0.1)
    line, html = show(ReproductionResult(find_reproduction("bai2012", "figure 4"), (item,), None))
    assert "1 reproduced" in line
    assert "a &lt; b" in html
    assert "N·m" in html
