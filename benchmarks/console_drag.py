"""Trips of the simulated device by dragging in a real browser on a busy computer.

    python benchmarks/console_drag.py [--minutes 10] [--busy 1] [--device omni] [--json]

Starts the simulated device with its console in a process of their own, as `haptorb run` does, and as many processes as
`--busy` says that compute without a pause. Chromium drags the stylus in figures of eight; every tenth second the mouse
rests for two seconds with its button down. Every trip is counted with its reason and its time; the page then engages
again and takes hold anew. stalls: pauses of the page above 250 ms between two frames, and the longest of them; loop:
the share of deadlines that the servo met. The exit code is 1 if a pose was too old or lost.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import shutil
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

from playwright.sync_api import Browser, Error, Page, sync_playwright

from haptorb.devices.loader import load
from haptorb.runtime.servo import Servo
from haptorb.web.console import Console

FLAGS = (
    *("--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync"),
)
POSE = ("POSE_EXPIRED", "POSE_LOST")  #: the trips that a page in time never causes
TRIPPED = "['tripped', 'tracker lost'].includes(haptorb.status)"
HOLDING = "document.querySelector('#scene.holding') !== null"
#: pauses between two frames above 250 ms [ms]
WATCH = """() => {
  window.stalls = []; let last = performance.now();
  const frame = (now) => { if (now - last > 250) stalls.push(now - last); last = now; requestAnimationFrame(frame); };
  requestAnimationFrame(frame);
}"""
STARTS = 4  #: of the servo, if the computer is too busy even for that
ROUND, REST = 8.0, 2.0  #: of dragging, then of holding still [s]


def serve(line: Connection, device: str, expiry: float | None) -> None:
    """A simulated device, whose poses expire after `expiry` [s] (None: as its file says), and its console, until the
    other end of `line` says so; then what the servo reports."""
    known = load(device)
    if expiry is not None:
        known = replace(known, limits=replace(known.limits, expiry=expiry))
    servo = Servo(known, record=False)
    with Console(servo, 0) as console, servo:
        line.send(console.url)
        console.serve(until=line.poll)
        with suppress(BrokenPipeError):
            line.send(servo.report())


def compute() -> None:
    """Use a processor without a pause."""
    while True:
        math.sqrt(2.0)


@contextmanager
def running(device: str, expiry: float | None) -> Iterator[tuple[str, Connection]]:
    """The console in a process of its own; the page's address, and the line over which "end" brings the report."""
    processes = multiprocessing.get_context("spawn")
    line, other = processes.Pipe()
    serving = processes.Process(target=serve, args=(other, device, expiry))
    serving.start()
    other.close()
    try:
        yield line.recv(), line
    finally:
        line.close()
        serving.join()


@contextmanager
def computing(busy: int) -> Iterator[None]:
    """So many processes that compute, for as long as the block lasts."""
    loops = [multiprocessing.get_context("spawn").Process(target=compute, daemon=True) for _ in range(busy)]
    for loop in loops:
        loop.start()
    try:
        yield
    finally:
        for loop in loops:
            loop.terminate()
            loop.join()


def open_page(browser: Browser, url: str, line: Connection) -> Page | None:
    """The console's page with samples on it; None if the loop ended by itself on too busy a computer."""
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    try:
        page.goto(url, timeout=60_000)
        while not page.evaluate("window.haptorb && haptorb.control && haptorb.frames > 30"):
            if line.poll():
                page.close()
                return None
            page.wait_for_timeout(100)
    except Error:
        page.close()
        if line.poll(10):
            return None
        raise
    return page


def take_hold(page: Page) -> tuple[float, float]:
    """Press the mouse on the stylus or handle, which moves meanwhile; the place [px]."""
    for _ in range(200):
        _, magnet, end = page.evaluate("haptorb.stylus()")
        x, y = 0.6 * magnet["x"] + 0.4 * end["x"], 0.6 * magnet["y"] + 0.4 * end["y"]
        page.mouse.move(x, y)
        page.mouse.down()
        page.wait_for_timeout(60)
        if page.evaluate(HOLDING):
            return float(x), float(y)
        page.mouse.up()
    raise SystemExit("the stylus could not be taken: nothing was measured")


def engage(page: Page) -> None:
    """Begin again after a trip, in two steps as a person does."""
    page.mouse.up()
    for _ in range(40):
        page.evaluate("document.querySelector('#engage button:not(.sure)')?.click()")
        page.wait_for_timeout(150)
        page.evaluate("document.querySelector('#engage .sure')?.click()")
        page.wait_for_timeout(1500)
        if not page.evaluate(TRIPPED):
            return
    raise SystemExit(f"the device could not be engaged again: {page.inner_text('#alert-text')}")


def drag(page: Page, seconds: float) -> int:
    """Drag and rest for `seconds`; how often the stylus had to be taken again."""
    end, taken = time.monotonic() + seconds, 0
    x, y = take_hold(page)
    while time.monotonic() < end:
        start = time.monotonic()
        while time.monotonic() - start < min(ROUND, seconds):
            angle = math.pi * (time.monotonic() - start)
            page.mouse.move(x + 60 * math.sin(angle), y + 18 * math.sin(2 * angle))
            page.wait_for_timeout(15)
        page.wait_for_timeout(1000 * min(REST, seconds))
        tripped = page.evaluate(TRIPPED)
        if tripped:
            engage(page)
        if tripped or not page.evaluate(HOLDING):
            page.mouse.up()
            x, y = take_hold(page)
            taken += 1
    page.mouse.up()
    return taken


def measure(minutes: float, busy: int, device: str, browser: Browser, expiry: float | None = None) -> dict[str, Any]:
    """Drag for `minutes` beside `busy` computing processes; `expiry` as in `serve`."""
    for _ in range(STARTS):
        with running(device, expiry) as (url, line):
            page = open_page(browser, url, line)
            if page is None:
                continue
            page.evaluate(WATCH)
            with computing(busy):
                taken = drag(page, 60 * minutes)
            stalls = page.evaluate("stalls")
            page.close()
            line.send("end")
            report = line.recv()
            break
    else:
        raise SystemExit(f"the loop ended by itself in {STARTS} starts: nothing was measured")
    trips = [(round(trip["t"], 1), trip["code"]) for trip in report["trips"] if trip["code"] != "CLOSING"]
    return {
        "minutes": minutes,
        "busy": busy,
        "device": device,
        "trips": dict(Counter(code for _, code in trips)),
        "at_s": trips,
        "pose_trips": sum(code in POSE for _, code in trips),
        "taken_again": taken,
        "stalls": len(stalls),
        "longest_stall_ms": round(max(stalls, default=0.0)),
        "loop": report["success_rate"],
    }


def main() -> int:
    """Print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--busy", type=int, default=1, help="processes that compute without a pause")
    parser.add_argument("--device", default="omni")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=list(FLAGS))
        result = measure(given.minutes, given.busy, given.device, browser)
        browser.close()
    if given.json:
        print(json.dumps(result))
    else:
        for name, value in result.items():
            print(f"{name:>18}  {value}")
    return 1 if result["pose_trips"] else 0


if __name__ == "__main__":
    sys.exit(main())
