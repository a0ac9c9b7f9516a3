"""Servers of `--serve osc`, `lsl` and `foxglove` together: rows received by clients, and effect of a flood.

    python benchmarks/connections/serve_streams.py [--seconds 10] [--json]

A simulated Omni at 1 kHz renders `dome` and the clients' force; the hand holds the tool. Each client is a process of
its own on this computer. Two phases of equal length: readers alone; the same beside an OSC flood (nonsense, bundles
with impossible sizes, forces that are no numbers, forces of a second program) and four Foxglove viewers that read
nothing. All times are by the same monotonic clock.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import struct
import subprocess
import sys
import time
from typing import Any

import numpy as np

_RATE = 1000.0  #: bundles a second that the reader subscribes to [Hz]


def pack_text(text: str) -> bytes:
    """A text as OSC has it."""
    data = text.encode()
    return data + bytes(4 - len(data) % 4)


def pack_message(address: str, *values: float) -> bytes:
    """An OSC message of float32 numbers."""
    return pack_text(address) + pack_text("," + "f" * len(values)) + struct.pack(f">{len(values)}f", *values)


def read_bundles(port: int, seconds: float) -> dict[str, Any]:
    """Subscribe to every tick: how many came, how many are missing, and how old they are."""
    reader = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    reader.connect(("127.0.0.1", port))
    reader.settimeout(0.5)
    ahead = time.time() - time.monotonic()
    ticks, ages, sent, end = [], [], 0.0, time.monotonic() + seconds
    while (now := time.monotonic()) < end:
        if now - sent > 2.0:
            sent = now
            reader.send(pack_message("/haptorb/subscribe", 0.0, _RATE))
        try:
            data = reader.recv(4096)
        except TimeoutError:
            continue
        if data.startswith(b"#bundle"):
            whole, part = struct.unpack_from(">II", data, 8)
            ages.append(1e3 * (time.monotonic() + ahead - (whole - 2_208_988_800 + part / 2**32)))
            ticks.append(struct.unpack_from(">i", data, 16 + 4 + 16 + 4)[0])
    lost = int(ticks[-1] - ticks[0] + 1 - len(ticks)) if ticks else 0
    return {"bundles": len(ticks), "missing": lost, "age_ms": spread(ages)}


def command_steps(port: int, seconds: float) -> dict[str, Any]:
    """Send a force that changes every 50 ms, 200 messages a second; when each was sent for the first time."""
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sender.connect(("127.0.0.1", port))
    steps, end, count = [], time.monotonic() + seconds, 0
    while time.monotonic() < end:
        force = 0.1 + 0.2 * (count // 10 % 2)
        if count % 10 == 0:
            steps.append((time.monotonic(), force))
        sender.send(pack_message("/haptorb/force", force, 0.0, 0.0))
        count += 1
        time.sleep(0.005)
    return {"steps": steps}


def flood(port: int, seconds: float) -> dict[str, Any]:
    """Send as fast as the system takes it."""
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sender.connect(("127.0.0.1", port))
    packets = (
        b"#bundle\0" + bytes(7) + b"\x01" + struct.pack(">i", -4) + b"/a\0\0",
        b"nonsense",
        pack_message("/haptorb/force", float("nan"), 0.0, 0.0),
        pack_message("/haptorb/force", 9.0, 9.0, 9.0),
        pack_message("/haptorb/nothing", 1.0),
        bytes(1400),
    )
    count, end = 0, time.monotonic() + seconds
    while time.monotonic() < end:
        for packet in packets:
            try:
                sender.send(packet)
                count += 1
            except OSError:
                continue
    return {"sent": count}


def read_stream(port: int, seconds: float) -> dict[str, Any]:
    """Read the stream of rows: how many came, how many are missing, how old they are."""
    import pylsl

    from haptorb.runtime.trackers.lsl_feed import THIS_COMPUTER

    pylsl.set_config_content(THIS_COMPUTER)
    inlet = pylsl.StreamInlet(pylsl.resolve_byprop("name", "haptorb-rows", timeout=5.0)[0])
    inlet.open_stream(timeout=5.0)
    ticks, ages, end = [], [], time.monotonic() + seconds
    while time.monotonic() < end:
        samples, stamps = inlet.pull_chunk(timeout=0.1, max_samples=2000)
        now = pylsl.local_clock()
        ticks += [sample[0] for sample in samples]
        ages += [1e3 * (now - stamp) for stamp in stamps]
    return {"samples": len(ticks), "missing": int(ticks[-1] - ticks[0] + 1 - len(ticks)), "age_ms": spread(ages)}


def view(port: int, seconds: float, *, silent: bool = False) -> dict[str, Any]:
    """Subscribe to everything as Foxglove does; read all of it, or, if `silent`, nothing."""
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    protocols = [Subprotocol("foxglove.sdk.v1")]
    count, ages, end = 0, [], time.monotonic() + seconds
    with connect(f"ws://127.0.0.1:{port}", subprotocols=protocols, max_size=None, max_queue=4) as viewer:
        viewer.recv()
        channels = json.loads(viewer.recv())["channels"]
        wanted = [{"id": one["id"] + 64 * i, "channelId": one["id"]} for one in channels for i in range(6 * silent + 1)]
        viewer.send(json.dumps({"op": "subscribe", "subscriptions": wanted[:60]}))
        if silent:
            time.sleep(seconds)
            os._exit(0)
        while time.monotonic() < end:
            data = viewer.recv()
            count += 1
            ages.append(1e3 * (time.time() - struct.unpack_from("<BIQ", data)[2] * 1e-9))
    return {"messages": count, "age_ms": spread(ages[50:])}


TASKS = {"bundles": read_bundles, "steps": command_steps, "flood": flood, "stream": read_stream, "view": view}


def spread(values: list[float]) -> dict[str, float]:
    """Median, 99 % and greatest."""
    if not values:
        return {}
    median, late = np.percentile(values, (50, 99))
    return {"median": round(float(median), 3), "p99": round(float(late), 3), "max": round(max(values), 3)}


def start_client(task: str, port: int, seconds: float) -> subprocess.Popen[str]:
    """A client's process."""
    command = [sys.executable, __file__, "--task", task, "--port", str(port), "--seconds", str(seconds)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def measure_phase(servo: Any, ports: dict[str, int], seconds: float, *, hostile: bool) -> dict[str, Any]:
    """What readers get within `seconds` [s], how many ticks were in time, and when forces were rendered."""
    tasks = {"bundles": "osc", "stream": "osc", "view": "foxglove", "steps": "osc"}
    foes = [("flood", "osc")] * 2 + [("silent", "foxglove")] * 4 if hostile else []
    before = servo.report()
    cursor = servo.rows(0)[0]
    clients = {task: start_client(task, ports[kind], seconds) for task, kind in tasks.items()}
    time.sleep(1.0)  # who commands first holds the device
    others = [start_client(task, ports[kind], seconds) for task, kind in foes]
    parts = []
    while any(client.poll() is None for client in clients.values()):
        cursor, rows = servo.rows(cursor)
        parts.append(rows)
        time.sleep(0.2)
    found = {task: json.loads(client.communicate()[0]) for task, client in clients.items()}
    for one in others:
        one.wait()
    after = servo.report()
    met = [r["success_rate"] * (r["ticks"] + r["missed"]) for r in (before, after)]
    total = [r["ticks"] + r["missed"] for r in (before, after)]
    table, layout = np.concatenate(parts), servo.layout
    wall, force = table[:, layout["wall"].start], table[:, layout["memory"].start]
    delays = []
    for (sent, wanted), (later, _) in zip(found["steps"]["steps"][3:-1], found["steps"]["steps"][4:], strict=True):
        rendered = np.flatnonzero((wall > sent) & (wall < later) & (np.abs(force - wanted) < 1e-6))
        delays.append(1e3 * (wall[rendered[0]] - sent) if len(rendered) else 100.0)
    found["steps"] = {"count": len(delays), "rendered_ms": spread(delays)}
    return {
        "ticks": after["ticks"] - before["ticks"],
        "ticks_in_time": round((met[1] - met[0]) / (total[1] - total[0]), 5),
        "largest_clients_force_n": round(float(np.nanmax(np.abs(force))), 3),
        "trips": [trip["reason"] for trip in after["trips"][len(before["trips"]) :]],
        **found,
    }


def measure(seconds: float) -> dict[str, Any]:
    """Both phases, and what the servers counted."""
    from haptorb import RunConfig, Servo
    from haptorb.serve.base import Serving, check_servers, hold_tool
    from haptorb.web.server import freeze_garbage
    from haptorb.worlds import Dome, Remote

    load = os.getloadavg()[0]
    choices = check_servers(["osc:0", "lsl", "foxglove:0"])
    servo = Servo(hold_tool(RunConfig.of("omni", Dome() + Remote()), choices), record=False)
    with Serving(choices, servo) as serving, freeze_garbage(), servo:
        serving.start()
        addresses = dict(line.split(": ", 1) for line in serving.lines)
        ports = {kind: int(addresses[kind].rpartition(":")[2]) for kind in ("osc", "foxglove")}
        time.sleep(2.0)
        found = {
            "machine": {"cores": os.cpu_count(), "load_before": round(load, 2), "python": sys.version.split()[0]},
            "alone": measure_phase(servo, ports, seconds, hostile=False),
            "flooded": measure_phase(servo, ports, seconds, hostile=True),
        }
        time.sleep(0.5)
        keys = ("dropped", "received", "refused", "unread", "not_sent", "sent")
        found["counted"] = {
            one["server"]: {key: one[key] for key in keys if key in one} for one in servo.report()["servers"]
        }
    return found


def main() -> None:
    """Measure, and print; or be one of the clients."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--task", choices=[*TASKS, "silent"], help=argparse.SUPPRESS)
    parser.add_argument("--port", type=int, default=0, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.task == "silent":
        view(options.port, options.seconds, silent=True)
    elif options.task:
        print(json.dumps(TASKS[options.task](options.port, options.seconds)))
    else:
        found = measure(options.seconds)
        print(json.dumps(found) if options.json else json.dumps(found, indent=2))


if __name__ == "__main__":
    main()
