"""Benchmarks in separate programs: `haptorb check`, and those in the folder benchmarks of a clone.

They need a browser, a cross-compiled firmware or a database; in an installed package without the clone, or where one
of these is missing, its row says so.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from haptorb.child_process import python_command
from haptorb_bench.result import Metric

__all__ = ["console", "loop", "serial", "study"]

_CLONE = Path(__file__).resolve().parents[2]
_FAST = 4000  #: [Hz]


def loop(effort: float, notify: Callable[[str], None]) -> list[Metric]:
    """The servo in its own process with a client that drags, 30 s times `effort`."""
    seconds = max(30.0 * effort, 3.0)
    notify(f"{seconds:.0f} s of 1 kHz")
    facts = _run_and_parse(python_command("haptorb", "check", "--duration", f"{seconds:g}", "--json"))
    fast = [_run_fast(device, seconds, notify) for device in ("omni", "pmsm")]
    if isinstance(facts, str):
        return [Metric("loop", "servo at 1 kHz with a client that drags", None, "", note=facts), *fast]
    return [
        Metric("loop", "ticks on time", facts["success_rate"], "1", limit=0.999, at_least=True),
        Metric("loop", "lateness, 99 %", facts["lateness_us"]["p99"], "µs", limit=150.0),
        Metric("loop", "compute per tick, median", facts["compute_us"]["p50"], "µs", limit=60.0),
        Metric("loop", "compute per tick, 99 %", facts["compute_us"]["p99"], "µs"),
        *fast,
    ]


def _run_fast(device: str, seconds: float, notify: Callable[[str], None]) -> Metric:
    """`device` alone at 4 kHz for so long [s]: snapshots of the chain, too, must not make a tick late.

    Directly after it cyclictest, with the same scheduler and priority on the same core: a virtual machine whose host
    takes the processor away has late wakes whatever runs on them.
    """
    notify(f"{device}, {seconds:.0f} s of 4 kHz")
    words = ["run", device, "--rate", f"{_FAST}", "--headless", "--duration", f"{seconds:g}", "--json"]
    facts = _run_and_parse(python_command("haptorb", *words))
    what = f"{device} at 4 kHz, ticks on time"
    if isinstance(facts, str):
        return Metric("loop", what, None, "1", limit=0.9995, at_least=True, note=facts)
    notify(f"cyclictest, {seconds:.0f} s of 4 kHz")
    needed = round(facts["compute_us"]["p50"])
    bare = _bare_share(facts["scheduler"], int(seconds), needed)
    known = not isinstance(bare, str)
    return Metric(
        *("loop", what, facts["success_rate"], "1", f"cyclictest that needs {needed} µs a tick" if known else ""),
        *(float(bare) if known else None, 0.9995),
        at_least=True,
        note="" if known else f"cyclictest: {bare}",
    )


def _bare_share(scheduler: dict[str, Any], seconds: int, needed: int) -> float | str:
    """Share of a bare timer's wakes at 4 kHz that leave `needed` [µs] of the period; or why there is none."""
    program = shutil.which("cyclictest")
    if program is None:
        return "not installed (Debian: rt-tests)"
    period = 1_000_000 // _FAST
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "latencies.json")
        words = ["--mlockall", "--quiet", f"--interval={period}", f"--duration={max(seconds, 1)}", f"--json={path}"]
        words += [f"--histogram={period}", f"--affinity={max(scheduler['core'], 0)}"]
        if scheduler["policy"] == "SCHED_FIFO":
            words += ["--policy=fifo", f"--priority={scheduler['priority']}"]
        done = subprocess.run([program, *words], capture_output=True, text=True, check=False)
        if done.returncode or not path.exists():
            return f"failed: {(done.stderr.strip().splitlines() or ['no message'])[-1][:120]}"
        return count_in_time(json.loads(path.read_text(encoding="utf-8")), period - needed)


def count_in_time(report: dict[str, Any], latest: float) -> float:
    """Share of the wakes that cyclictest's JSON `report` counts up to `latest` [µs] after their time.

    >>> count_in_time({"thread": {"0": {"histogram": {"2": 7, "90": 2, "201": 1}, "cycles": 12}}}, 200.0)
    0.75
    """
    thread = report["thread"]["0"]  # wakes above the histogram are in "cycles" alone
    return float(sum(wakes for late, wakes in thread["histogram"].items() if float(late) <= latest) / thread["cycles"])


def console(effort: float, notify: Callable[[str], None]) -> list[Metric]:
    """From a drag in a real browser to the force drawn, 30 s times `effort`."""
    notify("a browser that drags")
    facts = _script("console_latency", "--seconds", f"{max(30 * effort, 2):g}")
    if isinstance(facts, str):
        return [Metric("console", "from drag to force shown, median", None, "ms", limit=25.0, note=facts)]
    drawn = f"renderer {facts['renderer']}"
    return [
        Metric("console", "from drag to force shown, median", facts["median_ms"], "ms", limit=25.0, note=drawn),
        Metric("console", "the same, 90 %", facts["p90_ms"], "ms"),
        Metric("console", "from drag to force arrived, median", facts["arrived_median_ms"], "ms"),
        Metric("console", "ticks on time beside the browser", facts["success_rate"], "1", limit=0.999, at_least=True),
        Metric("console", "processor time that a virtual machine's host kept", facts["stolen_share"], "1"),
    ]


def serial(effort: float, notify: Callable[[str], None]) -> list[Metric]:
    """Set and read back three coils through the emulated firmware, 2000 times `effort`."""
    notify("the emulated firmware")
    facts = _script("serial_cycle", "--cycles", str(max(int(2000 * effort), 200)))
    what = "set three coils and read back, emulated firmware, median"
    if isinstance(facts, str):
        return [Metric("serial", what, None, "ms", limit=1.0, note=facts)]
    return [
        Metric("serial", what, facts["round trip on this computer, median [ms]"], "ms", limit=1.0),
        Metric("serial", "the same, 99 %", facts["round trip on this computer, 99 % [ms]"], "ms"),
        Metric("serial", "processor of the host", facts["host CPU [%]"], "%", limit=10.0),
    ]


def study(effort: float, notify: Callable[[str], None]) -> list[Metric]:
    """Numbers and report of a study of 300 trials, 6 people with 50 each; merge of two databases of 30 people each."""
    notify("300 trials")
    facts = _script("study/study_analysis", "--people", "6", "--trials", "50", "--procedures", "identification")
    if isinstance(facts, str):
        return [Metric("study", "analysis of 300 trials, report included", None, "s", note=facts)]
    (run,) = facts["runs"]
    notify("merge of two databases")
    merged = _script("study/study_merge")
    what = "merge of two databases of 30 people each"
    return [
        Metric("study", f"analysis of {run['trials']} trials, numbers", run["numbers_s"], "s"),
        Metric("study", f"analysis of {run['trials']} trials, report included", run["with_report_s"], "s"),
        Metric("study", what, None, "s", limit=5.0, note=merged)
        if isinstance(merged, str)
        else Metric("study", what, merged["seconds"], "s", limit=5.0, note="data lost" if merged["lost"] else ""),
    ]


def _script(name: str, *words: str) -> dict[str, Any] | str:
    path = _CLONE / "benchmarks" / f"{name}.py"
    if not path.is_file():
        return "needs a clone of the project"
    return _run_and_parse([sys.executable, str(path), *words, "--json"])


def _run_and_parse(command: list[str]) -> dict[str, Any] | str:
    """What the command printed, or in a few words why it printed nothing."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
        facts: dict[str, Any] = json.loads(done.stdout)
    except subprocess.TimeoutExpired:
        return "took longer than ten minutes"
    except json.JSONDecodeError:
        return f"failed: {(done.stderr.strip().splitlines() or ['no message'])[-1][:120]}"
    return facts
