"""A trip while a program commands: report, console and recording name the program, and its end."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import numpy as np
import pytest

from haptorb.control.trip_reasons import Trip
from haptorb.runtime.report import find_program, loop_report
from haptorb.runtime.shared_memory import Word
from haptorb.serve.base import CLIENT_TIMEOUT_S
from haptorb.testing import haptic_device
from haptorb.web.console_hub import describe_troubles, to_json

PUSH = """
import ctypes, sys, time
dhd, ANY, D = ctypes.CDLL(sys.argv[1]), ctypes.c_char(b"\\xff"), ctypes.c_double
status = (ctypes.c_int * 17)()
assert dhd.dhdOpen() == 0
print("open", flush=True)
while dhd.dhdGetStatus(status, ANY) == 0 and status[14] == 0:
    dhd.dhdSetForce(D(0.0), D(0.0), D(0.2), ANY)
    time.sleep(0.001)
print(status[5], status[14], flush=True)
sys.stdin.readline()
while True:
    dhd.dhdSetForce(D(0.0), D(0.0), D(0.2), ANY)
    time.sleep(0.001)
"""


def wait_for(found: Any) -> None:
    end = monotonic() + 20.0
    while not found():
        assert monotonic() < end
        sleep(0.01)


@contextmanager
def killed_at_last(process: subprocess.Popen[str]) -> Iterator[None]:
    try:
        yield
    finally:
        process.kill()


@pytest.mark.realtime
def test_report_console_and_recording_name_the_program(libraries: Path, tmp_path: Path) -> None:
    """A person stops while it pushes; it pushes on after the person engages, until it is killed."""
    script = tmp_path / "push up.py"
    script.write_text(PUSH)
    with haptic_device("omni", real_time=True, serve=["native"]) as run:
        servo = run.servo
        wait_for(lambda: servo.connections)
        address = servo.connections[0]["address"]
        with subprocess.Popen(
            [sys.executable, "-W", "ignore", str(script), str(libraries / "libdrd.so.3")],
            env={**os.environ, "HAPTORB_RUN": address}, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        ) as process, killed_at_last(process):  # fmt: skip
            assert process.stdin is not None
            assert process.stdout is not None
            name = f"push up.py (process {process.pid})"
            assert process.stdout.readline() == "open\n"
            wait_for(lambda: [one["name"] for one in servo.connections[0]["clients"]] == [name])
            servo.stop()
            assert process.stdout.readline() == "0 1\n", "forces off, by a button"
            page = json.loads(json.dumps(describe_troubles(servo), default=to_json))
            assert page["trip_program"] == name
            assert page["connections"][0]["programs"][0]["end_s"] is None
            servo.engage()
            process.stdin.write("\n")
            process.stdin.flush()
            session = servo.connections[0]["programs"][0]["session"]
            wait_for(lambda: float(servo.latest().numbers[servo.layout["wrench_commanded"]][2]) > 0.1)
            process.kill()
        wait_for(lambda: servo.connections[0]["programs"][-1]["end"] == "exited")
        report = servo.report()
    trip, hold = report["trips"][0], report["servers"][0]["programs"][-1]
    assert (trip["code"], trip["program"]) == ("STOPPED", name)
    assert (hold["name"], hold["session"], hold["end"]) == (name, session, "exited")
    assert hold["start_s"] < trip["t"] < hold["end_s"]
    assert report["servers"][0]["clients"] == []
    recording = run.recording
    (recorded,) = recording.programs
    assert (recorded["name"], recorded["session"], recorded["end"]) == (name, str(session), "exited")
    t, commanded = np.asarray(recording["t"]), np.asarray(recording["wrench_commanded"])[:, 2]
    pushed = t[np.abs(commanded) > 0.0]
    assert float(recorded["start_s"]) <= pushed[0]
    assert pushed[-1] <= float(recorded["end_s"]) + 0.03, "at once: nothing but the fade of 20 ms follows"
    at = np.searchsorted(t, trip["t"])
    assert recording.memory["remote.session"][at] == session


def test_who_commanded_at_a_time(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """By when each program commanded, and until its force had faded; a watcher is none."""
    served, now = bench.served, [100.0]
    monkeypatch.setattr("haptorb.serve.base.monotonic", lambda: now[0])
    bench.shared.words[Word.ORIGIN] = int(90e9)
    first, second, watcher = (served.open_session() for _ in range(3))
    clients = [{"name": name, "session": one, "rate_hz": 0.0, "holds": name != "watcher"}
               for name, one in (("a\x1b[31m", first), ("b", second), ("watcher", watcher))]  # fmt: skip
    served.command(first, (1.0, 0.0, 0.0))
    served.report("osc", "here", clients[:1])
    assert find_program(bench.shared, 10.0) == "a\\x1b[31m", "no program writes into a terminal"
    now[0] = 101.0
    served.lose(first)
    now[0] = 102.0
    served.command(second, (1.0, 0.0, 0.0))
    served.command(watcher, (0.0, 0.0, 0.0))
    served.report("osc", "here", clients[1:])
    now[0] += 2.0 * CLIENT_TIMEOUT_S
    assert served.holder == 0
    served.report("osc", "here", clients[1:])
    asked = [9.9, 10.0, 11.0, 11.05, 11.1, 12.0, 12.05, 12.1]
    assert [find_program(bench.shared, t)[:1] for t in asked] == ["", "a", "a", "a", "", "b", "b", ""]
    bench.shared.announce_trip(10.5, float(Trip.OVERHEATED))
    bench.shared.announce_trip(11.5, float(Trip.STOPPED))
    assert [one["program"] for one in loop_report(bench.shared)["trips"]] == ["a\\x1b[31m", ""]
