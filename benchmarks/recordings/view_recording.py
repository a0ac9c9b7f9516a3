"""`haptorb view` of an hour at 1 kHz: time to open, scrubbing in a real browser, and memory.

    python benchmarks/recordings/view_recording.py [FILE] [--hours 1] [--folder DIR] [--scrub 8] [--json]

Chromium draws without a graphics processor. The pointer moves once in each frame, from within the page: Playwright's
own mouse is slower than the page. `opens` counts from the command to the picture with its numbers; of it,
`answers` to the address that the command prints, `shows` in the browser. A pointer is dragged along the timeline from
end to end, again and again: `frames` are those in which another tick was drawn. `steps` are of the arrow key, held.
Memory is the greatest of the server's process, then of those that it started (overview, force map), each alone; and of
all of them together, where a page that several share counts once, looked at after each step.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from long_recording import write_hours
from playwright.sync_api import Page, sync_playwright

_SIZE = {"width": 1440, "height": 900}
_SHOWN = "document.querySelector('iframe')?.contentWindow.player?.shown"
_COMMAND = "from haptorb.cli import main; raise SystemExit(main())"


def peak_memory(process: int) -> int:
    """Greatest memory of a process [bytes]; 0 if it has ended."""
    try:
        found = re.search(r"VmHWM:\s+(\d+)", Path(f"/proc/{process}/status").read_text())
    except OSError:
        return 0
    return 1024 * int(found[1]) if found else 0


def children(process: int) -> dict[str, int]:
    """What a process started: its module's name → greatest memory [bytes]."""
    found = {}
    for line in Path(f"/proc/{process}/task").glob("*/children"):
        for child in line.read_text().split():
            words = Path(f"/proc/{child}/cmdline").read_text().split("\0")
            found[next((one for one in words if "haptorb" in one), words[0])] = peak_memory(int(child))
    return found


def count_together(process: int) -> int:
    """Memory of a process and of all that it started now, shared pages once [bytes]; 0 for one that has ended."""
    try:
        found = re.search(r"^Pss:\s+(\d+)", Path(f"/proc/{process}/smaps_rollup").read_text(), re.MULTILINE)
        started = [
            int(one) for line in Path(f"/proc/{process}/task").glob("*/children") for one in line.read_text().split()
        ]
    except OSError:
        return 0
    return (1024 * int(found[1]) if found else 0) + sum(map(count_together, started))


def wait_until(page: Page, expression: str, seconds: float = 120.0) -> None:
    """Until `expression` is true on the page; looked at in every frame of it."""
    end = time.monotonic() + seconds
    while not page.evaluate(expression):
        if time.monotonic() > end:
            raise SystemExit(f"never came true: {expression}")
        page.wait_for_timeout(10)


def count_frames(page: Page, act: str, seconds: float) -> float:
    """Frames with another tick per second while the page does `act` in each of its frames; `share` goes from 0 to 1 and
    back in eight seconds."""
    frames: float = page.evaluate(
        f"""(seconds) => new Promise((done) => {{
            const begun = performance.now(), drawn = {_SHOWN}.drawn;
            const step = () => {{
                const passed = (performance.now() - begun) / 1000;
                const share = Math.abs(((passed / 4) % 2) - 1);
                if (passed > seconds) return done(({_SHOWN}.drawn - drawn) / passed);
                {act};
                requestAnimationFrame(step);
            }};
            requestAnimationFrame(step);
        }})""",
        seconds,
    )
    return frames


def measure(path: Path, scrub: float) -> dict[str, Any]:
    """Seconds, frames per second and bytes."""
    arguments = [sys.executable, "-c", _COMMAND, "view", str(path), "--port", "0", "--json"]
    with sync_playwright() as playwright:
        # Before the command: a person has a browser open.
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
        page = browser.new_page(viewport=_SIZE)
        started = time.perf_counter()
        server = subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True)
        try:
            assert server.stdout is not None
            url = json.loads(server.stdout.readline())["url"]
            answered = time.perf_counter()
            page.goto(url)
            wait_until(page, f"{_SHOWN}?.drawn > 0")
            shown = time.perf_counter()
            found: dict[str, Any] = {
                "answers_s": answered - started,
                "shows_s": shown - answered,
                "opens_s": shown - started,
            }
            others = watch(page, scrub, found, server.pid)
            found["overview_s"] = found.pop("overview_at") - started
            found["server_memory_bytes"] = peak_memory(server.pid)
            found["other_memory_bytes"] = others | children(server.pid)
            found["page_heap_bytes"] = page.evaluate("document.querySelector('iframe').contentWindow.player.heap")
            browser.close()
        finally:
            server.terminate()
            server.wait(10)
    return found


def watch(page: Page, scrub: float, found: dict[str, Any], server: int) -> dict[str, int]:
    """Drag, step and play, each for some seconds; adds the figures to `found`. Returns what the server has started."""
    box = page.locator("#slider").bounding_box()
    assert box is not None
    middle = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + 2, middle)
    page.mouse.down()

    drag = (
        "document.getElementById('slider').dispatchEvent(new PointerEvent('pointermove', "
        f"{{ pointerId: 1, clientX: {box['x'] + 1} + share * {box['width'] - 2}, clientY: {middle} }}))"
    )
    key = (
        "document.getElementById('slider').dispatchEvent(new KeyboardEvent('keydown', "
        "{ key: 'ArrowRight', bubbles: true }))"
    )
    together = [count_together(server)]
    found["scrub_frames_per_s"] = count_frames(page, drag, scrub)
    others = children(server)
    together.append(count_together(server))
    wait_until(page, "timeline.overview === 1", 600.0)
    found["overview_at"] = time.perf_counter()
    together.append(count_together(server))
    found["scrub_frames_per_s_after_overview"] = count_frames(page, drag, scrub)
    page.mouse.up()
    page.evaluate("timeline.go(0.3 * Number(document.getElementById('slider').ariaValueMax))")
    wait_until(page, f"{_SHOWN}.settled")
    page.focus("#slider")
    found["step_frames_per_s"] = count_frames(page, key, scrub / 2)
    page.keyboard.press("Space")
    found["play_frames_per_s"] = count_frames(page, "", scrub / 2)
    found["together_memory_bytes"] = max(*together, count_together(server))
    return others


def main() -> None:
    """Measure, and print for people or machines."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path, nargs="?", help="recording to view; without it one is made")
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--scrub", type=float, default=8.0, help="duration of each drag [s]")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        path = options.file or Path(folder, "long.mcap")
        if options.file is None:
            write_hours(path, options.hours)
        found = {"bytes": path.stat().st_size, **measure(path, options.scrub)}
    if options.json:
        print(json.dumps(found, indent=1))
        return
    for name, value in found.items():
        print(f"{name:36} {value if isinstance(value, dict) else round(value, 3)}")


if __name__ == "__main__":
    main()
