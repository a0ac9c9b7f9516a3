"""From the drag of a pointer to the force that answers it, drawn in a real browser, in milliseconds.

    python benchmarks/console_latency.py [--seconds 10] [--json]

Starts the simulated Omni with its console, drags the stylus in Chromium, and reads the times that the page measures
between the pointer's event and the end of drawing the first force that belongs to it. The graphics processor is
whatever Chromium finds; a machine without one draws with its processor, which also runs the servo.
"""

from __future__ import annotations

import argparse
import json
import math
import shutil
import statistics
import threading
from dataclasses import replace

from playwright.sync_api import Page, sync_playwright

from haptorb.apps.console import Console
from haptorb.devices.loader import load
from haptorb.runtime.servo import Servo

FLAGS = (
    *("--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync"),
)
#: what the browser itself needs: from a pointer's event to its telling the page, and from frame to frame [ms]
OWN = """() => {
  window.told = []; window.paces = []; let last = 0;
  document.getElementById("scene").addEventListener("pointermove", (e) => told.push(performance.now() - e.timeStamp));
  const frame = (now) => { paces.push(now - last); last = now; requestAnimationFrame(frame); };
  requestAnimationFrame(frame);
}"""
HOLDING = "document.querySelector('#scene.holding') !== null"


def taken(page: Page) -> tuple[float, float]:
    """Press the mouse on the stylus, which the guided hand moves on meanwhile; the place [px]."""
    for _ in range(100):
        _, magnet, end = page.evaluate("haptorb.stylus()")
        x, y = 0.6 * magnet["x"] + 0.4 * end["x"], 0.6 * magnet["y"] + 0.4 * end["y"]
        page.mouse.move(x, y)
        page.mouse.down()
        page.wait_for_timeout(60)
        if page.evaluate(HOLDING):
            return float(x), float(y)
        page.mouse.up()
    raise SystemExit("the stylus could not be taken: nothing was measured")


def measured(seconds: float) -> dict[str, float | int | str]:
    """Drag for `seconds`; the percentiles of the latency [ms], and how the loop fared."""
    omni = load("omni")
    # A computer that draws with its processor stutters: the drag must go on to be measured.
    servo = Servo(replace(omni, limits=replace(omni.limits, expiry=1.0)), "dome", record=False)
    with Console(servo, 0) as console, servo:
        serving = threading.Thread(target=console.serve)
        serving.start()
        try:
            with sync_playwright() as play:
                browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=list(FLAGS))
                page = browser.new_page(viewport={"width": 1280, "height": 800})
                page.goto(console.url)
                while not page.evaluate("window.haptorb && haptorb.control && haptorb.frames > 100"):
                    page.wait_for_timeout(100)
                page.evaluate(OWN)
                x, y = taken(page)
                for k in range(int(seconds * 40)):
                    angle = 2 * math.pi * k / 80
                    page.mouse.move(x + 60 * math.sin(angle), y + 18 * math.sin(2 * angle))
                    page.wait_for_timeout(25)
                    if k % 40 == 39 and not page.evaluate(HOLDING):  # a page that stuttered has let go
                        page.mouse.up()
                        x, y = taken(page)
                page.mouse.up()
                times = sorted(page.evaluate("haptorb.latencies"))
                arrivals = page.evaluate("haptorb.arrivals")
                costs = page.evaluate("haptorb.costs")
                renderer = page.evaluate(
                    "(() => { const gl = document.createElement('canvas').getContext('webgl2');"
                    "return gl.getParameter(gl.getExtension('WEBGL_debug_renderer_info').UNMASKED_RENDERER_WEBGL) })()"
                )
                drawn = page.evaluate("haptorb.drawn")
                told, paces = page.evaluate("told"), page.evaluate("paces")
                browser.close()
            report = servo.report()
        finally:
            console.close()
            serving.join()
    return {
        "drags": len(times),
        "median_ms": round(statistics.median(times), 1),
        "p90_ms": round(times[int(0.9 * len(times))], 1),
        "arrived_median_ms": round(statistics.median(arrivals), 1),
        "event_told_median_ms": round(statistics.median(told), 1),
        "frame_median_ms": round(statistics.median(paces), 1),
        "scene_ms": round(costs["scene"], 1),
        "plots_ms": round(costs["plots"], 1),
        "frames_drawn": drawn,
        "success_rate": report["success_rate"],
        "lateness_p99_us": report["lateness_us"]["p99"],
        "renderer": renderer,
    }


def main() -> None:
    """Print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    result = measured(given.seconds)
    if given.json:
        print(json.dumps(result))
    else:
        for name, value in result.items():
            print(f"{name:>16}  {value}")


if __name__ == "__main__":
    main()
