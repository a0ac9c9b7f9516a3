"""Time to open the report of 10 000 valid designs in Chromium, and response to the pointer.

    python benchmarks/design/report.py [--designs 10000] [--rounds 5] [--chromium /usr/bin/chromium] [--json]

The designs are made up: 8 parameters, 3 objectives and 3 constraints of an Omni, with five best designs, their cards
and drawings. A round opens the file anew and waits until everything is drawn, all lines of the parallel coordinates
included; then the pointer goes 200 steps over the points and over the lines. Ends with code 1 if the median round is
above 3 s, or a step takes longer than 50 ms in the page on the average of a round.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np

from haptorb_design.problem import (
    Bound,
    Design,
    DesignGoal,
    DesignParameter,
    DesignQuantity,
    Evaluation,
    ParameterPlace,
)
from haptorb_design.report import write_report
from haptorb_design.store import open_results

OPENS, FOLLOWS = 3.0, 50.0  #: limits [s], [ms]
STEPS = 200  #: of the pointer in a round
KEYS = ("electromagnet.core_radius", "tool.length", "tool.outer_radius", "tool.inner_radius", "dome.friction",
        "dome.radius", "dome.shell_thickness", "supply.voltage")  # fmt: skip
RANGES = (("mm", 14.0, 16.0), ("mm", 22.0, 26.0), ("mm", 5.5, 6.5), ("mm", 2.0, 2.8), ("", 0.1, 0.2),
          ("mm", 29.5, 31.0), ("mm", 19.0, 21.0), ("V", 12.0, 14.0))  # fmt: skip


def make_results(path: Path, count: int) -> None:
    """A results file of so many valid designs, drawn evenly; their numbers are smooth functions of the parameters."""

    def quantity(name: str, unit: str) -> DesignQuantity:
        return DesignQuantity(name, unit, "minimise", "made up", ("spherical-electromagnet",), lambda candidate: np.nan)

    parameters = tuple(
        DesignParameter(key.replace(".", "_"), (ParameterPlace(key),), *bounds)
        for key, bounds in zip(KEYS, RANGES, strict=True)
    )
    names = [quantity(name, unit) for name, unit in (("pull", "N"), ("heat", "W"), ("weight", "kg"))]
    goals = tuple(DesignGoal(one, "minimise") for one in names)
    bounds = tuple(Bound(f"limit_{n}", quantity(f"limit_{n}", "m"), high=1.0) for n in range(3))
    design = Design("made-up", "Made up", "omni", parameters, goals, bounds, {}, "", "0" * 64)
    generator = np.random.default_rng(1)
    shares = generator.uniform(size=(count, len(RANGES)))
    weights = generator.uniform(-1, 1, (len(RANGES), 6))
    numbers = np.exp(shares @ weights + 0.5 * (shares**2) @ np.roll(weights, 1, axis=0))
    values = np.array([low for _, low, _ in RANGES]) + shares * np.array([high - low for _, low, high in RANGES])
    with open_results(path, design, "sobol", 1) as writer:
        writer.add(
            Evaluation(
                number, dict(zip((one.name for one in parameters), values[number].tolist(), strict=True)),
                dict(zip(("pull", "heat", "weight"), numbers[number, :3].tolist(), strict=True)),
                {f"limit_{n}": 0.01 * float(numbers[number, 3 + n]) for n in range(3)},
            )
            for number in range(count)
        )  # fmt: skip


def measure(browser: Any, address: str) -> tuple[float, float, float]:
    """Seconds until the page is drawn, and the mean time [ms] of a step over the points, and over the lines."""
    page = browser.new_page(viewport={"width": 1440, "height": 900})
    begin = perf_counter()
    page.goto(address)
    while not page.evaluate("window.report && report.ready"):
        page.wait_for_timeout(10)
    opened = perf_counter() - begin
    follow = """([selector, steps]) => {
      const box = document.querySelector(selector);
      box.scrollIntoView({ block: "center" });
      const { left, top, width, height } = box.getBoundingClientRect();
      const begin = performance.now();
      for (let k = 0; k < steps; k++) {
        const clientX = left + width * (0.15 + 0.7 * k / steps);
        const clientY = top + height * (0.3 + 0.4 * Math.sin(k) ** 2);
        box.dispatchEvent(new PointerEvent("pointermove", { clientX, clientY, bubbles: true }));
      }
      return (performance.now() - begin) / steps;
    }"""
    points, lines = (page.evaluate(follow, [selector, STEPS]) for selector in (".points", ".lines"))
    page.close()
    return opened, points, lines


def main() -> int:
    """Measure, print, and say whether the limits hold."""
    from playwright.sync_api import sync_playwright

    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--designs", type=int, default=10_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--chromium", default="/usr/bin/chromium")
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    with TemporaryDirectory() as folder, sync_playwright() as playwright:
        results, output = Path(folder, "results.sqlite"), Path(folder, "report.html")
        make_results(results, asked.designs)
        begin = perf_counter()
        write_report(results, output)
        made = perf_counter() - begin
        browser = playwright.chromium.launch(executable_path=asked.chromium, args=["--no-sandbox"])
        rounds = [measure(browser, output.as_uri()) for _ in range(asked.rounds)]
        size = output.stat().st_size
        browser.close()
    opened, points, lines = (median(column) for column in zip(*rounds, strict=True))
    found = {"designs": asked.designs, "bytes": size, "written_s": made, "opened_s": opened,
             "opened_worst_s": max(one for one, *_ in rounds), "points_ms": points, "lines_ms": lines}  # fmt: skip
    if asked.json:
        print(json.dumps(found))
    else:
        print(
            f"{asked.designs} designs, {size / 1e6:.1f} MB, written in {made:.1f} s: opens in {opened:.2f} s (worst of "
            f"{asked.rounds}: {found['opened_worst_s']:.2f} s); a step over the points {points:.2f} ms, over the lines "
            f"{lines:.2f} ms"
        )
    return int(opened > OPENS or max(points, lines) > FOLLOWS)


if __name__ == "__main__":
    sys.exit(main())
