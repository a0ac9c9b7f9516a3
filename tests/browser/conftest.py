"""A real Chromium on the console's page: over the real servo with its simulated Omni, or over an imagined one that can
show every state."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from failures import FAILED
from haptorb.control.trip_reasons import CoilState, GuardState, Trip
from haptorb.devices.loader import load
from haptorb.recording.row import RowLayout
from haptorb.runtime.servo import Servo
from haptorb.web.console import Console
from haptorb.web.force_map_process import ForceMapProcess
from haptorb.worlds import Dome, World
from haptorb.worlds.base import values
from oracles.fork_server import get_fork_server

DESK = {"width": 1280, "height": 800}
#: a page draws in every fourth frame only: drawn without a graphics processor, it takes most of a test's processor time
QUARTER_RATE = """{
  const ask = requestAnimationFrame.bind(window);
  window.requestAnimationFrame = (draw) => ask(() => ask(() => ask(() => ask(draw))));
}"""


def _fake() -> Any:
    path = Path(__file__).parents[1] / "web" / "console" / "fake_servo.py"
    spec = importlib.util.spec_from_file_location("fake_servo", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@contextmanager
def serve(console: Console) -> Iterator[Console]:
    """The console answers for as long as the block lasts."""
    serving = threading.Thread(target=console.serve)
    serving.start()
    try:
        yield console
    finally:
        console.close()
        serving.join(10)


class HostGone(Exception):
    """The program behind a page ended before the page was up."""


class Screen:
    """A page of the console, and what a test wants to know of it; `runs`: whether a program is still behind it."""

    def __init__(
        self, page: Any, url: str, runs: Callable[[], bool] = lambda: True, *, every_frame: bool = False
    ) -> None:
        self.page = page
        if not every_frame:
            page.add_init_script(QUARTER_RATE)
        address, _, self.token = url.partition("#")
        self.url = address.partition("?")[0]
        self.requests: list[str] = []
        self.troubles: list[str] = []
        page.on("request", lambda request: self.requests.append(request.url))
        page.on("pageerror", lambda mistake: self.troubles.append(str(mistake)))
        page.on("console", lambda line: self.troubles.append(line.text) if line.type == "error" else None)
        try:
            page.goto(url, timeout=60_000)
        except Exception as cause:
            if not runs():
                raise HostGone from cause
            raise
        self.until("window.haptorb && haptorb.frames > 3 && haptorb.status !== 'waiting'", runs=runs)

    def tell(self, expression: str) -> Any:
        """The value of a JavaScript expression."""
        return self.page.evaluate(expression)

    def until(self, expression: str, seconds: float = 60.0, runs: Callable[[], bool] = lambda: True) -> Any:
        """Wait until the expression is true. (The page's policy forbids Playwright's own way of waiting.)"""
        end = time.monotonic() + seconds
        while not (value := self.page.evaluate(expression)):
            if not runs():
                raise HostGone
            assert time.monotonic() < end, (
                f"never came true: {expression}; status {self.tell('haptorb.status')}; troubles {self.troubles}"
            )
            self.page.wait_for_timeout(40)
        return value

    def wait_for(self, condition: Callable[[], bool], what: Callable[[], object] = lambda: "") -> None:
        """Wait until something outside of the page is true, or what the page says; `what` tells of a failure."""
        end = time.monotonic() + 20.0
        while not condition():
            assert time.monotonic() < end, what()
            self.page.wait_for_timeout(20)

    def value(self, name: str) -> list[float]:
        """What the newest row that the page has says."""
        return self.tell(f"haptorb.value('{name}')")

    def force_at(self, direction: Any) -> float:
        """The painted map in a direction [N]."""
        return self.tell(f"haptorb.forceAt({[float(x) for x in direction]}).force")

    def hold(self, reach: float = 0.4) -> tuple[float, float]:
        """Press the mouse on the stylus or handle, `reach` of the way from its magnet to its end; the place."""
        for _ in range(40):  # the guided hand moves on while the mouse is on its way
            _, magnet, end = self.tell("haptorb.stylus()")
            x, y = (magnet[axis] + reach * (end[axis] - magnet[axis]) for axis in "xy")
            self.page.mouse.move(x, y)
            self.page.mouse.down()
            self.page.wait_for_timeout(60)
            if not self.tell("haptorb.control") or self.tell("document.querySelector('#scene.holding') !== null"):
                return x, y
            self.page.mouse.up()
        raise AssertionError("the stylus cannot be taken")

    def wait_until_still(self) -> None:
        """Wait until the stylus hangs still."""
        self.until("haptorb.value('p').every(Number.isFinite)")
        before = self.value("p")
        for _ in range(100):
            self.page.wait_for_timeout(120)
            now = self.value("p")
            if max(abs(a - b) for a, b in zip(before, now, strict=True)) < 1e-4:
                return
            before = now
        raise AssertionError("the stylus does not come to rest")


class Host:
    """The servo of `live_host.py`, asked from here."""

    def __init__(self) -> None:
        self.layout = RowLayout.of(load("omni"))
        pipes = dict.fromkeys(("stdin", "stdout"), subprocess.PIPE)
        self._process = get_fork_server().start_program(
            str(Path(__file__).with_name("live_host.py")), text=True, **pipes
        )
        self.url = self._read()

    def _read(self) -> Any:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line, "the host ended; its words are above"
        return json.loads(line)

    def ask(self, what: str, **more: Any) -> Any:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"what": what, **more}) + "\n")
        self._process.stdin.flush()
        return self._read()

    def latest(self, name: str) -> list[float]:
        """A field of the newest row."""
        return self.ask("latest")[self.layout[name]]

    def rows(self, cursor: int, *names: str) -> tuple[int, list[np.ndarray]]:
        """Fields (n, width) of all rows since `cursor`."""
        columns = [np.arange(self.layout.width)[self.layout[name]] for name in names]
        cursor, rows = self.ask("rows", cursor=cursor, columns=np.concatenate(columns).tolist())
        return cursor, np.split(np.array(rows), np.cumsum([len(column) for column in columns])[:-1], axis=1)

    def runs(self) -> bool:
        return self._process.poll() is None

    def close(self) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        try:
            self._process.wait(30)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()


@pytest.fixture
def open_servo(
    browser: Any, quick_starts: None
) -> Callable[[str, World | str], AbstractContextManager[tuple[Screen, Servo]]]:
    """A running servo of a device with a world, and its page. Its poses last a second: a busy test machine stutters."""

    @contextmanager
    def open_it(name: str, world: World | str) -> Iterator[tuple[Screen, Servo]]:
        device = load(name)
        servo = Servo(replace(device, limits=replace(device.limits, expiry=1.0)), world, record=False)
        with Console(servo, 0) as console, servo, serve(console):
            page = browser.new_page(viewport=DESK)
            yield Screen(page, f"{console.origin}/?detail=least#{console.token}"), servo
            page.close()

    return open_it


@pytest.fixture(scope="session")
def kit() -> Any:
    """This module, for tests that open a page of their own."""
    return sys.modules[__name__]


class LivePage:
    """A host and a page of it, for tests that leave both alive: to start and load them takes longer than most tests."""

    def __init__(self, browser: Any) -> None:
        self.host = Host()
        self._browser, self._pages = browser, list[Any]()
        self._crashed = False
        self.screen = self._open()

    def _open(self) -> Screen:
        self._pages.append(self._browser.new_page(viewport=DESK))
        self._pages[-1].on("crash", self._note_crash)
        return Screen(self._pages[-1], self.host.url.replace("#", "?detail=least#"), self.host.runs)

    def _note_crash(self, page: Any) -> None:
        self._crashed = True

    def restore(self) -> None:
        """A dome that runs, and a page that nobody has touched; another page where it has crashed."""
        if self._crashed:
            self.screen, self._crashed = self._open(), False
        self.host.ask("restore")
        self.screen.page.evaluate("document.activeElement.blur()")
        shown = f"document.getElementById('entry-moment')?.value === '{values(Dome())['moment']:g}'"
        self.screen.until(
            f"haptorb.control && haptorb.status === 'running' && haptorb.value('model')[0] === 0 && {shown}"
        )
        self.screen.troubles.clear()

    def close(self) -> None:
        for page in self._pages:
            page.close()
        self.host.close()


def open_live_page(browser: Any) -> LivePage:
    """A browser that starts on a busy machine can keep a host from its heart for half a second: its servo ends, and it
    with that. Then another one."""
    for _ in range(3):
        with suppress(HostGone):
            return LivePage(browser)
    raise AssertionError("three hosts ended before their pages were up; their words are above")


@pytest.fixture(scope="module")
def live_pages() -> Iterator[list[LivePage]]:
    """The host that a file's tests share, if it runs."""
    pages: list[LivePage] = []
    yield pages
    while pages:
        pages.pop().close()


@pytest.fixture
def live(browser: Any, live_pages: list[LivePage], request: pytest.FixtureRequest) -> Iterator[tuple[Screen, Host]]:
    """The real thing: servo with the simulated Omni, console, page; others after a failure."""
    if not live_pages:
        live_pages.append(open_live_page(browser))
    page, whole = live_pages[0], False
    try:
        page.restore()
        yield page.screen, page.host
        whole = not request.node.stash.get(FAILED, False) and page.host.runs()
    finally:
        if not whole:
            live_pages.pop().close()


@pytest.fixture
def fake() -> Any:
    return _fake().FakeServo()


@pytest.fixture(scope="session")
def painting() -> Iterator[ForceMapProcess]:
    """What paints the force map: a process that takes two seconds to load, for all imagined servos the same."""
    process = ForceMapProcess(load("omni"))
    yield process
    process.close()


@pytest.fixture
def staged(browser: Any, fake: Any, painting: ForceMapProcess) -> Iterator[Any]:
    """A function that shows the imagined servo on a page of a given size and theme."""
    pages = []
    with Console(fake, 0, force_map=painting) as console, serve(console):

        def show(width: int = 1280, height: int = 800, **options: Any) -> Screen:
            query, context = options.pop("query", ""), options.pop("context", None)
            every_frame = options.pop("every_frame", False)
            url = f"{console.origin}/{query}#{console.token}"
            size = {"width": width, "height": height}
            pages.append(context.new_page() if context else browser.new_page(viewport=size, **options))
            return Screen(pages[-1], url, every_frame=every_frame)

        show.console = console  # type: ignore[attr-defined]
        yield show
        for page in pages:
            page.close()


class SharedPage:
    """A page of an imagined servo for tests that leave it as it was loaded: to load one takes longer than they do."""

    def __init__(self, browser: Any, painting: ForceMapProcess) -> None:
        self.servo = _fake().FakeServo()
        with ExitStack() as opened:
            console = opened.enter_context(Console(self.servo, 0, force_map=painting))
            opened.enter_context(serve(console))
            page = browser.new_page(viewport=DESK)
            opened.callback(page.close)
            self.screen = Screen(page, f"{console.origin}/?detail=least#{console.token}")
            self._open = opened.pop_all()

    def restore(self) -> None:
        """A servo that runs, and a page that nobody has touched."""
        servo, page = self.servo, self.screen.page
        # What the last test's keys sent has come once a command that was sent after it has: a late STOP would be ours.
        cooled = servo.count("cool")
        self.screen.until("haptorb.control")
        page.evaluate("document.getElementById('cool').click()")
        self.screen.wait_for(lambda: servo.count("cool") > cooled, lambda: servo.calls)
        servo.guard, servo.trip, servo.coils = GuardState.RUNNING, Trip.NONE, CoilState.ON
        servo.silent, servo.model = False, "exact"
        servo.recording_trouble = servo.warning = ""
        # At once: a page that hears of another world has new fields, and what was typed into the old ones is gone.
        servo.set_world("dome", values(Dome()))
        servo.winding = np.array([303.0, 309.0, 298.5])
        page.evaluate("document.querySelectorAll('dialog[open]').forEach((one) => one.close())")
        page.evaluate("for (const id of ['watching', 'mistake', 'dropped']) document.getElementById(id).hidden = true")
        page.evaluate("document.activeElement.blur()")
        page.set_viewport_size(DESK)
        page.emulate_media(color_scheme="light", forced_colors="none")
        self.screen.until("haptorb.control && haptorb.status === 'running'")
        servo.calls.clear()

    def close(self) -> None:
        self._open.close()


@pytest.fixture(scope="module")
def shared_pages() -> Iterator[list[SharedPage]]:
    """The page that a file's tests share, if it is open."""
    pages: list[SharedPage] = []
    yield pages
    while pages:
        pages.pop().close()


@pytest.fixture
def shared(
    browser: Any, painting: ForceMapProcess, shared_pages: list[SharedPage], request: pytest.FixtureRequest
) -> Iterator[tuple[Screen, Any]]:
    """A page and the imagined servo behind it; after a failure the next test has another page."""
    if not shared_pages:
        shared_pages.append(SharedPage(browser, painting))
    page, whole = shared_pages[0], False
    try:
        page.restore()
        yield page.screen, page.servo
        whole = not request.node.stash.get(FAILED, False)
    finally:
        if not whole:
            shared_pages.pop().close()


@pytest.fixture(scope="session")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("certificate") / "both.pem"
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=127.0.0.1",
               "-keyout", str(made), "-out", str(made.with_name("public.pem"))]  # fmt: skip
    subprocess.run(command, check=True, capture_output=True)
    made.write_text(made.read_text() + made.with_name("public.pem").read_text())
    return made
