"""Take the pictures of the console that README and documentation show: `make screenshots`.

The simulated Omni runs, a real Chromium opens the page, drags the stylus down the dome, and is photographed: light and
dark, on a desk and on a tablet, and stopped.
"""

from __future__ import annotations

import shutil
import sys
import threading
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

from haptorb.apps.console import Console
from haptorb.runtime.servo import Servo

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "_static" / "console"
SIZES = {"desk": (1280, 800), "wide": (1920, 1080), "tablet": (820, 1180)}


def settled(page: Page) -> None:
    """Wait until the page holds the pointer's end of the line and has drawn for a while."""
    for _ in range(600):  # the page's policy forbids wait_for_function's eval
        if page.evaluate("window.haptorb && haptorb.control && haptorb.frames > 200"):
            return
        page.wait_for_timeout(100)
    raise SystemExit("the console did not come alive within a minute")


def drag(page: Page, right: int, down: int) -> None:
    """Hold the stylus and lead it some pixels away; it stays held."""
    _, magnet, end = page.evaluate("haptorb.stylus()")
    x, y = 0.5 * (magnet["x"] + end["x"]), 0.5 * (magnet["y"] + end["y"])
    page.mouse.move(x, y)
    page.mouse.down()
    for share in range(1, 41):
        page.mouse.move(x + right * share / 40, y + down * share / 40)
        page.wait_for_timeout(25)
    page.wait_for_timeout(2500)


def main() -> int:
    """Write the pictures; returns the exit code."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        print("screenshots need Chromium: apt-get install chromium", file=sys.stderr)
        return 2
    FOLDER.mkdir(parents=True, exist_ok=True)
    servo = Servo("omni", "dome", record=False)
    with Console(servo, 0) as console, servo, sync_playwright() as play:
        serving = threading.Thread(target=console.serve)
        serving.start()
        browser = play.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        try:
            for name, (width, height) in SIZES.items():
                for scheme in ("light", "dark") if name == "desk" else ("light",):
                    page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
                    page.goto(console.url)
                    settled(page)
                    drag(page, 70, 30)
                    page.screenshot(path=FOLDER / f"{name}-{scheme}.png")
                    page.mouse.up()
                    if (name, scheme) == ("desk", "light"):
                        page.click("#stop")
                        page.wait_for_timeout(800)
                        page.screenshot(path=FOLDER / "desk-stopped.png")
                        servo.engage()
                    page.close()
                    print(FOLDER / f"{name}-{scheme}.png")
        finally:
            browser.close()
            console.close()
            serving.join()
    return 0


if __name__ == "__main__":
    sys.exit(main())
