"""Latency from the drag of a pointer to the drawn force in a real browser [ms].

    python benchmarks/console_latency.py [--seconds 10] [--detail LEVEL] [--json]

Starts the simulated Omni with its console in a process of their own, as `haptorb run` does, drags the stylus in
Chromium, and reads the times that the page measures between the pointer's event and the end of drawing the first force
that belongs to it. On the way, from the same event: told (the page knows of it), answered (the socket has the row that
answers it: console, servo and back), arrived (the page has it), drawn. The same drag over an empty page with a canvas
of the same size, cleared at the frame after each event, says what the browser itself needs. The graphics processor is
whatever Chromium finds; a machine without one draws with its processor, which also runs the servo. stolen_share is the
processor time that the host of a virtual machine kept for itself meanwhile: ticks that fall into it are lost.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import shutil
import statistics
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

from playwright.sync_api import Page, sync_playwright

from console_drag import HOLDING, take_hold
from haptorb.cli.check_computer import StolenTimeCounter
from haptorb.devices.loader import load
from haptorb.runtime.servo import Servo
from haptorb.web.console import Console

FLAGS = (
    *("--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync"),
)
#: from frame to frame [ms]
PACES = """() => {
  window.paces = []; let last = 0;
  const frame = (now) => { paces.push(now - last); last = now; requestAnimationFrame(frame); };
  requestAnimationFrame(frame);
}"""
#: what the browser itself needs: from an event to its telling the page, and to the end of the next frame's drawing [ms]
EMPTY = """([width, height]) => {
  document.body.innerHTML = ""; document.body.style.margin = 0;
  const canvas = Object.assign(document.createElement("canvas"), { width, height });
  document.body.append(canvas);
  const gl = canvas.getContext("webgl2", { antialias: false });
  window.told = []; window.drawn = []; let waiting = null;
  canvas.addEventListener("pointerrawupdate", (e) => {
    told.push(performance.now() - e.timeStamp); waiting = e.timeStamp;
  });
  const frame = () => {
    requestAnimationFrame(frame);
    if (waiting === null) return;
    gl.clearColor(Math.random(), 0, 0, 1); gl.clear(gl.COLOR_BUFFER_BIT);
    drawn.push(performance.now() - waiting); waiting = null;
  };
  requestAnimationFrame(frame);
}"""


def serve(line: Connection) -> None:
    """The simulated Omni and its console, until the other end of `line` says so; then how the loop fared."""
    omni = load("omni")
    # A computer that draws with its processor stutters: the drag must go on to be measured.
    servo = Servo(replace(omni, limits=replace(omni.limits, expiry=1.0)), "dome", record=False)
    with Console(servo, 0) as console, servo:
        watch = StolenTimeCounter(servo.servo_pid)
        line.send(console.url)
        console.serve(until=line.poll)
        line.send(servo.report() | {"stolen": watch.measure().stolen})


def drag(page: Page, x: float, y: float, seconds: float, *, again: bool) -> None:
    """Draw figures of eight about (x, y) [px]; `again`: take the stylus again where the page let go of it."""
    for k in range(int(seconds * 40)):
        angle = 2 * math.pi * k / 80
        page.mouse.move(x + 60 * math.sin(angle), y + 18 * math.sin(2 * angle))
        page.wait_for_timeout(25)
        if again and k % 40 == 39 and not page.evaluate(HOLDING):  # a page that stuttered has let go
            page.mouse.up()
            x, y = take_hold(page)


def measure(seconds: float, detail: str) -> dict[str, Any]:
    """Drag for `seconds`; the percentiles of the latency [ms], and how the loop fared.

    detail   a level of the page's drawing, or "" for what the page chooses itself
    """
    processes = multiprocessing.get_context("spawn")
    line, other = processes.Pipe()
    serving = processes.Process(target=serve, args=(other,))
    serving.start()
    other.close()  # or the death at that end would go unnoticed here
    try:
        url, _, token = line.recv().partition("#")
        with sync_playwright() as play:
            browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=list(FLAGS))
            page = browser.new_page(viewport={"width": 1280, "height": 800})
            page.goto(url + (f"?detail={detail}" if detail else "") + f"#{token}")
            while not page.evaluate("window.haptorb && haptorb.control && haptorb.frames > 100"):
                if line.poll():  # its last words
                    raise SystemExit(f"the loop ended by itself, nothing was measured: {line.recv()['trips']}")
                page.wait_for_timeout(100)
            page.evaluate(PACES)
            drag(page, *take_hold(page), seconds, again=True)
            page.mouse.up()
            times = sorted(page.evaluate("haptorb.latencies"))
            parts, costs = page.evaluate("haptorb.parts"), page.evaluate("haptorb.costs")
            drawn, level = page.evaluate("haptorb.drawn"), page.evaluate("haptorb.level")
            paces = page.evaluate("paces")
            size = page.evaluate("['clientWidth', 'clientHeight'].map(side => document.getElementById('scene')[side])")
            page.close()
            empty = browser.new_page(viewport={"width": 1280, "height": 800})
            # Where the console's page would be: a browser tells raw events to trusted pages only.
            empty.route("**/empty", lambda route: route.fulfill(body="<!doctype html>", content_type="text/html"))
            empty.goto(url + "empty")
            empty.evaluate(EMPTY, size)
            drag(empty, size[0] / 2, size[1] / 2, seconds / 2, again=False)
            least = {name: statistics.median(empty.evaluate(name)) for name in ("told", "drawn")}
            renderer = empty.evaluate(
                "(() => { const gl = document.createElement('canvas').getContext('webgl2');"
                "return gl.getParameter(gl.getExtension('WEBGL_debug_renderer_info').UNMASKED_RENDERER_WEBGL) })()"
            )
            browser.close()
        line.send("end")
        report = line.recv()
    finally:
        line.close()  # whoever listens at the other end finds it readable, and ends as well
        serving.join()
    return {
        "drags": len(times),
        "median_ms": round(statistics.median(times), 1),
        "p90_ms": round(times[int(0.9 * len(times))], 1),
        **{f"{name}_median_ms": round(value, 1) for name, value in parts.items()},
        "empty_told_median_ms": round(least["told"], 1),
        "empty_drawn_median_ms": round(least["drawn"], 1),
        "frame_median_ms": round(statistics.median(paces), 1),
        "detail": level,
        "scene_ms": round(costs["scene"], 1),
        "plots_ms": round(costs["plots"], 1),
        "frames_drawn": drawn,
        "success_rate": report["success_rate"],
        "lateness_p99_us": report["lateness_us"]["p99"],
        "stolen_share": round(report["stolen"], 4),
        "renderer": renderer,
    }


def main() -> None:
    """Print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--detail", default="", help="hold this level of drawing: full, layered or least")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    result = measure(given.seconds, given.detail)
    if given.json:
        print(json.dumps(result))
    else:
        for name, value in result.items():
            print(f"{name:>22}  {value}")


if __name__ == "__main__":
    main()
