"""Browser that opens a console's page and drags the stylus until it is killed; prints its process number.

python dragging_browser.py CHROMIUM ADDRESS
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

MARK = "--user-agent=haptorb-dragging-browser"


def pid_of_browser() -> int:
    """The process that all others of this browser come from: the first one that was started with the mark."""
    every = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if MARK.encode() in (folder / "cmdline").read_bytes().split(b"\0"):
                every.append(int(folder.name))
        except OSError:
            continue
    return min(every)


def main() -> None:
    spec = importlib.util.spec_from_file_location("browser_kit", Path(__file__).with_name("conftest.py"))
    assert spec is not None
    assert spec.loader is not None
    kit: Any = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(Path(__file__).parents[1]))
    spec.loader.exec_module(kit)
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=sys.argv[1], args=[MARK, "--no-sandbox"])
        screen = kit.Screen(browser.new_page(viewport=kit.DESK), sys.argv[2].replace("/#", "/?detail=least#"))
        screen.until("haptorb.control")
        x, y = screen.hold()
        print(pid_of_browser(), flush=True)
        for n in range(10_000):
            screen.page.mouse.move(x + n % 7, y)
            screen.page.wait_for_timeout(20)


if __name__ == "__main__":
    main()
