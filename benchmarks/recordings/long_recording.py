"""One hour of a device at 1 kHz as one recording: time to open, to summarise and to cut out a part.

    python benchmarks/recordings/long_recording.py [FILE] [--hours 1] [--folder DIR] [--json]

The rows are those of a simulated Omni with its dome world and field sensors, recorded for some seconds and then written
again and again with later times, into FILE if one is named, which is used again if it is there. Each figure is taken in
a process of its own; the file is in the page cache, as it was just written, or is read once before. The time of a task
counts from its first import, that of a command from before Python's start. Memory is the greatest of the whole process,
the interpreter and its libraries included.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from haptorb import Recording, Servo
from haptorb.recording.mcap import Recorder

_SAMPLE = 10.0  #: recorded [s]
_TASKS = {
    "import alone": "import haptorb.recording.recording",
    "open": "Recording(path)",
    "10 s of p": "Recording(path)['p'][n // 2 : n // 2 + 10000].mean()",
    "last tick": "Recording(path)['t'][-1]",
    "info": "list_facts(Recording(path))",
    "check": "Recording(path).check()",
}
_COMMANDS = {
    "haptorb info": "['info', path]",
    "haptorb export": "['export', path, '-o', path + '.csv', '--force', '--end', '10 s', '--fields', 't,p']",
}
_MEMORY = 'print("measured", 1024 * int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1]))'
_COMMAND_FRAME = f"""
import contextlib, re, sys
path = sys.argv[1]
sys.argv = ["haptorb", *{{words}}]
from haptorb.cli import main
with contextlib.suppress(SystemExit):
    main()
{_MEMORY}
"""
_FRAME = """
import re, sys, time
path, n = sys.argv[1], int(sys.argv[2])
start = time.perf_counter()
from haptorb.recording.recording import Recording
from haptorb.recording.recording import list_facts
{task}
took = time.perf_counter() - start
# not getrusage: that remembers the program which started this one
print(took, 1024 * int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1]))
"""


def write_hours(path: Path, hours: float) -> int:
    """Write the recording; returns its rows."""
    sample = path.with_name("sample.mcap")
    with Servo("omni", "dome", record=str(sample), overwrite=True):
        time.sleep(_SAMPLE)
    short = Recording(sample)
    rows, layout = short.rows, short.layout
    times = [layout[name].start for name in ("t", "wall", "tick")]
    steps = np.array([rows[-1, at] - rows[0, at] + (rows[-1, at] - rows[0, at]) / (len(rows) - 1) for at in times])
    many = round(hours * 3600.0 / steps[0])
    with path.open("wb") as file:
        recorder = Recorder(file, layout, 1000.0, 10**18)
        for name, values in short.notes:
            recorder.add_metadata(name.removeprefix("haptorb/"), values)
        for turn in range(many):
            later = rows.copy()
            later[:, times] += turn * steps
            for part in np.array_split(later, len(later) // 20):
                recorder.append(part)
        recorder.finish()
    return many * len(rows)


def measure(path: Path, rows: int) -> list[dict[str, float | str]]:
    """Seconds and bytes of each task, the median of three."""
    found: list[dict[str, float | str]] = []
    for name, task in _TASKS.items():
        code = _FRAME.format(task=task)
        runs = [
            [float(x) for x in subprocess.run(
                [sys.executable, "-c", code, str(path), str(rows)], check=True, capture_output=True, text=True
            ).stdout.split()]
            for _ in range(3)
        ]  # fmt: skip
        seconds, memory = np.median(np.array(runs), axis=0)
        found.append({"task": name, "seconds": float(seconds), "memory_bytes": float(memory)})
    return found


def measure_commands(path: Path) -> list[dict[str, float | str]]:
    """Seconds and bytes of each command, the median of three."""
    found: list[dict[str, float | str]] = []
    for name, words in _COMMANDS.items():
        runs = []
        for _ in range(3):
            start = time.perf_counter()
            done = subprocess.run(
                [sys.executable, "-c", _COMMAND_FRAME.format(words=words), str(path)],
                check=True, capture_output=True, text=True,
            )  # fmt: skip
            runs.append([time.perf_counter() - start, float(done.stdout.rpartition("measured ")[2])])
        seconds, memory = np.median(np.array(runs), axis=0)
        found.append({"task": name, "seconds": float(seconds), "memory_bytes": float(memory)})
    return found


def main() -> None:
    """Measure, and print for people or machines."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path, nargs="?", help="recording to look at; made if it is not there")
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        path = options.file or Path(folder, "long.mcap")
        start = time.perf_counter()
        if path.exists():
            rows = len(Recording(path))
            with path.open("rb") as file:
                while file.read(1 << 24):
                    pass
        else:
            rows = write_hours(path, options.hours)
        wrote, size = time.perf_counter() - start, path.stat().st_size
        found = measure(path, rows) + measure_commands(path)
    if options.json:
        print(json.dumps({"rows": rows, "bytes": size, "seconds_to_write": wrote, "tasks": found}, indent=1))
        return
    print(f"{rows} rows, {size / 1e9:.2f} GB, written or read in {wrote:.0f} s")
    for one in found:
        print(f"{one['task']:14} {one['seconds']:6.2f} s  {float(one['memory_bytes']) / 1e6:6.0f} MB")


if __name__ == "__main__":
    main()
