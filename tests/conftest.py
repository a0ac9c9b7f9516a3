"""Common settings of all tests: fixed random examples, no display, order, and reasons of skipped tests."""

from __future__ import annotations

import gc
import os
import re
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterator
from functools import cache, wraps
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from failures import FAILED
from oracles.fork_server import ForkServer, get_fork_server
from oracles.program_runner import ProgramRunner
from oracles.repetitions import repetitions

ROOT = Path(__file__).resolve().parent.parent

os.environ.setdefault("MPLBACKEND", "Agg")

# xdist tells its processes how wide the terminal is: texts for people would be wrapped there, and only there.
os.environ.pop("COLUMNS", None)

# The matrices are small: a second thread of OpenBLAS waits in a loop, and on a busy machine for the first one's turn
# (a Cholesky factor of 350 rows then takes 0.4 s instead of 4 ms). Before numpy is imported; children inherit it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A shell starts what runs in its background with Ctrl-C ignored, and programs under test would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Six thousand tests and all packages are objects that stay: to look through them every 700 new ones took a tenth of
# the time.
gc.set_threshold(50_000, 20, 20)

# The same examples in every run: a red test stays red until somebody mends it. No deadline: the first call compiles.
# Nor a limit on how long drawing an example may take: that would be a test of the machine's other tenants.
settings.register_profile(
    "fixed",
    derandomize=True,
    deadline=None,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow],
    max_examples=repetitions(40, 100),
)
settings.load_profile("fixed")


def _build_devices_once() -> None:
    """Devices are immutable: in this process each text is built once, although nearly every test module loads some (20
    to 70 ms each, and again for the tables that a device computes when they are needed). To read it takes 3 ms."""
    from haptorb.devices import loader

    build, built = loader.build_tables, dict[Any, Any]()

    def build_tables(tables: Any, *, override: bool = False) -> Any:
        kind = str(tables.values.get("kind"))
        if tables.file is None or tables.name not in _CATALOGUE:
            return build(tables, override=override)
        key = (tables.name, tables.text, override, kind)
        if key not in built:
            built[key] = build(tables, override=override)
        return built[key]

    loader.build_tables = build_tables


_SPECIMENS = 200  #: that are kept
_CATALOGUE = frozenset(path.stem for path in (ROOT / "src/haptorb/devices/catalogue").glob("*.toml"))
_build_devices_once()

#: files, or folders whose files share what one of them made: begun first where several processes share the tests,
#: because whoever gets one of these at the end keeps the others waiting. While one process compiles the kernels, the
#: other tests studies, which need few; documentation and examples find the kernels compiled.
HEAVY = (
    *("test_tools.py", "papers", "test_docs.py", "test_result.py", "study", "test_docs_code.py", "test_examples.py"),
    *("firmware", "test_safety.py", "test_console_page.py", "test_study_pages.py"),  # of those beside a clock
)
CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
# Each window's address bar has two pages of its own, which take a second to load and which nobody sees; the others are
# what Playwright switches off, and would be on again.
CHROMIUM_FEATURES = (
    *("WebUIOmniboxPopup", "WebUIOmniboxAimPopup", "AimEnabled", "LensOverlay", "MediaRouter", "OptimizationHints"),
    *("HttpsUpgrades", "HttpsFirstBalancedModeAutoEnable", "PaintHolding", "ThirdPartyStoragePartitioning"),
    *("AvoidUnnecessaryBeforeUnloadCheckSync", "DestroyProfileOnBrowserClose", "AvoidCorsURLLoaderRestartOnRedirect"),
    *("NetworkTimeServiceQuerying", "PreconnectToSearch"),
)
CHROMIUM_FLAGS = [
    *("--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync", f"--disable-features={','.join(CHROMIUM_FEATURES)}"),
]
FIRMWARE = {
    "avr-gcc": lambda: shutil.which("avr-gcc"),
    "avr-libc": lambda: Path("/usr/lib/avr/include/avr/io.h").exists(),
    "libsimavr-dev": lambda: Path("/usr/include/simavr/sim_avr.h").exists(),
    "libelf-dev": lambda: Path("/usr/include/libelf.h").exists(),
    "gcc": lambda: shutil.which("gcc"),
}


def _why_missing() -> str:
    note = ROOT / ".packages-missing"
    return f"; {note.read_text().strip()}" if note.exists() else "; `make test` installs it where it may"


@cache
def _read(path: Path) -> str:
    return path.read_text(encoding="utf-8")


class _Selection:
    """Which files are read. It is a plugin because the hooks of this file itself act below its folder only, and most
    files are above: the modules."""

    @pytest.hookimpl(wrapper=True)
    def pytest_collect_file(self, file_path: Path) -> Generator[None, list[Any], list[Any]]:
        """Look for examples in no test module that has none: to look at every object takes a second."""
        found = yield
        if file_path.suffix != ".py" or ">>>" in _read(file_path):
            return found
        return [one for one in found if type(one).__name__ != "DoctestModule"]

    def pytest_ignore_collect(self, collection_path: Path, config: pytest.Config) -> bool | None:
        """Read no file whose tests all belong to another call of `scripts/run_tests.py`, and no module without an
        example: all take half a minute."""
        if collection_path.suffix != ".py" or collection_path.name == "conftest.py":
            return None
        text = _read(collection_path)
        if not collection_path.is_relative_to(ROOT / "tests") and ">>>" not in text:
            return True
        wanted = config.option.markexpr.split(" and ")
        if "realtime" not in wanted[0]:
            return None
        for marker in ("realtime", "browser"):
            everywhere = re.search(rf"^pytestmark = .*\bmark\.{marker}\b", text, re.MULTILINE)
            if (marker in wanted and f"mark.{marker}" not in text) or (f"not {marker}" in wanted and everywhere):
                return True
        return None


def pytest_configure(config: pytest.Config) -> None:
    """Apply the selection to all folders."""
    config.pluginmanager.register(_Selection())


def _group(nodeid: str) -> str:
    """What one process gets whole: a file, or a folder of HEAVY. Two emulated boards at once would keep each other
    waiting: each needs most of a processor."""
    path = nodeid.split("::")[0]
    return next((part for part in path.split("/") if part in HEAVY), path)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give groups to processes. The marks that xdist has for this are without effect from pytest 9.2 on."""
    from xdist.scheduler import LoadScopeScheduling

    class GroupScheduling(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return _group(nodeid)

    return GroupScheduling(config, log)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Group and order the tests, give those beside a clock another try, skip what needs a program that is not here."""
    skips = {}
    if not any(shutil.which(name) for name in CHROMIUM):
        skips["browser"] = f"no Chromium on this machine{_why_missing()}"
    lacking = [name for name, found in FIRMWARE.items() if not found()]
    if lacking:
        skips["firmware"] = f"no {', '.join(lacking)} on this machine{_why_missing()}"
    groups = {item: _group(item.nodeid) for item in items}
    items.sort(key=lambda item: HEAVY.index(groups[item]) if groups[item] in HEAVY else len(HEAVY))
    retries = bool(items) and items[0].config.pluginmanager.hasplugin("rerunfailures")  # not where a rule is broken
    for item in items:
        beside_a_clock = item.get_closest_marker("realtime")
        # Three times at the most, and the summary counts every further try.
        if beside_a_clock and beside_a_clock.kwargs.get("retry", True) and retries:
            item.add_marker(pytest.mark.flaky(reruns=2, reruns_delay=3))
        for marker, reason in skips.items():
            if item.get_closest_marker(marker):
                item.add_marker(pytest.mark.skip(reason=reason))


def _freeze() -> None:
    """Look for garbage now, and no more in what exists now: millions of objects, most of a second for every server that
    a test starts."""
    gc.collect()
    gc.freeze()
    _UNFROZEN.clear()


def pytest_collection_finish() -> None:
    """What the tests are made of stays to the end: nothing of it is garbage."""
    _freeze()


_TURN = sys.getswitchinterval()
_UNFROZEN = threading.Event()


def _note_unfreeze(unfreeze: Callable[[], None] = gc.unfreeze) -> None:
    unfreeze()
    _UNFROZEN.set()


# `gc.get_freeze_count` walks along all that is frozen: 25 to 60 ms after each of nine thousand tests.
gc.unfreeze = _note_unfreeze


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Let a test's fixtures know whether it failed."""
    report = yield
    if report.when != "teardown":
        item.stash[FAILED] = report.outcome not in ("passed", "skipped")
    return report


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown() -> None:
    """Be an ordinary program again after a command that talked to a firmware, and came before all others for that.

    What it leaves to this process is its until it ends: the tests after it would starve those of the other process.
    """
    if sys.getswitchinterval() != _TURN:
        sys.setswitchinterval(_TURN)
        gc.unfreeze()
    if _UNFROZEN.is_set():
        _freeze()
    if hasattr(os, "sched_getscheduler") and os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK != os.SCHED_OTHER:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


@pytest.fixture
def check_limit(request: pytest.FixtureRequest) -> Callable[[str, float, float, str], None]:
    """Checks a measured value against the limit of a promise; pytest's summary prints both."""

    def check(what: str, value: float, limit: float, unit: str) -> None:
        text = f"{what}: {value:.4g} {unit} (limit {limit:g} {unit})"
        request.node.user_properties.append(("measured", text))
        assert value <= limit, text

    return check


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Print what `check_limit` measured."""
    reports = [one for kind in ("passed", "failed") for one in terminalreporter.stats.get(kind, [])]
    texts = [text for one in reports for name, text in getattr(one, "user_properties", []) if name == "measured"]
    if texts:
        terminalreporter.section("measured against the limits of promises")
        terminalreporter.write_line("\n".join(texts))


@pytest.fixture(scope="session", autouse=True)
def _draw_electromagnets_once() -> Iterator[None]:
    """In this process a specimen, and the data of its coils and core for compiled code, is computed once: 0.1 s for
    each simulation of the Omni, of which most tests of the loop make one. Nobody writes to them."""
    from haptorb.simulation import electromagnet, electromagnet_specimen

    draw, compute = electromagnet.draw_electromagnet, electromagnet_specimen.ElectromagnetSpecimen.compute_map
    drawn, maps = dict[Any, Any](), dict[Any, Any]()

    def draw_once(device: Any, specimen: int = 0, steel: Any = None) -> Any:
        if steel is not None:
            return draw(device, specimen, steel)
        key = id(device), specimen
        if key not in drawn:
            if len(drawn) >= _SPECIMENS:
                drawn.clear()
                maps.clear()
            drawn[key] = device, draw(device, specimen)  # with the device, so that its id is nobody else's
            maps[id(drawn[key][1])] = {}
        return drawn[key][1]

    @wraps(compute)
    def compute_once(built: Any, nearest: float) -> Any:
        made = maps.get(id(built))
        if made is None:
            return compute(built, nearest)
        if nearest not in made:
            made[nearest] = compute(built, nearest)
        return made[nearest]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(electromagnet, "draw_electromagnet", draw_once)
        patch.setattr(electromagnet_specimen.ElectromagnetSpecimen, "compute_map", compute_once)
        yield


@pytest.fixture(scope="session")
def root() -> Path:
    """The folder that the project lies in."""
    return ROOT


@pytest.fixture(scope="session")
def programs() -> Iterator[ProgramRunner]:
    """What runs the programs of documentation and examples."""
    runner = ProgramRunner()
    yield runner
    runner.close()


@pytest.fixture(scope="session")
def fork_server() -> Iterator[ForkServer]:
    """What starts programs quickly, and servo processes as long as `quick_starts` lets it."""
    yield get_fork_server()
    get_fork_server().close()
    get_fork_server.cache_clear()


@pytest.fixture(scope="module")
def quick_starts(fork_server: ForkServer) -> Iterator[None]:
    """Processes of servos that a file's tests start are copies of one that has loaded its packages: most of a second
    less for each."""
    from haptorb.runtime import linux

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(linux, "subprocess", SimpleNamespace(Popen=fork_server.start))
        yield


@pytest.fixture(scope="session")
def chromium() -> str:
    """Path of the Chromium that browser tests drive."""
    found = next(filter(None, map(shutil.which, CHROMIUM)), None)
    if found is None:
        pytest.skip(f"no Chromium on this machine{_why_missing()}")
    return found


@pytest.fixture(scope="session")
def browser(chromium: str) -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=chromium, args=CHROMIUM_FLAGS)
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def reproduction():
    """(paper, name) → that part of `haptorb reproduce`, made once for all tests of a run."""
    from haptorb_papers.reproduce import ReproductionResult, find_reproduction

    @cache
    def make(paper: str, name: str) -> ReproductionResult:
        one, shares = find_reproduction(paper, name), []
        result = ReproductionResult(one, *one.make(shares.append))
        assert shares == sorted(shares)
        assert shares[-1] == 1.0  # what is told of the progress
        return result

    return make
