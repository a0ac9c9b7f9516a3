"""All benchmarks, one after the other, as one table with the facts of this machine: `make bench`.

    python -m benchmarks [NAME ...] [--json]

A benchmark is a command that prints one JSON object for `--json`: one of haptorb's own, or another program in this
folder. Each is started in a process of its own, so none disturbs the next.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parent
HAPTORB = str(Path(sys.executable).parent / "haptorb")
COMMANDS: dict[str, list[str]] = {
    "loop": [HAPTORB, "check"],
    "magnetics": [HAPTORB, "bench", "magnetics"],
    **{path.stem: [sys.executable, str(path)] for path in sorted(FOLDER.glob("[a-z]*.py"))},
}


def machine() -> dict[str, str | int]:
    """What the numbers were measured on."""
    facts = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    model = next((line.split(":")[1].strip() for line in facts if line.startswith("model name")), "unknown")
    return {
        "processor": model,
        "cores": len(os.sched_getaffinity(0)),
        "load before": round(os.getloadavg()[0], 1),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "haptorb": version("haptorb"),
        "numba": version("numba"),
        "numpy": version("numpy"),
    }


def measured(name: str) -> dict[str, Any]:
    """What the benchmark `name` prints, or why it printed nothing."""
    done = subprocess.run([*COMMANDS[name], "--json"], capture_output=True, text=True, check=False)
    try:
        result: dict[str, Any] = json.loads(done.stdout)
    except json.JSONDecodeError:
        return {"failed": (done.stderr.strip().splitlines() or ["no message"])[-1]}
    return result


def flat(result: dict[str, Any], prefix: str = "") -> list[tuple[str, object]]:
    """Nested results as (dotted name, value) lines."""
    lines: list[tuple[str, object]] = []
    for key, value in result.items():
        lines += flat(value, f"{prefix}{key}.") if isinstance(value, dict) else [(f"{prefix}{key}", value)]
    return lines


def main() -> int:
    """Run what was asked for and print it; returns the exit code."""
    known = sorted(COMMANDS)
    parser = argparse.ArgumentParser(prog="benchmarks", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(known)}; all if none is given")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    if strange := sorted(set(given.names) - set(known)):
        parser.error(f"unknown benchmark '{strange[0]}' (known: {', '.join(known)})")
    results: dict[str, Any] = {"machine": machine()}
    for name in given.names or known:
        print(f"{name} ...", file=sys.stderr, flush=True)
        results[name] = measured(name)
    if given.json:
        print(json.dumps(results, indent=2, ensure_ascii=False))
    else:
        for name, result in results.items():
            print(f"\n{name.replace('_', ' ')}")
            for key, value in flat(result):
                print(f"  {key.replace('_', ' '):<36} {value}")
    return int(any("failed" in result for result in results.values()))


if __name__ == "__main__":
    sys.exit(main())
