"""Time from saving a world's file to its new force in the console [s].

    python benchmarks/world_reload.py [--saves 10] [--json]

Starts `haptorb run --world groove.py:Groove`, listens as a page does, saves the file again and again with the force
reversed, and takes the time from the end of each save to the first row in the page whose asked force has reached 90 %
of the new one. Ends with code 1 if one save took longer than 1 s.
"""

from __future__ import annotations

import argparse
import json
import re
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from websockets.sync.client import ClientConnection, connect

LONGEST = 1.0  #: that a person should wait [s]
PUSH = 0.12  #: force along y [N]
_ROWS = 1  #: kind of a frame that carries rows
_HEADER = struct.Struct("<IHHIIdddd")
_PATIENCE = 60.0  #: for the start, and for one save [s]
_MAIN = "import sys; from haptorb.cli import main; sys.exit(main(sys.argv[1:]))"
_GROOVE = """
from dataclasses import dataclass
import numpy as np
from haptorb.worlds import World


@dataclass(frozen=True)
class Groove(World):
    def wrench(self, state):
        return np.array([0.0, {push}, 0.0, 0.0, 0.0, 0.0])
"""


def read_address(process: subprocess.Popen[str]) -> tuple[str, str]:
    """Origin and token of the console that `process` serves."""
    assert process.stderr is not None
    text = ""
    for line in process.stderr:
        text += line
        if found := re.search(r"Open (http://[\d.:]+)/#(\S+)", line):
            return found[1], found[2]
    raise SystemExit(f"the console did not start:\n{text}")


def find_force(process: subprocess.Popen[str], origin: str, headers: dict[str, str]) -> int:
    """Where the asked force along y stands in the page's rows, as the console of `process` tells."""
    end = time.monotonic() + _PATIENCE
    while True:
        try:
            event: dict[str, Any] = httpx.get(f"{origin}/api/session", headers=headers, timeout=_PATIENCE).json()
            return 1 + next(int(one["offset"]) for one in event["columns"] if one["name"] == "wrench_commanded")
        except httpx.ConnectError:  # the address is printed a moment before the console listens
            if process.poll() is not None:
                raise SystemExit(f"haptorb run ended by itself: {process.communicate()[1]}") from None
            if time.monotonic() > end:
                raise
            time.sleep(0.05)


def wait_for_force(page: ClientConnection, column: int, push: float) -> None:
    """Return when a row in the page has reached 90 % of `push` [N]."""
    end = time.monotonic() + _PATIENCE
    while time.monotonic() < end:
        message = page.recv(timeout=_PATIENCE)
        if isinstance(message, str):
            continue
        _, kind, _, count, width, *_ = _HEADER.unpack_from(message)
        if kind != _ROWS:
            continue
        rows = np.frombuffer(message, "<f4", count * width, _HEADER.size).reshape(count, width)
        if (rows[:, column] / push >= 0.9).any():
            return
    raise SystemExit(f"the new force did not come within {_PATIENCE:g} s")


def measure_saves(saves: int) -> list[float]:
    """Time [s] from each save to its force in the page."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "groove.py"
        file.write_text(_GROOVE.format(push=PUSH))
        command = [sys.executable, "-c", _MAIN, "run", "--world", f"{file}:Groove", "--port", "0"]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
            try:
                origin, token = read_address(process)
                headers = {"Authorization": f"Bearer {token}"}
                column = find_force(process, origin, headers)
                address = origin.replace("http", "ws") + "/ws"
                times = []
                with connect(address, additional_headers=headers, origin=origin) as page:  # type: ignore[arg-type]
                    wait_for_force(page, column, PUSH)
                    for number in range(saves):
                        push = PUSH if number % 2 else -PUSH
                        file.write_text(_GROOVE.format(push=push))
                        start = time.monotonic()
                        wait_for_force(page, column, push)
                        times.append(time.monotonic() - start)
                return times
            finally:
                process.terminate()
                process.communicate()


def main() -> int:
    """Print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--saves", type=int, default=10)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    times = measure_saves(given.saves)
    result = {"saves": len(times), "median_s": round(statistics.median(times), 3), "longest_s": round(max(times), 3)}
    if given.json:
        print(json.dumps(result))
    else:
        print(f"{result['saves']} saves: median {result['median_s']} s, longest {result['longest_s']} s")
    return int(max(times) > LONGEST)


if __name__ == "__main__":
    sys.exit(main())
