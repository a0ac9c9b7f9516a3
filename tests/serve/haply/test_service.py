"""Protocol over its sockets: one reply to each message, and forces only from the commanding client."""

from __future__ import annotations

import http.client
import json
import socket
import time
from contextlib import ExitStack, suppress

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.runtime.shared_memory import Word
from haptorb.serve.base import has_other_loopback

ARRAYS = ("inverse3", "verse_grip", "wireless_verse_grip", "custom_verse_grip")


def wait_for(condition, seconds=20.0):
    """What `condition` returns, as soon as it is true."""
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.002)
    return found


def numbers(point):
    return np.array([point["x"], point["y"], point["z"]])


def dial(port, **options):
    return connect(f"ws://127.0.0.1:{port}", compression=None, open_timeout=20, **options)


def ask(client, message):
    client.send(message if isinstance(message, str | bytes) else json.dumps(message))
    return json.loads(client.recv(timeout=20))


def push(device, z, *, name="vector", key="commands"):
    return {"inverse3": [{"device_id": device, key: {"set_cursor_force": {name: {"x": 0, "y": 0, "z": z}}}}]}


def check_state(message):
    assert all(isinstance(message[name], list) for name in ARRAYS)
    tool, grip = message["inverse3"][0], message["wireless_verse_grip"][0]
    int(tool["device_id"], 16)
    for name in ("cursor_position", "cursor_velocity"):
        assert np.isfinite(numbers(tool["state"][name])).all()
    assert {"calibrated", "in_use", "power_supply", "ready", "started"} <= tool["status"].keys()
    turn = grip["state"]["orientation"]
    assert sum(turn[name] ** 2 for name in "wxyz") == pytest.approx(1.0)
    assert all(type(grip["state"]["buttons"][name]) is bool for name in "abc")
    assert isinstance(grip["state"]["battery_level"], float)
    return tool


def test_who_connects_gets_the_inventory_and_then_exactly_one_answer_for_each_message(port):
    odd = [
        {}, [], "no JSON", b"\xff\xfe", '"text"', "[" * 5000, {"inverse3": None}, {"inverse3": [3, None, {}]},
        {"inverse3": [{"device_id": "FFFF", "commands": {"set_cursor_force": {"vector": {"x": 9}}}}]},
        {"inverse3": [{"device_id": None, "commands": {"probe_position": {}}}]},
        {"wireless_verse_grip": [{"commands": {}}]},
        {"inverse3": [{"commands": {"set_cursor_force": 3, "set_cursor_position": "up", "unknown": {}}}]},
        {"inverse3": [{"commands": {"set_angular_torques": {"vector": {"a0": 1}}, "probe_orientation": {}}}]},
        {"inverse3": [{"configure": {"mount": {}, "preset": "arm_front"}}]}, {"session": 3}, json.dumps({}).encode(),
    ]  # fmt: skip
    with dial(port) as client:
        first = json.loads(client.recv(timeout=20))
        tool = check_state(first)
        assert isinstance(first["session_id"], int)
        config = tool["config"]
        assert {"filters", "handedness", "extended_device_id", "streaming_mode"} <= config.keys()
        assert config["device_info"]["id"] == tool["device_id"]
        assert (config["preset"], config["basis"]) == ("defaults", {"permutation": "XYZ"})
        assert config["mount"].keys() == {"position", "rotation", "scale"}
        assert len(json.dumps(first)) < 8192
        for message in odd:
            answer = ask(client, message)
            assert "config" not in check_state(answer)
            assert "session_id" not in answer
        for _ in range(20):  # several in flight
            client.send("{}")
        for _ in range(20):
            check_state(json.loads(client.recv(timeout=20)))
        with pytest.raises(TimeoutError):
            client.recv(timeout=0.05)  # nothing unasked
        full = ask(client, {"session": {"force_render_full_state": {}}})
        assert "config" in full["inverse3"][0]


@pytest.mark.skipif(not has_other_loopback(), reason="this computer does not answer at ::1")
def test_programs_for_whom_localhost_is_the_other_loopback_are_served(bench, port):
    """Those of Node.js before version 20, say, which try no second address."""
    for number, first in ((port, "inverse3"), (bench.ports[1], "name")):
        with connect(f"ws://[::1]:{number}", open_timeout=20) as client:
            assert first in json.loads(client.recv(timeout=20))


def test_forces_in_both_spellings_add_within_a_message_and_are_recorded_with_their_session(bench, port):
    with dial(port) as client:
        first = json.loads(client.recv(timeout=20))
        device, session = first["inverse3"][0]["device_id"], first["session_id"]
        for message, z in (
            (push(device, 0.25), 0.25),
            (push(device, 1, name="values"), 1.0),
            (push(None, 0.5, key="command"), 0.5),
            (push(device.lower(), 0.125), 0.125),
            (push(int(device, 16), 0.375), 0.375),
            ({"inverse3": push(device, 0.25)["inverse3"] + push(device, 0.5, name="values")["inverse3"]}, 0.75),
        ):
            assert ask(client, message)["inverse3"][0]["status"]["in_use"]
            assert bench.read_client()["force"].tolist() == [0.0, 0.0, z]
            assert bench.read_client()["session"] == session
        ask(client, json.dumps(push(device, 0.0)).encode())  # binary
        assert not bench.read_client()["force"].any()
    wait_for(lambda: bench.read_client(later=0.001)["lost"] > 0.0)  # at once with the socket


@pytest.mark.parametrize("bad", ["NaN", "Infinity", "1e999", "1e308", "true", '"1"', "1" + "0" * 400, "[]"])
def test_what_is_no_force_is_answered_and_not_rendered(bench, port, bad):
    with dial(port) as client:
        client.recv(timeout=20)
        ask(client, f'{{"inverse3":[{{"commands":{{"set_cursor_force":{{"vector":{{"x":{bad},"y":0,"z":0}}}}}}}}]}}')
        assert bench.read_client()["session"] == 0


def test_the_second_client_is_told_that_the_device_is_busy_and_watches_without_disturbing(bench, port):
    with dial(bench.ports[1]) as events, dial(port) as one, dial(port) as two:
        device = json.loads(one.recv(timeout=20))["inverse3"][0]["device_id"]
        two.recv(timeout=20)
        ask(one, push(device, 0.25))
        answer = ask(two, {**push(device, 9.0), "session": {"configure": {"basis": {"permutation": "XZY"}}}})
        assert answer["inverse3"][0]["status"]["in_use"]
        assert bench.read_client()["force"].tolist() == [0.0, 0.0, 0.25]
        ask(one, push(device, 0.5))
        assert bench.read_client()["force"].tolist() == [0.0, 0.0, 0.5]  # in its own axes still
        names = []
        while "device-busy" not in names:
            names.append(json.loads(events.recv(timeout=20))["name"])
        assert names[0] == "device-connected"
        one.close()
        wait_for(lambda: ask(two, push(device, 0.125)) and bench.read_client()["force"][1] == 0.125)


def test_cursor_buttons_and_axes_follow_the_device_and_the_clients_basis(bench, port):
    with dial(port) as client:
        client.recv(timeout=20)
        bench.publish(p=(0.01, 0.02, 0.05), v=(0.1, 0.2, 0.3), wrench_commanded=(0.0, 0.0, 0.7, 0.0, 0.0, 0.0))
        bench.shared.words[Word.BUTTONS] = 0b10
        plain = ask(client, {})
        other = ask(client, {"session": {"configure": {"profile": {"name": "x"}, "basis": {"permutation": "XZY"}}}})
        a, b = (numbers(one["inverse3"][0]["state"]["cursor_position"]) for one in (plain, other))
        assert b.tolist() == a[[0, 2, 1]].tolist()
        assert numbers(plain["inverse3"][0]["state"]["cursor_velocity"]) == pytest.approx([0.2, 0.4, 0.6])
        assert plain["inverse3"][0]["state"]["current_cursor_force"] == {"x": 0.0, "y": 0.0, "z": 0.7}
        assert plain["wireless_verse_grip"][0]["state"]["buttons"] == {"a": False, "b": True, "c": False}
        ask(client, {"inverse3": [{"configure": {"preset": "arm_front_centered"}}]})
        bench.publish(valid=0.0, p=np.nan)  # a pose that is lost: the last one stands
        lost = ask(client, {})
        centred = numbers(lost["inverse3"][0]["state"]["cursor_position"])
        assert centred == pytest.approx((a + np.array([0.0, 0.14, -0.20]))[[0, 2, 1]])


def test_trips_the_way_back_and_what_holds_the_force_back_are_events(bench, port):
    with dial(bench.ports[1]) as events:

        def hear(kind):
            event = json.loads(events.recv(timeout=20))
            assert (event["name"], event["category"]) == ("device-safety-triggered", "device")
            assert event["data"]["safety_type"] == kind
            assert event["data"]["device_family"] == "inverse"

        assert json.loads(events.recv(timeout=20))["name"] == "device-connected"
        bench.publish(guard=GuardState.TRIPPED, trip=float(Trip.STOPPED))
        hear("ebrake_triggered")
        bench.publish(guard=GuardState.RUNNING)
        hear("ebrake_released")
        bench.publish(guard=GuardState.DERATED, t=2.0)
        hear("thermal_derating")
        for t in (2.1, 2.5, 2.9):  # on and off at the border: said once
            bench.publish(guard=GuardState.RUNNING, t=t)
            bench.publish(guard=GuardState.DERATED, t=t + 0.1)
            time.sleep(0.03)
        bench.publish(injected=0.5, t=4.0)
        hear("stability_ceiling")
        events.send("hello")  # read only
        bench.served.ending = True
        assert json.loads(events.recv(timeout=20))["name"] == "device-disconnected"


def request(port, method, path, body=None, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    connection.request(method, path, None if body is None else json.dumps(body), headers)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, json.loads(content) if content else None


def test_routes_over_http(port):
    assert request(port, "GET", "/version")[1]["git_tag"].startswith("3.")
    check_state(request(port, "GET", "/3.1/devices")[1])
    assert request(port, "GET", "/settings/") == (200, {"ok": True, "data": {}})
    with dial(port) as client, dial(port) as other:
        session = json.loads(client.recv(timeout=20))["session_id"]
        other.recv(timeout=20)
        ask(other, {"session": {"configure": {"profile": {"name": "co.lab::[demo]:main"}}}})
        listed = request(port, "GET", "/sessions")[1]["data"]
        assert listed["session_count"] == 2
        assert listed["sessions"][0]["session_id"] == session

        def tell(method, path, body=None):
            status, answer = request(port, method, path, body)
            assert (status, answer["ok"]) == (200, True)
            return answer["data"]

        basis = "/inverse3/0/config/basis?session="
        assert tell("POST", f"{basis}:0", {"permutation": "XZY"}) == {"permutation": "XZY"}
        for own in (f"%23{session}", str(session), ":-2", "default", ":default:0", "def*lt:-1"):
            assert tell("GET", basis + own) == {"permutation": "XZY"}
        for name in (":-1", "co.lab::[demo]:main", "co.lab::*:0", "co.lab::?demo?:m*:-1"):
            assert tell("GET", basis + name) == {"permutation": "XYZ"}
        device = request(port, "GET", "/devices?session=:0")[1]["inverse3"][0]
        place = numbers(ask(other, {})["inverse3"][0]["state"]["cursor_position"])
        assert numbers(device["state"]["cursor_position"]) == pytest.approx(place[[0, 2, 1]])
        assert tell("DELETE", f"{basis}:0") == {"permutation": "XYZ"}
        assert tell("POST", "/*inverse/*/config/preset", {"preset": "arm_front"}) == {"preset": "arm_front"}
        for one in (client, other):  # of all that are connected, and of those that come
            full = ask(one, {"session": {"force_render_full_state": {}}})
            assert full["inverse3"][0]["config"]["preset"] == "arm_front"
        mount = {"transform": {"position": {"x": 1.0}}}
        assert tell("POST", "/inverse3/0/config/mount?session=:0", mount)["transform"]["position"]["x"] == 1.0
        assert tell("DELETE", "/inverse3/0/config/mount?session=:0")["transform"]["position"]["x"] == 0.0
        assert tell("POST", "/inverse3/0/config/damping", {"vector": {"y": 1}})["vector"] == {"x": 0, "y": 1, "z": 0}


@pytest.mark.parametrize(
    ("method", "path", "body", "status"),
    [
        ("GET", "/nothing", None, 404),
        ("GET", "/inverse3/FFFF/config/basis", None, 404),
        ("GET", "/inverse3/0/config/colour", None, 404),
        ("POST", "/inverse3/0/config/basis", {"permutation": "ABC"}, 400),
        ("POST", "/inverse3/0/config/gravity_compensation", {"enabled": True}, 400),
        ("PUT", "/inverse3/0/config/basis", {}, 405),
        ("GET", "/inverse3/0/config/basis?session=:7", None, 404),
        ("GET", "/inverse3/0/config/basis?session=*a*a*a*a*a*a*a*a*a*a*b", None, 404),
        ("GET", "/*inverse/*/config/basis", None, 400),
        ("POST", "/gravity_compensation", {}, 404),
    ],
)
def test_mistakes_over_http_are_told(port, method, path, body, status):
    found, answer = request(port, method, path, body)
    assert found == status
    assert answer["ok"] is False
    assert answer["error"]


def test_a_long_body_is_refused_and_a_page_is_told_what_it_may_do(port):
    assert request(port, "POST", "/inverse3/0/config/basis", "x" * 65530)[0] == 400
    status, answer = request(port, "POST", "/inverse3/0/config/basis", "x" * 70000)
    assert (status, answer["ok"]) == (413, False)
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    for method, status in (("OPTIONS", 204), ("GET", 200)):  # on one connection
        connection.request(method, "/devices", headers={"Origin": "http://localhost:8000"})
        answer = connection.getresponse()
        answer.read()
        assert (answer.status, answer.headers["Access-Control-Allow-Origin"]) == (status, "http://localhost:8000")
    connection.close()


def test_pages_of_other_sites_and_other_names_are_sent_away(port):
    for headers in ({"Origin": "https://evil.example"}, {"Host": "rebound.example"}):
        assert request(port, "GET", "/devices", **headers)[0] == 403
    with pytest.raises(InvalidStatus) as refusal, dial(port, origin="https://evil.example"):
        pass
    assert refusal.value.response.status_code == 403


def test_hostile_clients_are_let_go_and_nobody_else_notices(bench, port):
    with dial(port) as honest, ExitStack() as open_connections:
        honest.recv(timeout=20)
        for junk in (
            b"\0" * 20000,
            b"GET / HTTP/1.1\r\n" + b"a" * 20000,
            b"POST /x HTTP/1.1\r\nContent-Length: -3\r\n\r\n",
        ):
            with socket.create_connection(("127.0.0.1", port)) as raw:
                raw.settimeout(20)
                raw.sendall(junk)
                with suppress(ConnectionResetError):  # where the rest of the junk is not read any more
                    while raw.recv(65536):
                        pass
        with dial(port, max_size=None) as large:
            large.recv(timeout=20)
            with suppress(ConnectionClosed):
                large.send("x" * 8_000_000)
            with pytest.raises(ConnectionClosed):
                large.recv(timeout=20)
        mute = open_connections.enter_context(socket.create_connection(("127.0.0.1", port)))
        head = f"GET / HTTP/1.1\r\nHost: localhost:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        mute.sendall(f"{head}Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n".encode())
        mute.setblocking(False)
        flood, refused = b"\x81\x82\0\0\0\0{}" * 100, 0
        while refused < 50:  # never reads: in the end the server reads no more of it either
            try:
                mute.send(flood)
                refused = 0
            except BlockingIOError:
                refused += 1
                check_state(ask(honest, {}))
            except ConnectionError:  # on a busy computer the ten seconds of who does not read are over before
                break
        with dial(port) as endless:
            endless.recv(timeout=20)
            with pytest.raises(ConnectionClosed):
                endless.send(b"" for _ in range(100_000))
        assert ask(honest, push(None, 0.25))["inverse3"][0]["status"]["in_use"]
        assert bench.read_client()["force"].tolist() == [0.0, 0.0, 0.25]


def test_who_talks_nonsense_is_answered_and_takes_no_time_from_others(port):
    def take(message, count=80):
        with dial(port) as client:
            client.recv(timeout=20)
            begin = time.monotonic()
            for _ in range(count):
                client.send(message)
            for _ in range(count):
                check_state(json.loads(client.recv(timeout=20)))
            return time.monotonic() - begin

    rest = 79 * 0.005
    assert take('{"inverse3":[{') > rest
    fastest = [min(take(message) for _ in range(3)) for message in ("", " ", "7", "{}", '{"inverse4":{}}')]
    assert max(fastest) < rest, "whatever can be read, if only as nothing, is answered at once"
    begin = time.monotonic()
    with pytest.raises(InvalidStatus), dial(port, origin="https://evil.example"):
        pass
    assert time.monotonic() - begin > 0.05
