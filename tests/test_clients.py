"""Programs of `examples/clients`, and readers of every stream, with the simulated Omni."""

from __future__ import annotations

import base64
import json
import re
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pylsl
import pytest
from pythonosc.osc_message_builder import OscMessageBuilder
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

from failures import FAILED
from haptorb.serve.lsl import NAME
from oracles.protobuf import Schema
from serve.served_run import ServedRun

CLIENTS = Path(__file__).resolve().parents[1] / "examples" / "clients"
SUBPROTOCOL = [Subprotocol("foxglove.sdk.v1")]

pytestmark = [pytest.mark.realtime, pytest.mark.slow]


@pytest.fixture(scope="module")
def runs() -> Iterator[list[ServedRun]]:
    """The run of this file, if one is alive."""
    runs: list[ServedRun] = []
    yield runs
    while runs:
        runs.pop().__exit__(None, None, None)


@pytest.fixture
def run(runs: list[ServedRun], request: pytest.FixtureRequest) -> Iterator[ServedRun]:
    """One run for all tests; after a failure its end is told, and the next try gets another."""
    if not runs:
        runs.append(ServedRun("haply:0:0", "osc:0", "lsl", "foxglove:0", world="dome"))
    yield runs[0]
    if request.node.stash.get(FAILED, False):
        print(runs[0].explain())
    if not runs[0].alive:
        runs.pop().__exit__(None, None, None)


def run_client(name: str, *options: str) -> str:
    done = subprocess.run(
        [sys.executable, "-W", "error", str(CLIENTS / name), *options],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_hand_is_led(run: ServedRun) -> None:
    said = run_client("lead_the_hand.py", "--address", f"ws://localhost:{run.port('haply')}", "--seconds", "2")
    rate, way = re.fullmatch(r"(\d+) forces a second; the tool moved up to ([\d.]+) mm .*", said.strip()).groups()
    assert int(rate) > 30
    assert float(way) > 1.0


def test_the_metronome_beats(run: ServedRun) -> None:
    said = run_client("osc_metronome.py", "--port", str(run.port("osc")), "--seconds", "2")
    beats, rate = re.fullmatch(r"(\d+) beats, (\d+) positions a second", said.strip()).groups()
    assert int(beats) >= 2
    assert int(rate) > 50


def test_every_row_arrives_by_the_streaming_layer_at_its_time(run: ServedRun) -> None:
    found = pylsl.resolve_byprop("name", NAME, timeout=5.0)
    assert len(found) == 1
    inlet = pylsl.StreamInlet(found[0])
    inlet.open_stream(timeout=5.0)
    samples, stamps = [], []
    end = time.monotonic() + 10.0
    while len(samples) < 500 and time.monotonic() < end:
        more, times = inlet.pull_chunk(timeout=0.2, max_samples=1000)
        samples += list(more)
        stamps += list(times)
    inlet.close_stream()
    ticks = [sample[0] for sample in samples]
    assert ticks == list(range(int(ticks[0]), int(ticks[0]) + len(ticks)))
    steps = [(b - a) / (tb - ta) for a, b, ta, tb in zip(stamps, stamps[400:], ticks, ticks[400:], strict=False)]
    assert steps[0] == pytest.approx(1e-3, rel=0.05)
    assert 0.0 < pylsl.local_clock() - stamps[-1] < 1.0


def watch(port: int, seconds: float) -> dict[str, list[dict[str, Any]]]:
    """The messages of every topic, decoded by the schemas that came with them."""
    found: dict[str, list[dict[str, Any]]] = {}
    address = f"ws://127.0.0.1:{port}"
    with connect(address, subprotocols=SUBPROTOCOL, max_size=None, max_queue=None) as viewer:
        info, advertised = json.loads(viewer.recv()), json.loads(viewer.recv())
        assert (viewer.subprotocol, info["op"], advertised["op"]) == ("foxglove.sdk.v1", "serverInfo", "advertise")
        channels = {one["id"]: one for one in advertised["channels"]}
        wanted = [{"id": 100 + number, "channelId": number} for number in channels]
        viewer.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            data = viewer.recv()
            operation, number, stamp = struct.unpack("<BIQ", data[:13])
            assert operation == 1
            assert abs(stamp * 1e-9 - time.time()) < 60.0
            one = channels[number - 100]
            if one["encoding"] == "json":
                message = json.loads(data[13:])
            else:
                message = Schema(base64.b64decode(one["schema"])).read(one["schemaName"], data[13:])
            found.setdefault(one["topic"], []).append(message)
    return found


def test_foxglove_gets_everything(run: ServedRun) -> None:
    found = watch(run.port("foxglove"), 1.0)
    assert set(found) == {"/tf", "/pose", "/wrench", "/currents", "/temperatures", "/state", "/force", "/shape", "/log"}
    assert found["/pose"][-1]["pose"]["position"]["z"] == pytest.approx(0.055, abs=0.01)
    assert {"core", "dome", "tool magnet"} <= {one["id"] for one in found["/shape"][0]["entities"]}
    assert any("dome" in one["message"] for one in found["/log"])
    assert len(found["/pose"]) > 30


def refuse_page(run: ServedRun) -> None:
    """A page of another site tries to look on."""

    address, origin = f"ws://127.0.0.1:{run.port('foxglove')}", Origin("https://example.org")
    with (
        pytest.raises(InvalidStatus, match="403"),
        connect(address, subprotocols=SUBPROTOCOL, origin=origin),
    ):
        pass


def stall_viewer(run: ServedRun) -> dict[str, list[dict[str, Any]]]:
    """What one viewer gets while another subscribes to everything and reads nothing."""
    with socket.create_connection(("127.0.0.1", run.port("foxglove"))) as silent:
        silent.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        head = (
            "GET / HTTP/1.1", f"Host: 127.0.0.1:{run.port('foxglove')}", "Upgrade: websocket", "Connection: Upgrade",
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13",
            "Sec-WebSocket-Protocol: foxglove.sdk.v1", "", "",
        )  # fmt: skip
        silent.sendall("\r\n".join(head).encode())
        many = [{"id": number, "channelId": 1 + number % 9} for number in range(60)]
        text = json.dumps({"op": "subscribe", "subscriptions": many}).encode()
        mask = b"\0\0\0\0"
        silent.sendall(b"\x81\xfe" + struct.pack(">H", len(text)) + mask + text)
        return watch(run.port("foxglove"), 1.5)


def pack(address: str, *values: Any) -> bytes:
    builder = OscMessageBuilder(address)
    for value in values:
        builder.add_arg(value)
    return bytes(builder.build().dgram)


def set_moment(run: ServedRun, wanted: float) -> float | None:
    """The dome's moment after it was set by OSC while another program floods the server with nonsense."""
    endless = b"#bundle\0" + bytes(7) + b"\1" + struct.pack(">i", -4) + b"/a\0\0"
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as flooding,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as setting,
    ):
        for one in (flooding, setting):
            one.connect(("127.0.0.1", run.port("osc")))
        setting.settimeout(0.05)
        value, end = None, time.monotonic() + 15.0
        while value != wanted and time.monotonic() < end:
            for _ in range(300):
                flooding.send(endless)
                flooding.send(pack("/haptorb/force", float("nan")))
            setting.send(pack("/haptorb/parameter/moment", wanted))
            setting.send(pack("/haptorb/parameters"))
            try:
                while True:
                    data = setting.recv(4096)
                    if b"moment\0" in data:
                        (value,) = struct.unpack_from(">f", data, data.index(b"moment\0") + 8)
            except TimeoutError:
                continue
    return value


def test_hostile_programs_disturb_nobody_and_the_report_counts_them(run: ServedRun) -> None:
    refuse_page(run)
    assert len(stall_viewer(run)["/pose"]) > 60
    assert set_moment(run, 1.25) == 1.25
    report = run.end()
    assert (report["world"], report["world_values"]["moment"]) == ("dome", 1.25)
    assert report["trips"] == []
    assert report["peak_force_n"] > 0.1
    assert run.server("osc")["refused"] > 0
    assert run.server("foxglove")["refused"] == 1
    assert run.server("foxglove")["not_sent"] > 0
    assert run.server("lsl")["dropped"] == 0
    assert run.server("lsl")["sent"] > 500
