"""Another commit and this tree alternately, in one run on one machine: ticks, and the first start.

    python benchmarks/commits_in_turns.py COMMIT [--rounds 5] [--only ticks|start] [--folder FOLDER] [--json]

ticks  `haptorb bench tick`: the median over `--rounds` runs of each row, and this tree's over the commit's
start  a servo of omni with an empty cache, then one of pmsm, which has another number of coils, with that cache: time
       of the whole process, the least of `--rounds`
The commit is checked out into a temporary folder and runs with this Python and these packages. Each side has a cache of
its own. With --folder both stay there, so that another call need not compile for ticks. Run it on a machine that does
nothing else. The exit code is 1 if a ratio is above 1.03.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from contextlib import nullcontext
from pathlib import Path
from statistics import median
from time import perf_counter

ROOT = Path(__file__).resolve().parents[1]
MOST = 1.03  #: ratio that still counts as equal
TICKS = """
import sys
try:
    from haptorb.cli import main
except ImportError:  # commits before the command line was a package of its own
    from haptorb.apps.cli import main
sys.argv[1:] = ["bench", "tick", "--json"]
sys.exit(main())
"""
START = """
import haptorb
with haptorb.Servo({device!r}, record=False) as servo:
    while len(servo.rows()[1]) < 10:
        servo.check()
"""


class Side:
    """One of the two trees, with a cache of its own."""

    def __init__(self, sources: Path, folder: Path) -> None:
        self._sources, self._folder = sources, folder

    def run(self, code: str, cache: str = "warm") -> str:
        """What the program `code` prints."""
        changes = {"PYTHONPATH": str(self._sources), "XDG_CACHE_HOME": str(self._folder / cache)}
        done = subprocess.run(
            [sys.executable, "-c", code], env=os.environ | changes, capture_output=True, text=True, cwd=self._folder
        )
        if done.returncode:
            raise SystemExit(f"{self._sources}: {done.stderr[-2000:]}")
        return done.stdout

    def time_ticks(self) -> dict[str, float]:
        """Row → value [µs]."""
        rows = json.loads(self.run(TICKS))["rows"]
        return {row["what"]: row["value"] for row in rows}

    def time_start(self, number: int) -> dict[str, float]:
        """Device → time of its first start [s]."""
        times = {}
        shutil.rmtree(self._folder / f"empty-{number}", ignore_errors=True)
        for device in ("omni", "pmsm"):
            begin = perf_counter()
            self.run(START.format(device=device), f"empty-{number}")
            times[f"first start of {device}"] = perf_counter() - begin
        return times


def compare(old: Side, new: Side, rounds: int, only: str | None) -> list[tuple[str, str, float, float]]:
    """(name, unit, the commit's value, this tree's) of each row that both have."""
    found = []
    if only != "start":
        values: dict[str, tuple[list[float], list[float]]] = defaultdict(lambda: ([], []))
        for number in range(-1, rounds):  # the first compiles
            for side, tree in enumerate((old, new)):
                for name, value in tree.time_ticks().items():
                    if number >= 0:
                        values[name][side].append(value)
        found += [(name, "µs", median(a), median(b)) for name, (a, b) in values.items() if a and b]
    if only != "ticks":
        starts = [(old.time_start(number), new.time_start(number)) for number in range(rounds)]
        for name in starts[0][0]:
            found.append((name, "s", min(a[name] for a, _ in starts), min(b[name] for _, b in starts)))
    return found


def main() -> int:
    """Check out, measure, print; 1 if this tree is slower."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commit")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", choices=("ticks", "start"))
    parser.add_argument("--folder", type=Path, help="of checkout and caches, which are kept for the next call")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with nullcontext(options.folder) if options.folder else tempfile.TemporaryDirectory() as name:
        folder = Path(name).resolve()
        for side in ("old", "new"):
            (folder / side).mkdir(parents=True, exist_ok=True)
        packed = subprocess.run(["git", "archive", options.commit, "src"], cwd=ROOT, capture_output=True, check=True)
        subprocess.run(["tar", "-x", "-C", folder], input=packed.stdout, check=True)
        old, new = Side(folder / "src", folder / "old"), Side(ROOT / "src", folder / "new")
        found = compare(old, new, options.rounds, options.only)
    if options.json:
        keys = ("name", "unit", "commit", "here", "ratio")
        print(json.dumps([dict(zip(keys, (*row, row[3] / row[2]), strict=True)) for row in found], indent=1))
    else:
        print(f"{options.commit}, this tree, ratio; {options.rounds} rounds by turns")
        for what, unit, a, b in found:
            print(f"{what}: {a:.1f} {unit}, {b:.1f} {unit}, {b / a:.3f}")
    return int(any(b > MOST * a for _, _, a, b in found))


if __name__ == "__main__":
    sys.exit(main())
