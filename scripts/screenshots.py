"""Screenshots of the console: every state, both themes, five sizes; and of the study's pages, in a trial and a break.

    python scripts/screenshots.py [FOLDER [WORD ...]]

Without FOLDER only the pictures of the documentation are taken, into docs/images. The console's states come from the
imagined servo of the tests: a healthy device shows few of them. The study is the tutorial's, on the simulated device.
"""

from __future__ import annotations

import importlib.util
import io
import json
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from playwright.sync_api import Page, sync_playwright

from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.web.console import Console

ROOT = Path(__file__).resolve().parent.parent
SIZES = {
    "laptop": (1280, 800),
    "desktop": (1440, 900),
    "projector": (1920, 1080),
    "tablet": (820, 1180),
    "phone": (390, 844),
}
FLAGS = [
    *("--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync", "--force-color-profile=srgb"),
]
#: what the documentation shows: file → (state, size, theme)
CHOSEN = {
    "console.png": ("running", "laptop", "light"),
    "console-dark.png": ("running", "laptop", "dark"),
    "console-stopped.png": ("stopped", "laptop", "light"),
    "console-tablet.png": ("warm", "tablet", "light"),
}


def fake_servo() -> Any:
    """The tests' imagined servo."""
    path = ROOT / "tests" / "web" / "console" / "fake_servo.py"
    spec = importlib.util.spec_from_file_location("fake_servo", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.FakeServo()


def _trip(reason: Trip) -> Callable[[Any], None]:
    def put(servo: Any) -> None:
        servo.guard, servo.trip = GuardState.TRIPPED, reason

    return put


def _warm(servo: Any) -> None:
    servo.winding = np.array([317.0, 341.0, 305.0])


def _derate(servo: Any) -> None:
    servo.guard, servo.winding = GuardState.DERATED, np.array([322.0, 361.0, 311.0])


def _saturate(servo: Any) -> None:
    servo.set_world("dome", {"moment": 4.0, "half_width_deg": 30.0, "cut_off_deg": 80.0})


def _tilt(servo: Any) -> None:
    servo.set_world("dome", {"summit": (0.3, -0.4, 0.866), "moment": -2.4})


def _nothing(servo: Any) -> None:
    servo.set_world("nothing", {})


def _silent(servo: Any) -> None:
    servo.silent = True


def _end(servo: Any) -> None:
    servo.alive = False


STATES: dict[str, Callable[[Any], None]] = {
    "running": lambda servo: None,
    "warm": _warm,
    "derated": _derate,
    "stopped": _trip(Trip.STOPPED),
    "tripped": _trip(Trip.POSE_EXPIRED),
    "tracker-lost": _trip(Trip.POSE_LOST),
    "at-the-limit": _saturate,
    "pulling": _tilt,
    "nothing": _nothing,
    "waiting": _silent,
    "disconnected": _end,
}


def _moving(servo: Any, page: Page, milliseconds: int) -> None:
    """Something to see in the plots: the hand wanders over the dome."""
    for k in range(milliseconds // 50):
        servo.target = servo.at(15 + 12 * np.sin(k / 7), -60 + 40 * np.sin(k / 11), 0.0475)
        servo.winding = servo.winding + 0.02
        page.wait_for_timeout(50)


def take(wanted: list[tuple[str, str, str, Path]]) -> None:
    """Take the pictures (state, size, theme, file)."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=chromium, args=FLAGS)
        for state, size, theme, path in wanted:
            servo = fake_servo()
            with Console(servo, 0) as console:
                serving = threading.Thread(target=console.serve)
                serving.start()
                width, height = SIZES[size]
                page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=theme)  # type: ignore[arg-type]
                page.goto(f"{console.origin}/?detail=full#{console.token}")
                for _ in range(300):
                    page.wait_for_timeout(100)
                    if page.evaluate("!document.getElementById('legend').hidden"):
                        break
                _moving(servo, page, 3000)
                servo.target = servo.at(24.0, -62.0, 0.0475)
                STATES[state](servo)
                page.wait_for_timeout(2200)
                path.parent.mkdir(parents=True, exist_ok=True)
                page.screenshot(path=path)
                page.close()
                console.close()
                serving.join()
            print(path, flush=True)
        browser.close()


def take_film(path: Path) -> None:
    """The console while the stylus goes round and over the dome's summit, as an animated WebP."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    servo, frames = fake_servo(), []
    with sync_playwright() as play, Console(servo, 0) as console:
        browser = play.chromium.launch(executable_path=chromium, args=FLAGS)
        serving = threading.Thread(target=console.serve)
        serving.start()
        page = browser.new_page(viewport={"width": 1280, "height": 800}, color_scheme="light")
        page.goto(f"{console.origin}/?detail=full#{console.token}")
        _until(page, "!document.getElementById('legend').hidden")
        page.evaluate("document.getElementById('hint').remove()")
        start = time.monotonic()
        for k in range(60):
            turn = 2 * np.pi * k / 60
            servo.target = servo.at(20 + 18 * np.sin(turn), -60 + 75 * np.sin(2 * turn), 0.0475)
            servo.winding = servo.winding + 0.1
            page.wait_for_timeout(50)
            picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
            frames.append(picture.resize((960, 600), Image.Resampling.LANCZOS))
        pause = int(1e3 * (time.monotonic() - start) / len(frames))
        browser.close()
        console.close()
        serving.join()
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=pause, loop=0, quality=45, method=6)
    print(path, flush=True)


#: what the documentation shows of a study: file → (whose page, when, theme)
STUDY = {
    "study-participant.png": ("participant", "trial", "light"),
    "study-experimenter.png": ("experimenter", "trial", "light"),
}
#: clicks and keys that lead from the consent to each moment
_MOMENTS = {"consent": (), "trial": ("Enter", *["ArrowRight"] * 8, *["ArrowUp"] * 3, "2")}


def take_study(wanted: list[tuple[str, str, str, Path]]) -> None:
    """Take the pictures (page, moment, theme, file) of the tutorial's study."""
    tutorial = (ROOT / "docs" / "tutorials" / "study.md").read_text(encoding="utf-8")
    found = re.search(r"```toml\n(.*?)```", tutorial, flags=re.DOTALL)
    assert found is not None
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=chromium, args=FLAGS)
        for who, moment, theme, path in wanted:
            with tempfile.TemporaryDirectory() as folder:
                # Poses last a second instead of 50 ms: a computer that takes pictures meanwhile stutters.
                slow = 'based_on = "omni"\nname = "pictures"\ntitle = "Omni for pictures"\n[limits]\nexpiry = "1 s"\n'
                Path(folder, "slow.toml").write_text(slow, encoding="utf-8")
                Path(folder, "places.toml").write_text('device = "slow.toml"\n' + found[1], encoding="utf-8")
                _study(browser, Path(folder), who, moment, theme, path)
            print(path, flush=True)
        browser.close()


def _study(browser: Any, folder: Path, who: str, moment: str, theme: str, path: Path) -> None:
    words = [sys.executable, "-c", "from haptorb.cli import main; main()", "study", "run", "places.toml"]
    run = subprocess.Popen([*words, "--port", "0"], cwd=folder, stderr=subprocess.PIPE, text=True)
    assert run.stderr is not None
    urls: dict[str, str] = {}
    while "experimenter" not in urls:
        line = run.stderr.readline()
        assert line, "the command ended"
        urls[line.partition(":")[0]] = line.partition(":")[2].strip()
    pages = {
        one: browser.new_page(viewport={"width": 1280, "height": 800}, color_scheme=theme)
        for one in ("participant", "experimenter")
    }
    try:
        for one, page in pages.items():
            page.goto(urls[one])
            _until(page, "!!study.view && study.view.state === 'waiting'")
        experimenter, page = pages["experimenter"], pages["participant"]
        experimenter.get_by_label("Code, never a name").fill("P01")
        experimenter.keyboard.press("Enter")
        _until(page, "study.view.state === 'consent'")
        for key in _MOMENTS[moment]:
            page.keyboard.press(key)
            if key == "Enter":
                _until(page, "study.view.state === 'running' && !!study.pen")
                page.wait_for_timeout(800)
        page.wait_for_timeout(1500)
        path.parent.mkdir(parents=True, exist_ok=True)
        pages[who].screenshot(path=path)
    finally:
        for page in pages.values():
            page.close()
        run.send_signal(signal.SIGINT)
        run.wait(60)
        run.stderr.close()


def _record(path: Path) -> None:
    """Twelve seconds of the simulated Omni: a stylus that wanders over the dome, a stop, another width of the dome."""
    from haptorb.runtime.servo import Servo

    with Servo("omni", "dome", record=str(path)) as servo:
        start, done = time.monotonic(), 0
        acts = [
            (4.0, servo.stop),
            (5.0, servo.engage),
            (8.0, lambda: servo.set_world("dome", {"half_width_deg": 30.0})),
        ]
        while (t := time.monotonic() - start) < 12.0:
            tilt, azimuth = 0.35 + 0.2 * np.sin(1.3 * t), 0.7 * t
            across = 0.0495 * np.sin(tilt)
            p = across * np.cos(azimuth), across * np.sin(azimuth), 0.0495 * np.cos(tilt)
            servo.hand.point(p, keep_alive=0.5)
            if done < len(acts) and t > acts[done][0]:
                acts[done][1]()
                done += 1
            time.sleep(0.01)


def take_view(path: Path) -> None:
    """That recording in `haptorb view`."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as play:
        run = Path(folder, "run.mcap")
        _record(run)
        words = [sys.executable, "-c", "from haptorb.cli import main; main()", "view", str(run), "--json"]
        served = subprocess.Popen([*words, "--port", "0"], stdout=subprocess.PIPE, text=True)
        assert served.stdout is not None
        url = json.loads(served.stdout.readline())["url"]
        browser = play.chromium.launch(executable_path=chromium, args=FLAGS)
        page = browser.new_page(viewport={"width": 1280, "height": 860}, color_scheme="light")
        page.goto(url.replace("/#", "/?detail=full#"))
        player = "document.querySelector('iframe').contentWindow.player"
        _until(page, f"!!{player} && {player}.shown.settled && timeline.overview === 1")
        page.evaluate("timeline.go(9.4)")
        _until(page, f"{player}.shown.settled && Math.abs({player}.forceAt([0, 0, 1])) > 0")
        page.wait_for_timeout(1500)
        path.parent.mkdir(parents=True, exist_ok=True)
        page.screenshot(path=path)
        browser.close()
        served.terminate()
        served.wait(10)
        served.stdout.close()
    print(path, flush=True)


def _until(page: Page, expression: str) -> None:
    for _ in range(600):
        if page.evaluate(expression):
            return
        page.wait_for_timeout(100)
    raise AssertionError(f"never came true: {expression}")


def main() -> None:
    """Take what the command line asks for."""
    if len(sys.argv) > 1:
        folder = Path(sys.argv[1])
        wanted = [
            (state, size, theme, folder / f"{state}-{size}-{theme}.png")
            for state in STATES
            for size in SIZES
            for theme in ("light", "dark")
            if len(sys.argv) < 3 or any(word in f"{state}-{size}-{theme}" for word in sys.argv[2:])
        ]
        study = [
            (who, moment, theme, folder / f"study-{who}-{moment}-{theme}.png")
            for who in ("participant", "experimenter")
            for moment in _MOMENTS
            for theme in ("light", "dark")
            if len(sys.argv) < 3 or any(word in f"study-{who}-{moment}-{theme}" for word in sys.argv[2:])
        ]
    else:
        wanted = [(*what, ROOT / "docs" / "images" / name) for name, what in CHOSEN.items()]
        study = [(*what, ROOT / "docs" / "images" / name) for name, what in STUDY.items()]
        take_film(ROOT / "docs" / "images" / "console.webp")
        take_view(ROOT / "docs" / "images" / "view.png")
    take(wanted)
    take_study(study)


if __name__ == "__main__":
    main()
