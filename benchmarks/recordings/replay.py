"""Speed and bit-exactness of replay: one minute of every device with every estimator.

    python benchmarks/recordings/replay.py [--seconds 60] [--cases omni/tracker,pmsm/linear] [--folder DIR] [--json]

Each run is a real one, `haptorb run --headless --record`, and each replay a command of its own: its time is that of the
ticks, with the loading of compiled code and without the start of Python, which is in `command`. The network estimator
is there where one has been trained.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from haptorb.devices.loader import load
from haptorb.errors import HaptorbError
from haptorb.estimation.registry import check_estimator, list_estimators

_PROGRAM = "import sys; from haptorb.cli.program import main; sys.exit(main())"
_HOUR = 3600.0


def list_cases() -> list[str]:
    """Device and estimator of everything that can run here."""
    found = []
    for name in ("omni", "pmsm"):
        device = load(name)
        for estimator in tuple(list_estimators(device)):
            try:
                check_estimator(device, estimator)
            except HaptorbError:
                continue
            found.append(f"{name}/{estimator}")
    return found


def run_haptorb(*words: str) -> tuple[int, dict[str, Any]]:
    """Exit code and JSON of a command."""
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM, *words, "--json"], capture_output=True, text=True, check=False
    )
    if done.returncode not in (0, 1):
        raise SystemExit(f"haptorb {' '.join(words)}: {done.stderr.strip()}")
    return done.returncode, json.loads(done.stdout)


def measure_case(case: str, seconds: float, folder: Path) -> dict[str, Any]:
    """Record, replay, and say how long it took and whether it was the same."""
    device, _, estimator = case.partition("/")
    file = folder / f"{device}-{estimator}.mcap"
    _, report = run_haptorb(
        "run", device, "--estimator", estimator, "--headless", "--duration", f"{seconds:g}", "--record", str(file)
    )
    start = time.perf_counter()
    code, found = run_haptorb("replay", str(file))
    whole = time.perf_counter() - start
    return {
        "case": case,
        "identical": found["identical"] and code == 0,
        "ticks": found["ticks"],
        "numbers": found["numbers_compared"],
        "run_s": found["duration_s"],
        "replay_s": found["took_s"],
        "command_s": whole,
        "times_real_time": found["times_real_time"],
        "on_time": report.get("on_time"),
        "bytes_per_hour": file.stat().st_size / found["duration_s"] * _HOUR,
    }


def main() -> None:
    """Measure, and print for people or machines."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--cases", default=",".join(list_cases()))
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    load_before = os.getloadavg()[0]
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        cases = [measure_case(case, options.seconds, Path(folder)) for case in options.cases.split(",")]
    if options.json:
        print(json.dumps({"load_before": load_before, "cases": cases}, indent=1))
        return
    print(f"load before: {load_before:.2f}")
    print(f"{'case':22} {'same bits':>9} {'ticks':>7} {'replay':>8} {'times':>6} {'command':>8} {'file':>9}")
    for one in cases:
        same = "yes" if one["identical"] else "NO"
        print(
            f"{one['case']:22} {same:>9} {one['ticks']:7d} {one['replay_s']:6.2f} s {one['times_real_time']:5.1f}x "
            f"{one['command_s']:6.2f} s {one['bytes_per_hour'] / 1e9:4.1f} GB/h"
        )


if __name__ == "__main__":
    main()
