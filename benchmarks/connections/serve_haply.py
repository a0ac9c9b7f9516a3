"""Server of `--serve haply` with servo and console: replies, force at the coils, dead and hostile clients.

    python benchmarks/connections/serve_haply.py [--seconds 10] [--repetitions 100] [--json]

A simulated Omni at 1 kHz renders the world `remote`; the hand holds the tool on top of the dome, a console serves
beside. Every client is a process of its own (`serve_clients.py`), on loopback of the same computer. A force is at the
coils when what coils and core give to the tool has gone half of its step, and is zero when that is below 1 % of what
was commanded. All times are by the same monotonic clock.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from haptorb import RunConfig, Servo
from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.serve.base import Serving, check_servers, hold_tool
from haptorb.web.console import Console
from haptorb.web.server import freeze_garbage
from haptorb.worlds import Remote

CLIENTS = Path(__file__).with_name("serve_clients.py")
_FORCE = 0.5  #: of the client that is killed [N]


def start_client(task: str, port: int, seconds: float) -> subprocess.Popen[str]:
    """A client's process."""
    return subprocess.Popen(
        [sys.executable, "-I", "-S", str(CLIENTS), task, str(port), str(seconds)], stdout=subprocess.PIPE, text=True
    )


def say(text: str) -> None:
    """What is being measured."""
    print(text, file=sys.stderr, flush=True)


def run_client(task: str, port: int, seconds: float) -> dict[str, Any]:
    """What a client has to say at its end."""
    say(f"client: {task}")
    client = start_client(task, port, seconds)
    return dict(json.loads(client.communicate()[0].strip().splitlines()[-1]))


def percentiles(values: list[float]) -> dict[str, float]:
    """Median, 99 % and greatest."""
    return {
        "median": round(statistics.median(values), 3),
        "p99": round(float(np.percentile(values, 99)), 3),
        "max": round(max(values), 3),
        "count": len(values),
    }


def engage(servo: Servo) -> None:
    """Return when the full force is rendered; a loop that tripped on a busy computer is engaged again, and it is
    said."""
    while (row := servo.latest()).gain < 1.0:
        if row.guard == GuardState.TRIPPED:
            say(f"engaged again: {Trip(int(row.trip)).text}")
            servo.engage()
        time.sleep(0.1)


def measure_steps(servo: Servo, port: int, seconds: float) -> dict[str, Any]:
    """From a client's send to the tick that renders its force, and to the coils [ms]."""
    cursor, _ = servo.rows(10**12)
    cursor = servo.rows(0)[0]
    rows, found = [], {}

    def collect() -> None:
        nonlocal cursor
        while not found:
            cursor, new = servo.rows(cursor)
            rows.append(new)
            time.sleep(0.2)

    thread = threading.Thread(target=collect)
    thread.start()
    found.update(run_client("steps", port, seconds))
    thread.join()
    table = np.concatenate(rows)
    at = servo.layout
    wall, rendered = table[:, at["wall"].start], table[:, at["memory"].start + 2]
    coils = table[:, at["wrench_actual"].start + 2]
    tick, half = [], []
    for (sent, force), (after, _) in zip(found["sent"][3:-1], found["sent"][4:], strict=True):
        window = (wall > sent) & (wall < after)
        begin = np.flatnonzero(window & (rendered == force))
        if len(begin):
            tick.append(1e3 * (float(wall[begin[0]]) - sent))
        before = 0.1 if force == 0.3 else 0.3
        gone = (coils - before) / (force - before)
        there = np.flatnonzero(window & (gone > 0.5))
        half.append(1e3 * (float(wall[there[0]]) - sent) if len(there) else 100.0)
    return {"rendered_ms": percentiles(tick), "coils_ms": percentiles(half)}


def measure_end(servo: Servo, port: int, number: signal.Signals) -> float:
    """From the signal to a client until its force is zero at the coils [ms]; infinite if it is not within 0.3 s, NaN if
    the guard tripped meanwhile."""
    engage(servo)
    client = start_client("hold", port, 60.0)
    assert client.stdout is not None
    client.stdout.readline()
    while (row := servo.latest()).wrench_actual[2] < 0.9 * _FORCE and row.guard != GuardState.TRIPPED:
        time.sleep(0.005)
    cursor, _ = servo.rows()
    begin = time.monotonic()
    client.send_signal(number)
    time.sleep(0.3)  # the rows are kept meanwhile: nobody has to look in time
    _, rows = servo.rows(cursor)
    at = servo.layout
    rows = rows[rows[:, at["wall"].start] > begin]
    took = float("inf")
    if (rows[:, at["guard"].start] == GuardState.TRIPPED).any():  # all coils are off, but not because of the client
        say(f"repeated: {Trip(int(rows[-1, at['trip'].start])).text}")
        took = float("nan")
    elif len(zero := np.flatnonzero(np.abs(rows[:, at["wrench_actual"].start + 2]) < 0.01 * _FORCE)):
        took = 1e3 * (float(rows[zero[0], at["wall"].start]) - begin)
    client.kill()
    client.wait()
    while servo.connections and any(one["clients"] for one in servo.connections):
        time.sleep(0.01)  # the next one must be the first
    return took


def measure_hostile(servo: Servo, port: int, seconds: float) -> dict[str, Any]:
    """50 connections of which 10 are hostile: ticks on time, and what the others notice."""
    quiet = run_client("paced", port, 2.0)
    before, started = servo.report(), time.monotonic()
    say("50 connections, 10 hostile")
    group = [start_client(task, port, seconds) for task in ("friends", "foes", "paced")]
    texts = [client.communicate()[0].strip().splitlines() for client in group]
    after = servo.report()
    results = [json.loads(text[-1]) if text else {} for text in texts]
    ticks = after["ticks"] - before["ticks"]
    on_time = after["success_rate"] * (after["ticks"] + after["missed"]) - before["success_rate"] * (
        before["ticks"] + before["missed"]
    )
    missed = after["missed"] - before["missed"]
    return {
        "seconds": round(time.monotonic() - started, 1),
        "connections": 50,
        "ticks": ticks,
        "ticks_in_time": round(on_time / (ticks + missed), 5),
        "friends": results[0],
        "answers_alone_ms": percentiles(quiet["times_ms"]),
        "answers_beside_ms": percentiles(results[2]["times_ms"]) if results[2] else None,
        "peak_force_n": after["peak_force_n"],
        "limit_n": servo.device.limits.force,
        "trips": len(after["trips"]) - len(before["trips"]),
    }


def measure(seconds: float, repetitions: int) -> dict[str, Any]:
    """All of it."""
    choices = check_servers(["haply:0:0"])
    servo = Servo(hold_tool(RunConfig.of("omni", Remote()), choices), record=False)
    load = os.getloadavg()[0]
    with Serving(choices, servo) as serving, Console(servo, 0) as console, freeze_garbage(), servo:
        serving.start()
        page = threading.Thread(target=console.serve, daemon=True)
        page.start()
        port = int(serving.lines[0].split(",")[0].rpartition(":")[2])
        engage(servo)
        fast, paced = run_client("answer", port, seconds), run_client("paced", port, seconds)
        found: dict[str, Any] = {
            "machine": {"cores": os.cpu_count(), "load_before": load, "python": sys.version.split()[0]},
            "answers_as_fast_as_possible_ms": percentiles(fast["times_ms"]),
            "messages_per_second": round(fast["per_second"]),
            "answers_200_a_second_ms": percentiles(paced["times_ms"]),
            "force": measure_steps(servo, port, seconds),
        }
        for number in (signal.SIGKILL, signal.SIGSTOP):
            say(f"{number.name}, {repetitions} times")
            times = list[float]()
            while len(times) < repetitions:
                took = measure_end(servo, port, number)
                times += [took] if took == took else []
            found[f"zero_after_{number.name}_ms"] = {
                **percentiles(times),
                "within_100_ms": sum(t <= 100 for t in times),
            }
        found["hostile"] = measure_hostile(servo, port, 1.5 * seconds)
        found["success_rate"] = servo.report()["success_rate"]
        console.close()
        page.join()
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--repetitions", type=int, default=100)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = measure(options.seconds, options.repetitions)
    if options.json:
        print(json.dumps(found, indent=1))
        return
    for name, value in found.items():
        print(f"{name}: {json.dumps(value)}")


if __name__ == "__main__":
    main()
