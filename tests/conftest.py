"""What all tests share: fixed random examples, no display, the order, and a reason for what cannot run here."""

from __future__ import annotations

import importlib.util
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

ROOT = Path(__file__).resolve().parent.parent

os.environ.setdefault("MPLBACKEND", "Agg")

# The matrices are small: a second thread of OpenBLAS waits in a loop, and on a busy machine for the first one's turn
# (a Cholesky factor of 350 rows then takes 0.4 s instead of 4 ms). Before numpy is imported; children inherit it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# The same examples in every run: a red test stays red until somebody mends it. No deadline: the first call compiles.
# Nor a limit on how long drawing an example may take: that would be a test of the machine's other tenants.
settings.register_profile(
    "fixed", derandomize=True, deadline=None, print_blob=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("fixed")

#: folders and files whose tests run beside a clock: a browser, an emulator, a servo or a server in a process of its
#: own. They can lose it to the machine's other tenants: they may try again
AGAINST_TIME = {
    *("browser", "firmware", "test_black_box.py", "test_cli.py", "test_console.py", "test_design_session.py"),
    *("rail", "test_frame.py", "test_framed_feed.py", "test_hall_loop.py", "test_motor_chain.py", "test_pages.py"),
    *("test_postgres.py", "test_recording.py", "test_socket_hub.py", "test_terminal_session.py", "test_safety.py"),
    *("test_serial_port.py", "test_servo.py", "test_streams.py", "test_trackers.py", "test_tutorial.py"),
}
#: where several processes share the tests, these wait for the second phase; beside AGAINST_TIME those that need a
#: processor for themselves and pass at once when they have it
ALONE = AGAINST_TIME | {"test_check.py", "test_drivers.py", "test_schedule.py", "test_keep_core_awake.py"}
#: begun first where several processes share the tests: whoever gets one of these at the end keeps the others waiting
HEAVY = ("test_docs.py", "test_result.py", "reproduce", "test_tools.py", "test_examples.py")
CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
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


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip, with the reason, what needs a program that this machine lacks."""
    skips = {}
    if not any(shutil.which(name) for name in CHROMIUM):
        skips["browser"] = f"no Chromium on this machine{_why_missing()}"
    lacking = [name for name, found in FIRMWARE.items() if not found()]
    if lacking:
        skips["firmware"] = f"no {', '.join(lacking)} on this machine{_why_missing()}"
    for item in items:
        # Three times at the most, and the summary counts every further try.
        if AGAINST_TIME & set(item.path.parts):
            item.add_marker(pytest.mark.flaky(reruns=2, reruns_delay=3))
        for marker, reason in skips.items():
            if item.get_closest_marker(marker):
                item.add_marker(pytest.mark.skip(reason=reason))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """`-n 2`: two processes share the tests, see `two_phases.py`."""
    spec = importlib.util.spec_from_file_location("two_phases", Path(__file__).with_name("two_phases.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.TwoPhases(config, log, lambda file: ALONE & set(Path(file).parts), HEAVY)


@pytest.fixture(scope="session")
def root() -> Path:
    """The folder that the project lies in."""
    return ROOT


@pytest.fixture(scope="session")
def chromium() -> str:
    """Path of the Chromium that browser tests drive."""
    found = next(filter(None, map(shutil.which, CHROMIUM)), None)
    if found is None:
        pytest.skip(f"no Chromium on this machine{_why_missing()}")
    return found


@pytest.fixture(scope="session")
def reproduction():
    """(paper, name) → that part of `haptorb reproduce`, made once for all tests of a run."""
    from functools import cache

    from haptorb.apps.reproduce import ReproductionResult, find_reproduction

    @cache
    def made(paper: str, name: str) -> ReproductionResult:
        one = find_reproduction(paper, name)
        return ReproductionResult(one, *one.make())

    return made
