"""Start-up: time from the command to the first tick, time of the help, and memory of a run."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import monotonic, process_time, sleep

import haptorb
from haptorb import worlds
from haptorb.child_process import python_command
from haptorb.errors import HaptorbError
from haptorb.recording.recording import Recording
from haptorb.recording.row import RowLayout
from haptorb.runtime.assembly import assemble
from haptorb.runtime.config import RunConfig
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.warm_up import dry_run
from haptorb.terminal import echo
from haptorb_bench.result import Metric

__all__ = ["rows", "time_single_process_warm_up"]

_MINE = python_command("haptorb")
_STARTED = monotonic()  #: import of this module [s]


def rows(effort: float, notify: Callable[[str], None]) -> list[Metric]:
    """Medians of five starts times `effort`, compiled code at hand; the memory of one run with its console."""
    times = max(round(5 * effort), 1)
    notify("starting and ending")
    _first_tick()  # compiles what is not compiled yet
    first = median(_first_tick() for _ in range(times))
    help_time = median(_run(*_MINE, "--help") for _ in range(times))
    read = median(_run(sys.executable, "-P", "-c", "import haptorb; haptorb.load('pmsm')") for _ in range(times))
    megabytes = _memory()
    return [
        Metric("start", "`haptorb run`, from the command to the first tick, median", first, "s", limit=4.0),
        Metric("start", "`haptorb --help`, median", help_time, "s", limit=0.4),
        Metric("start", "a device file read by a Python program, median", read, "s", limit=1.0),
        Metric("start", "memory of servo, console and what belongs to them", megabytes, "MB", limit=400.0,
            note="" if megabytes is not None else "measured on Linux only"),
    ]  # fmt: skip


def time_single_process_warm_up(device: str) -> None:
    """Print the time in which one process loads or compiles controller, simulated device and all catalogue worlds.

    With an empty cache, such as by `XDG_CACHE_HOME=$(mktemp -d)`, this is the cost of a blocking first start.
    """
    config = RunConfig.of(haptorb.load(device))
    chain, row = assemble(config, PointerTracker()), RowLayout.of(config.device).empty()
    with chain.driver:
        for tick in range(5):
            chain.prepare(tick / config.rate)
            chain.step(row, tick / config.rate)
        _print_time("controller and simulated device")
        for kind in worlds.CATALOGUE.values():
            tick += 1
            try:
                dry_run(chain, kind(), row, tick / config.rate)
            except HaptorbError as refused:
                echo(f"{kind.__name__}: {refused}")
            _print_time(kind.__name__)


def _print_time(what: str) -> None:
    echo(f"{what:<32} {monotonic() - _STARTED:6.1f} s  {process_time():6.1f} s of processor time")


def _first_tick() -> float:
    """[s] from the command to the loop's first tick, on the clock that all processes share."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "run.mcap"
        start = monotonic()
        subprocess.run(
            [*_MINE, "run", "--headless", "--duration", "0.1", "--json", "--record", str(file)],
            check=True, capture_output=True,
        )  # fmt: skip
        return float(Recording(file)["wall"][0]) - start


def _run(*command: str) -> float:
    """[s] that a program takes from its start to its end."""
    start = monotonic()
    subprocess.run(command, check=True, capture_output=True)
    return monotonic() - start


def _memory() -> float | None:
    """[MB] of a run with its console after 2 s of ticks: its processes' own pages, and their parts of shared ones."""
    run = subprocess.Popen([*_MINE, "run", "--port", "0"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    try:
        assert run.stderr is not None
        while "Open http" not in run.stderr.readline():
            if run.poll() is not None:
                return None
        sleep(2.0)
        return sum(_pages(number) for number in (run.pid, *_descendants(run.pid))) / 1e6
    except OSError:
        return None
    finally:
        run.terminate()
        run.communicate()


def _descendants(number: int) -> list[int]:
    children: list[int] = []
    for task in Path(f"/proc/{number}/task").iterdir():
        for child in (task / "children").read_text().split():
            children += [int(child), *_descendants(int(child))]
    return children


def _pages(number: int) -> int:
    for line in Path(f"/proc/{number}/smaps_rollup").read_text().splitlines():
        if line.startswith("Pss:"):
            return 1024 * int(line.split()[1])
    return 0


if __name__ == "__main__":
    time_single_process_warm_up(*sys.argv[1:] or ["omni"])
