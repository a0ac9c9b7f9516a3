"""A run of half an hour with console, two programs and a recording: trips, lateness, memory, leftovers.

    python benchmarks/safety/soak.py [--minutes 30] [--json]

Starts `haptorb run omni --world remote --serve haply:0 --serve osc:0 --record FILE`, then, from this process:
- a console page that drags the pen in circles, 60 messages a second;
- a program on the Haply interface that pushes with up to 0.3 N, 200 messages a second;
- a program on the OSC interface that subscribes at 100 Hz and renews its subscription.
Every ten seconds it reads the memory and the open files of all processes of the run. At the end it sends SIGINT and
reads the report and the recording with the makers' MCAP library. Exit code 1 unless: no trip, ticks in time ≥ 0.99,
both programs were answered to the end, memory after the first minute grows by less than 20 MB and open files by less
than 5, every row of the loop is in the recording, and nothing is left among shared memory and temporary files.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from abc import ABC, abstractmethod
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from pythonosc.osc_message_builder import OscMessageBuilder
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

GROWTH_MB, GROWTH_FILES, IN_TIME = 20.0, 5, 0.99
INTERRUPTED = 130  #: what a command ends with after SIGINT (docs/reference/command-line.md)
START_LIMIT = 120.0  #: [s]


class Client(ABC):
    """A thread that talks to the run until it ends; `count` messages were answered, the last one at `last`."""

    def __init__(self) -> None:
        self.count, self.last = 0, time.monotonic()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._talk, daemon=True)
        self._thread.start()

    @abstractmethod
    def _talk(self) -> None:
        """Send and receive until `_over` is set."""

    def answered(self) -> None:
        """Note an answer."""
        self.count, self.last = self.count + 1, time.monotonic()

    def close(self) -> None:
        """End it."""
        self._over.set()
        self._thread.join(10.0)


class Page(Client):
    """A console page that drags the pen."""

    def __init__(self, address: str) -> None:
        base, token = address.split("#")
        self._stack = ExitStack()
        self._socket = self._stack.enter_context(
            connect(
                f"{base.replace('http', 'ws').rstrip('/')}/ws",
                additional_headers={"Authorization": f"Bearer {token}"},
                open_timeout=30,
            )
        )
        super().__init__()
        threading.Thread(target=self._receive, daemon=True).start()

    def _receive(self) -> None:
        try:
            for _ in self._socket:
                self.answered()
        except ConnectionClosed:
            return

    def _talk(self) -> None:
        start = time.monotonic()
        while not self._over.wait(1 / 60):
            t = time.monotonic() - start
            x, y = 0.012 * math.cos(2.0 * t), 0.012 * math.sin(2.0 * t)
            try:
                self._socket.send(struct.pack("<9d", 1e3 * t, x, y, 0.047, *[math.nan] * 4, 1.0))
            except ConnectionClosed:
                return
        self._stack.close()


class Haply(Client):
    """A program for Haply's Inverse Service."""

    def __init__(self, port: int) -> None:
        self._stack = ExitStack()
        self._socket = self._stack.enter_context(connect(f"ws://127.0.0.1:{port}", compression=None, open_timeout=30))
        self._device = json.loads(self._socket.recv(timeout=30))["inverse3"][0]["device_id"]
        super().__init__()

    def _talk(self) -> None:
        start = time.monotonic()
        try:
            while not self._over.wait(1 / 200):
                z = 0.3 * math.sin(time.monotonic() - start)
                force = {"set_cursor_force": {"vector": {"x": 0.0, "y": 0.0, "z": z}}}
                self._socket.send(json.dumps({"inverse3": [{"device_id": self._device, "commands": force}]}))
                self._socket.recv(timeout=5)
                self.answered()
            self._stack.close()
        except (ConnectionClosed, TimeoutError):
            return


class Osc(Client):
    """A program that subscribes to rows by OSC."""

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.5)
        self._address = ("127.0.0.1", port)
        super().__init__()

    def _talk(self) -> None:
        renewed = -math.inf
        while not self._over.is_set():
            if time.monotonic() - renewed > 3.0:
                renewed = time.monotonic()
                builder = OscMessageBuilder("/haptorb/subscribe")
                builder.add_arg(self._socket.getsockname()[1])
                builder.add_arg(100)
                self._socket.sendto(builder.build().dgram, self._address)
            try:
                self._socket.recv(65536)
                self.answered()
            except TimeoutError:
                continue
        self._socket.close()


def list_processes(session: int) -> list[int]:
    """The processes of the run, which has a session of its own."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(fields[3]) == session:
                found.append(int(entry.name))
    return found


def measure_use(processes: list[int]) -> tuple[float, int]:
    """(proportional memory [MB], open files) of `processes` together."""
    memory, files = 0.0, 0
    for process in processes:
        try:
            text = Path(f"/proc/{process}/smaps_rollup").read_text()
            memory += int(re.search(r"^Pss:\s+(\d+)", text, re.MULTILINE)[1]) / 1024  # type: ignore[index]
            files += len(os.listdir(f"/proc/{process}/fd"))
        except (OSError, TypeError):
            continue
    return memory, files


def list_leftovers() -> set[str]:
    """What programs of this package have in memory and among temporary files."""
    folders = [Path("/dev/shm"), Path(tempfile.gettempdir())]
    return {str(path) for folder in folders for path in folder.glob("haptorb-*")}


def await_addresses(process: subprocess.Popen[str]) -> dict[str, str]:
    """What the run prints of its addresses: console, haply, osc."""
    found: dict[str, str] = {}
    lines: list[str] = []
    end = time.monotonic() + START_LIMIT
    assert process.stderr is not None
    for line in process.stderr:
        lines.append(line)
        if address := re.search(r"http://[\w.:]+/?#[\w-]+", line):
            found["console"] = address[0]
        for name in ("haply", "osc"):
            if name in line.lower() and (port := re.search(r":(\d{4,5})", line)):
                found.setdefault(name, port[1])
        if len(found) == 3 or time.monotonic() > end:
            break
    if len(found) < 3:
        process.kill()
        sys.exit(f"the run did not print its addresses:\n{''.join(lines)}")
    threading.Thread(target=process.stderr.read, daemon=True).start()
    return found


def count_recorded(path: Path) -> int:
    """Messages on the channel that has most of them, by the makers' MCAP reader."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    return max(summary.statistics.channel_message_counts.values())


def run(minutes: float) -> dict[str, Any]:
    """What was measured."""
    before = list_leftovers()
    with tempfile.TemporaryDirectory(prefix="soak-") as folder:
        recording = Path(folder) / "soak.mcap"
        command = [sys.executable, "-m", "haptorb", "run", "omni", "--world", "remote", "--serve", "haply:0", "--serve"]
        command += ["osc:0", "--record", str(recording), "--port", "0", "--json"]
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        try:
            addresses = await_addresses(process)
            clients = [Page(addresses["console"]), Haply(int(addresses["haply"])), Osc(int(addresses["osc"]))]
            use: list[tuple[float, int]] = []
            start = time.monotonic()
            while time.monotonic() - start < 60.0 * minutes and process.poll() is None:
                time.sleep(min(10.0, 10.0 * minutes))
                use.append(measure_use(list_processes(process.pid)))
            silent = [type(one).__name__ for one in clients if time.monotonic() - one.last > 2.0]
            process.send_signal(signal.SIGINT)
            assert process.stdout is not None
            output = process.stdout.read()
            process.wait(60)
            for one in clients:
                one.close()
        finally:  # whatever failed here, nothing goes on driving coils
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                process.wait(60)
        report = json.loads(output)
        rows = count_recorded(recording)
    settled = use[min(6, len(use) // 3) :]
    return {
        "minutes": minutes,
        "exit_code": process.returncode,
        "trips": report["trip_count"],
        "in_time": report["success_rate"],
        "ticks": report["ticks"],
        "rows_missing": report["ticks"] + 1 - rows,
        "lost_rows": report["recorded"]["lost"],
        "silent": silent,
        "answers": {type(one).__name__: one.count for one in clients},
        "memory_mb": [round(settled[0][0], 1), round(settled[-1][0], 1)],
        "files": [settled[0][1], settled[-1][1]],
        "left": sorted(list_leftovers() - before),
    }


def find_faults(found: dict[str, Any]) -> list[str]:
    """What was promised and does not hold."""
    (memory, memory_end), (files, files_end) = found["memory_mb"], found["files"]
    checks = {
        f"{found['trips']} trips": found["trips"] > 0,
        f"exit code {found['exit_code']}": found["exit_code"] != INTERRUPTED,
        f"{found['in_time']:.4f} of the ticks in time": found["in_time"] < IN_TIME,
        f"not answered at the end: {', '.join(found['silent'])}": bool(found["silent"]),
        f"memory from {memory} to {memory_end} MB": memory_end - memory > GROWTH_MB,
        f"open files from {files} to {files_end}": files_end - files > GROWTH_FILES,
        f"{found['rows_missing']} rows are not in the recording": found["rows_missing"] > 0 or found["lost_rows"] > 0,
        f"left behind: {', '.join(found['left'])}": bool(found["left"]),
    }
    return [text for text, holds in checks.items() if holds]


def main() -> int:
    """Run, and say what was found; 1 if something was not kept."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    # A shell has what it starts in the background ignore Ctrl-C, and so would the run that is to be ended by it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    found = run(options.minutes)
    faults = find_faults(found)
    if options.json:
        print(json.dumps({**found, "faults": faults}))
    else:
        answers = ", ".join(f"{name} {count}" for name, count in found["answers"].items())
        (memory, memory_end), (files, files_end) = found["memory_mb"], found["files"]
        print(
            f"{found['minutes']:g} minutes, {found['ticks']} ticks, {found['in_time']:.4f} in time, "
            f"{found['trips']} trips\n"
            f"answers: {answers}\n"
            f"memory {memory} to {memory_end} MB, open files {files} to {files_end}"
        )
        print("\n".join(faults) if faults else "kept")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
