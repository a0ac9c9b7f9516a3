"""Pages over a real socket: all ticks arrive, commands act, one page has control, mistakes are reported."""

from __future__ import annotations

import json
import math
import socket
import struct
import time
from collections.abc import Callable
from contextlib import ExitStack
from socket import SHUT_RDWR
from typing import Any

import httpx
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from haptorb.control.trip_reasons import GuardState
from haptorb.web import wire

pytestmark = pytest.mark.realtime


class Client:
    """A page without a picture: sorts what arrives."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket
        self.events: list[dict[str, Any]] = []
        self.rows: list[np.ndarray] = []
        self.echoes: list[float] = []
        self.force_map: list[np.ndarray] = []
        self.meshes = 0
        self.dropped = 0.0

    def receive(self) -> None:
        message = self.socket.recv(timeout=5)
        if isinstance(message, str):
            self.events.append(json.loads(message))
            return
        magic, kind, _, count, width, t0, tick0, echo, dropped = struct.unpack("<IHHIIdddd", message[:48])
        assert magic == wire.MAGIC
        if kind == wire.ROWS:
            data = np.frombuffer(message[48:], "<f4").reshape(count, width).astype(float)
            data[:, 0] += t0
            data[:, 1] += tick0
            self.rows.append(data)
            self.dropped = dropped
            if math.isfinite(echo):
                self.echoes.append(echo)
        elif kind == wire.MESH:
            self.meshes += 1
        else:
            self.force_map.append(np.frombuffer(message[48 : 48 + 4 * count], "<f4"))

    def until(self, what: Callable[[], Any], seconds: float = 10) -> Any:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if found := what():
                return found
            self.receive()
        raise AssertionError("it did not come")

    def event(self, kind: str, **wanted: Any) -> dict[str, Any]:
        def find() -> dict[str, Any] | None:
            matching = [e for e in self.events if e["event"] == kind and wanted.items() <= e.items()]
            return matching[-1] if matching else None

        return self.until(find)

    def do(self, **command: Any) -> None:
        self.socket.send(json.dumps(command))

    def point(self, stamp: float, p: tuple[float, float, float], held: bool) -> None:
        self.socket.send(struct.pack("<9d", stamp, *p, *[math.nan] * 4, float(held)))


def token_header(console) -> dict[str, str]:
    return {"Authorization": f"Bearer {console.token}"}


def join(console, **more: Any) -> ClientConnection:
    # A client that does not read what is on its way does not see the server's goodbye, either.
    return connect(
        f"ws://127.0.0.1:{console.port}/ws", additional_headers=token_header(console), close_timeout=0.3, **more
    )


@pytest.fixture
def client(console):
    with join(console, origin=console.origin) as socket:
        yield Client(socket)


def eventually(what: Callable[[], Any]) -> None:
    end = time.monotonic() + 5
    while not what():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.01)


def test_session_tells_all_that_a_page_needs(console):
    told = httpx.get(f"{console.origin}/api/session", headers=token_header(console)).json()
    assert told["simulated"] is True
    assert told["steered"] is True
    assert told["device"]["name"] == "omni"
    assert told["coils"] == ["x", "y", "z"]
    assert told["scene"]["contact_distance"] == pytest.approx(0.05)
    assert told["scene"]["dome_radius"] == pytest.approx(0.03)
    assert told["limits"]["derate"] == pytest.approx(85.0)
    dome = next(world for world in told["worlds"] if world["name"] == "dome")
    assert {"summit", "half_width_deg", "cut_off_deg", "moment"} <= {p["name"] for p in dome["parameters"]}
    assert told["world"]["name"] == "dome"
    assert all(trip["word"] and trip["text"] for trip in told["trips"].values())
    assert told["trips"]["1"]["word"] == "stopped"


def test_every_tick_arrives_once_and_in_order(client):
    client.until(lambda: len(client.rows) > 30)
    ticks = np.concatenate(client.rows)[:, 1]
    assert (np.diff(ticks) == 1).all()
    assert client.dropped == 0
    assert client.meshes == 1
    sizes = [len(rows) for rows in client.rows[1:]]
    assert 5 < np.median(sizes) < 40, "batches of about a sixtieth of a second"


def test_who_comes_late_gets_the_present_and_holds_up_nobody(servo, console):
    servo._start -= 20.0  # as many rows as the loop keeps: copying them would delay a Stop by tens of ms
    with join(console, origin=console.origin) as socket:
        client = Client(socket)
        client.until(lambda: client.rows)
        client.event("health", alive=True)
        assert 1 <= len(client.rows[0]) < 250
        assert client.dropped == 0
    assert servo.most_read <= 1000


def test_a_page_that_is_too_slow_gets_the_newest_and_is_told(client, servo):
    client.until(lambda: client.rows)
    newest = client.rows[-1][-1, 1]
    servo._start -= 20.0  # twenty seconds pass in which this page hears nothing
    client.until(lambda: client.dropped > 0)
    ticks = client.rows[-1][:, 1]
    assert ticks[-1] - newest > 19_000
    assert len(ticks) <= 2100


def test_pointer_goes_to_the_servo_and_its_answer_is_marked(client, servo):
    client.event("role", control=True)
    client.point(1234.5, (0.01, 0.0, 0.047), held=True)
    client.until(lambda: client.echoes)
    assert client.echoes == [1234.5]
    assert servo.target.tolist() == [0.01, 0.0, 0.047]


def test_resting_hand_is_refreshed_while_the_page_is_there(console, servo):
    with join(console) as socket:
        page = Client(socket)
        page.event("role", control=True)
        page.point(1.0, (0.01, 0.0, 0.047), held=False)
        eventually(lambda: servo.count("point") > 10)
        time.sleep(0.6)
    eventually(lambda: servo.count("release") == 1)
    before = servo.count("point")
    time.sleep(0.1)
    assert servo.count("point") == before


def test_vanishing_in_the_middle_of_a_drag_stops_the_refresh(console, servo):
    with join(console) as socket:
        page = Client(socket)
        page.event("role", control=True)
        page.point(1.0, (0.01, 0.0, 0.047), held=True)
        eventually(lambda: servo.count("point") > 0)
        socket.socket.shutdown(SHUT_RDWR)  # no goodbye
    time.sleep(0.05)  # until the server has noticed
    last = servo.count("point")
    time.sleep(0.3)
    assert servo.count("point") == last, "nobody refreshes: the pose expires and the guard lets go"
    assert servo.count("release") == 0


def test_stop_engage_and_home(client, servo):
    client.event("role", control=True)
    client.do(do="stop")
    eventually(lambda: servo.count("stop") == 1)
    client.do(do="engage")
    eventually(lambda: servo.count("engage") == 1)
    assert ("release",) in servo.calls, "the pose is made fresh before the guard is asked"
    client.do(do="home")
    eventually(lambda: servo.count("release") >= 2)


@pytest.mark.parametrize("message", [r'{"do": "\u0073top"}', b'{"do": "stop"}', rb'{"\u0064o": "stop", "why": '])
def test_a_stop_may_be_spelled_with_escapes_and_sent_as_bytes(client, servo, message):
    client.event("role", control=True)
    client.socket.send(message)
    eventually(lambda: servo.count("stop") == 1)


def test_world_changes_repaint_the_map(client, servo):
    client.until(lambda: client.force_map)
    painted = len(client.force_map)
    client.do(do="world", name="dome", values={"moment": 1.5})
    told = client.until(
        lambda: next((e for e in client.events if e["event"] == "world" and e["values"]["moment"] == 1.5), None)
    )
    assert told["name"] == "dome"
    client.until(lambda: len(client.force_map) > painted)
    assert servo.world[1]["moment"] == 1.5


def test_refused_world_is_said_and_taken_back(client, servo, refusal):
    client.event("role", control=True)
    servo.refuse = refusal
    client.do(do="world", name="dome", values={"moment": 9})
    assert "between -4 and 4" in client.event("mistake")["text"]
    assert client.event("world")["values"]["moment"] == 2.4


def test_of_many_changes_the_last_one_stands(client, servo):
    client.event("role", control=True)
    for k in range(50):
        client.do(do="world", name="dome", values={"moment": 1 + k / 50})
    client.until(lambda: servo.world[1]["moment"] == 1.98)


@pytest.mark.parametrize(
    "nonsense",
    [
        *("", "no json", "[]", '{"do": "dance"}', '{"do": "world"}', '{"do": "world", "name": 3}', "[" * 5000),
        *('{"do": []}', '{"do": {"do": 1}}', '{"do": ' + "[" * 900 + "]" * 900 + "}", '{"do": "' + "x" * 60000 + '"}'),
        '{"do": "world", "name": "dome", "values": {"moment": ' + "9" * 400 + "}}",
        '{"do": "world", "name": "dome", "values": {"moment": 1e999}}',
        '{"do": "world", "name": "dome", "values": {"moment": {}}}',
        '{"do": "world", "name": "dome", "values": {"self": "moment"}}',
        '{"do": "world", "name": "' + "dome" * 5000 + '"}',
        '{"do": "\\ud800"}',
        '{"do": "clutch", "engaged": 1}',
        '{"do": "buttons", "pressed": "a"}',
        '{"do": "buttons", "pressed": [3]}',
        '{"do": "buttons"}',
        '{"do": "model", "model": "publishd"}',
        '{"do": "model", "model": ["published"]}',
    ],
)
def test_nonsense_is_refused_and_the_page_lives_on(client, nonsense):
    client.socket.send(nonsense)
    assert client.event("mistake")["text"]
    seen = len(client.rows)
    client.until(lambda: len(client.rows) > seen + 3)


def test_another_model_is_told_to_every_page_and_painted(client, servo):
    client.event("role", control=True)
    assert client.event("world")["model"] == "exact"
    client.until(lambda: client.force_map)
    painted = len(client.force_map)
    client.do(do="model", model="published")
    assert client.event("world", model="published")["name"] == "dome"
    assert servo.calls[-1] == ("model", "published")
    client.until(lambda: len(client.force_map) > painted)


def test_a_stop_after_an_engage_is_the_last_word(client, servo):
    """Whoever says it: the hand needs a moment before it is engaged, and a stop may fall into it."""
    client.event("role", control=True)
    for _ in range(20):
        asked = servo.count("release")
        client.do(do="engage")
        eventually(lambda asked=asked: servo.count("release") > asked)  # the console has heard it
        servo.stop()  # from another program, past the console
    time.sleep(0.3)
    assert all(stops != servo.stops for _, stops in [call for call in servo.calls if call[0] == "engage"])
    assert servo.guard == GuardState.TRIPPED


def test_a_stop_of_any_page_takes_an_engage_back(console, client, servo):
    client.event("role", control=True)
    with join(console) as socket:
        other = Client(socket)
        other.event("role", control=False)
        for k in range(20):
            asked = servo.count("release")
            client.do(do="engage")
            eventually(lambda asked=asked: servo.count("release") > asked)
            other.do(do="stop")
            eventually(lambda k=k: servo.count("stop") > k)
        time.sleep(0.3)
    assert servo.count("engage") == 0
    client.do(do="engage")  # and one that was given after the last stop counts
    eventually(lambda: servo.guard == GuardState.RUNNING)


@pytest.mark.parametrize(
    "stop",
    ['{"do": "stop"', '{"do":"stop","at":' + "9" * 400 + "}", '{"do": "st\\u006fp"}', '{"x": NaN, "do": "stop"}'],
)
def test_a_stop_is_obeyed_however_it_is_written(console, client, servo, stop):
    client.event("role", control=True)
    with join(console) as socket:
        Client(socket).event("role", control=False)
        socket.send(stop)
        eventually(lambda: servo.count("stop") == 1)


def test_sixteen_pages_and_no_more(console, servo):
    with ExitStack() as stack:
        pages = [stack.enter_context(join(console)) for _ in range(16)]
        Client(pages[-1]).event("role", control=False)
        with join(console) as late, pytest.raises(ConnectionClosed) as refused:
            late.recv(timeout=5)
        assert refused.value.rcvd.code == 1013
        assert "close one" in refused.value.rcvd.reason
        pages[3].close()
        eventually(lambda: is_admitted(console))


def is_admitted(console) -> bool:
    with join(console) as page:
        try:
            return bool(page.recv(timeout=5))
        except ConnectionClosed:
            return False


def test_a_page_that_never_reads_is_left_and_disturbs_nobody(console, client, servo, monkeypatch):
    monkeypatch.setattr("haptorb.web.console_hub.SEND_TIMEOUT_S", 0.3)
    client.event("role", control=True)
    deaf = socket.socket()
    deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    deaf.connect(("127.0.0.1", console.port))
    with deaf:
        deaf.sendall(
            f"GET /ws HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
            f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
            f"Authorization: Bearer {console.token}\r\n\r\n".encode()
        )
        client.event("role", watchers=1)
        client.events.clear()
        client.until(lambda: any(e["event"] == "role" and e["watchers"] == 0 for e in client.events), 30)
    assert client.dropped == 0


def test_rows_are_read_once_for_all_pages(console, servo, monkeypatch):
    read = []
    rows = servo.rows
    monkeypatch.setattr(servo, "rows", lambda cursor=0, most=None: read.append(cursor) or rows(cursor, most))
    with ExitStack() as stack:
        pages = [Client(stack.enter_context(join(console))) for _ in range(5)]
        for page in pages:
            page.until(lambda page=page: len(page.rows) > 3)
    assert sum(cursor == 0 for cursor in read) <= 2, "the whole of the kept rows is not copied for every page"


def test_nonsense_bytes_are_refused(client, servo):
    client.socket.send(b"\x00\x01\x02")
    assert "72 bytes" in client.event("mistake")["text"]
    assert servo.count("point") == 0


def test_second_page_watches_but_may_stop(console, client, servo):
    client.event("role", control=True)
    with join(console) as socket:
        other = Client(socket)
        other.event("role", control=False)
        other.point(1.0, (0.01, 0.0, 0.047), held=True)
        other.do(do="engage")
        assert "another page" in other.event("mistake")["text"]
        other.do(do="stop")
        eventually(lambda: servo.count("stop") == 1)
        assert servo.count("point") == servo.count("engage") == 0
        client.socket.close()
        other.event("role", control=True)
        other.point(1.0, (0.01, 0.0, 0.047), held=True)
        eventually(lambda: servo.count("point") > 0)


def test_health_is_told_and_the_servos_end_too(client, servo):
    told = client.event("health", alive=True)
    assert told["rate_hz"] == pytest.approx(1000, rel=0.05)
    assert told["success"] == pytest.approx(1.0)
    assert told["lateness_p99_us"] == pytest.approx(4.0)
    assert told["pose_age_ms"] == 0.0
    assert told["recording_trouble"] == told["warning"] == ""
    servo.recording_trouble = "the recorder has stood still for 1.2 s"
    servo.warning = "the servo's process has grown by 101 MB"
    told = client.event("health", recording_trouble=servo.recording_trouble)
    assert told["warning"] == servo.warning
    servo.alive = False
    client.event("health", alive=False)


def test_poses_of_another_sender_are_told(client, servo):
    client.event("role", control=True)
    servo.tracker_refusals = {"another_sender": 7, "garbage": 100}
    told = client.event("mistake")["text"]
    assert "7 poses from another sender" in told
    assert "100" not in told
    client.events.clear()
    servo.tracker_refusals = {"another_sender": 9, "garbage": 100, "jump": 1}
    assert "2 poses from another sender" in client.event("mistake")["text"]


def test_a_map_that_cannot_be_painted_is_said(servo):
    import threading

    from haptorb.web.console import Console

    def fail(name, values, model, points):
        raise ValueError("no such force")

    with Console(servo, 0, force_map=fail) as console:
        serving = threading.Thread(target=console.serve)
        serving.start()
        try:
            with join(console) as socket:
                assert "no such force" in Client(socket).event("mistake")["text"]
        finally:
            console.close()
            serving.join(10)
