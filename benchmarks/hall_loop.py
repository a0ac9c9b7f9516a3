"""Real-time loop of the emulated firmware with the tool's pose from its Hall sensors only.

    python benchmarks/hall_loop.py [--runs 3] [--seconds 10] [--rate 1000] [--tracker hall] [--json]

`haptorb hardware emulate` in one process and `haptorb run --driver serial:… --tracker hall` in others, a dome under a
tool that is held 52 mm above the centre. A run ends well if nothing trips; the emulator needs half a core, so on two
cores this says as much about the computer as about the loop.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

from haptorb_bench.outside import HAPTORB

BUILD = Path(__file__).resolve().parents[1] / "firmware" / "build"
#: sensors with noise and steps only: what turns and lateness cost is measured here
IDEAL = """based_on = "omni"
name = "omni-ideal"
[hall]
offset = "0 mT"
gain = 0
cross = 0
placement = "0 mm"
angle = "0 deg"
[core_dynamics]
eddy_share = 0
remanent_moment = "0 A*m^2"
"""
MINE = [sys.executable, "-c", HAPTORB]


def run(device: Path, port: Path, seconds: float, rate: float, tracker: str) -> dict[str, Any]:
    """One run's report."""
    words = ["run", str(device), "--driver", f"serial:{port}", "--tracker", tracker, "--headless", "--json"]
    words += ["--duration", f"{seconds:g}", "--rate", f"{rate:g}"]
    done = subprocess.run([*MINE, *words], capture_output=True, text=True, check=False, timeout=seconds + 120)
    if done.returncode:
        raise SystemExit(f"the run failed: {done.stderr.strip()}")
    report: dict[str, Any] = json.loads(done.stdout)
    return report


def measure(runs: int, seconds: float, rate: float, tracker: str) -> dict[str, Any]:
    """What came of each run, and how many ended well."""
    with tempfile.TemporaryDirectory() as folder:
        port, device = Path(folder, "omni"), Path(folder, "omni-ideal.toml")
        device.write_text(IDEAL, encoding="utf-8")
        words = ["hardware", "emulate", str(device), "--height", "52", "--port", str(port), "--build", str(BUILD)]
        with subprocess.Popen([*MINE, *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as emulator:
            try:
                while not port.exists():
                    if emulator.poll() is not None:
                        raise SystemExit(f"no emulator: {emulator.communicate()[1].decode().strip()}")
                    time.sleep(0.1)
                reports = [run(device, port, seconds, rate, tracker) for _ in range(runs)]
            finally:
                emulator.terminate()
    held = [report["trips"][0]["t"] if report["trips"] else seconds for report in reports]
    return {
        "runs": runs,
        "without a trip": sum(not report["trips"] for report in reports),
        "until the first trip [s]": [round(one, 2) for one in held],
        "reasons": [report["trips"][0]["code"] for report in reports if report["trips"]],
        "ticks on time [%]": [round(100 * report["success_rate"], 1) for report in reports],
        "peak force, median [N]": round(median(report["peak_force_n"] for report in reports), 3),
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--tracker", default="hall", help="hall, or pointer: nobody says where the tool is")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    result = measure(given.runs, given.seconds, given.rate, given.tracker)
    if given.json:
        print(json.dumps(result))
        return
    for name, value in result.items():
        print(f"{name:28s} {value}")


if __name__ == "__main__":
    main()
