"""OSC clients over real sockets: rows are sent, forces and parameters received, invalid input is ignored."""

from __future__ import annotations

import json
import socket
import struct
from collections.abc import Callable, Iterator
from time import monotonic, sleep
from typing import Any, ClassVar

import pytest
from pythonosc.osc_bundle import OscBundle
from pythonosc.osc_message import OscMessage
from pythonosc.osc_message_builder import OscMessageBuilder

from haptorb.errors import InputError
from haptorb.runtime.world_requests import description
from haptorb.serve.osc import LEASE_TIME_S, MAX_DATAGRAMS, MAX_SUBSCRIBERS, OscSession, prepare, serve
from haptorb.worlds import Dome, Nothing, Remote
from haptorb.worlds.client_force import HOLD_TIME_S
from serve.published_loop import PublishedLoop


class Program:
    """A program with a UDP socket of its own."""

    def __init__(self, address: tuple[str, int]) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(1.0)
        self.address = address
        self.port = self.socket.getsockname()[1]

    def say(self, address: str, *values: Any) -> None:
        builder = OscMessageBuilder(address)
        for value in values:
            builder.add_arg(value)
        self.send(builder.build().dgram)

    def send(self, data: bytes) -> None:
        self.socket.sendto(data, self.address)

    def read(self) -> dict[str, list[Any]]:
        data = self.socket.recv(4096)
        messages = OscBundle(data) if data.startswith(b"#") else [OscMessage(data)]
        return {message.address: list(message.params) for message in messages}

    def read_all(self) -> list[dict[str, list[Any]]]:
        found = []
        self.socket.setblocking(False)
        try:
            while True:
                found.append(self.read())
        except BlockingIOError:
            return found
        finally:
            self.socket.settimeout(1.0)


class Setting:
    """A session on a socket of its own, before a loop that is published by hand."""

    def __init__(self, loop: PublishedLoop, token: str = "", *, beyond: bool = False) -> None:
        self.loop = loop
        self._opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._opened.bind(("127.0.0.1", 0))
        self.address = self._opened.getsockname()
        self.session = OscSession(self._opened, loop.served, token, beyond=beyond)
        self._programs: list[Program] = []

    def connect(self) -> Program:
        self._programs.append(Program(self.address))
        return self._programs[-1]

    def look(self) -> None:
        """What the server does in each turn."""
        self.session.read_messages()
        self.session.send(self.loop.served.read_rows())

    def report(self) -> dict[str, Any]:
        self.session.report("test", 1.0)
        return json.loads(self.loop.shared.server_facts[0].read()[1])

    def request(self) -> dict[str, Any] | None:
        text = self.loop.shared.server_requests[0].read()[1]
        return json.loads(text) if text else None

    def close(self) -> None:
        self.session.close()
        for program in self._programs:
            program.socket.close()


@pytest.fixture
def setting() -> Iterator[Setting]:
    with PublishedLoop(Dome() + Remote()) as loop:
        made = Setting(loop)
        yield made
        made.close()


def test_a_subscriber_gets_rows_at_its_rate_with_the_buttons(setting: Setting) -> None:
    program = setting.connect()
    program.say("/haptorb/subscribe", 0, 250)
    setting.look()
    assert program.read() == {"/haptorb/subscribed": [250.0]}
    setting.loop.publish(100, p=(0.001, 0.002, 0.05), wrench_model=(1, 2, 3, 0.1, 0.2, 0.3))
    setting.look()
    found = program.read_all()
    assert len(found) == 25
    assert [one["/haptorb/tick"][0] for one in found] == list(range(0, 100, 4))
    assert found[-1]["/haptorb/position"] == pytest.approx([0.001, 0.002, 0.05])
    assert found[-1]["/haptorb/force"] == [1, 2, 3]
    assert found[-1]["/haptorb/buttons"] == [0, 0, 0]


def test_bundles_go_to_another_port_if_it_is_asked_for_and_end_when_that_is(setting: Setting) -> None:
    asking, reading = setting.connect(), setting.connect()
    asking.say("/haptorb/subscribe", reading.port, 1000)
    setting.look()
    assert reading.read() == {"/haptorb/subscribed": [1000.0]}
    setting.loop.publish(10)
    setting.look()
    assert len(reading.read_all()) == 10
    asking.say("/haptorb/unsubscribe", reading.port)
    setting.look()
    setting.loop.publish(10)
    setting.look()
    assert reading.read_all() == []


def test_a_subscription_ends_that_is_not_renewed(setting: Setting, monkeypatch: pytest.MonkeyPatch) -> None:
    program = setting.connect()
    program.say("/haptorb/subscribe")
    setting.look()
    later = monotonic() + LEASE_TIME_S + 1.0
    monkeypatch.setattr("haptorb.serve.osc.monotonic", lambda: later)
    setting.loop.publish(5)
    setting.look()
    assert [one for one in program.read_all() if "/haptorb/tick" in one] == []


def test_so_many_subscribe_and_no_more(setting: Setting) -> None:
    programs = [setting.connect() for _ in range(MAX_SUBSCRIBERS + 1)]
    for program in programs:
        program.say("/haptorb/subscribe")
        setting.look()
    assert "/haptorb/subscribed" in programs[0].read()
    assert str(MAX_SUBSCRIBERS) in programs[-1].read()["/haptorb/error"][0]


def test_a_force_reaches_the_loop_and_the_first_program_holds_the_device(setting: Setting) -> None:
    first, second = setting.connect(), setting.connect()
    first.say("/haptorb/force", 0.5, -1.0, 2)
    setting.look()
    force, session = setting.loop.receive()
    assert force == [0.5, -1.0, 2.0]
    second.say("/haptorb/force", 9.0, 9.0, 9.0)
    setting.look()
    assert setting.loop.receive() == (force, session)
    assert "holds the device" in second.read()["/haptorb/error"][0]
    first.say("/haptorb/force", 0, 0, 0)
    setting.look()
    assert setting.loop.receive() == ([0, 0, 0], session)


def test_a_force_that_nobody_feels_is_told() -> None:
    with PublishedLoop(Dome()) as loop:
        setting = Setting(loop)
        program = setting.connect()
        program.say("/haptorb/force", 0.5, 0.0, 0.0)
        setting.look()
        assert "remote" in program.read()["/haptorb/error"][0]
        setting.close()


@pytest.mark.parametrize("bad", [(float("nan"), 0.0, 0.0), (0.0, float("inf"), 0.0), (1.0, 2.0), ("a", "b", "c")])
def test_a_force_that_is_none_changes_nothing_and_says_why(setting: Setting, bad: tuple[Any, ...]) -> None:
    program = setting.connect()
    program.say("/haptorb/force", 0.5, 0.0, 0.0)
    program.say("/haptorb/force", *bad)
    setting.look()
    assert setting.loop.receive()[0] == [0.5, 0.0, 0.0]
    assert "numbers" in program.read()["/haptorb/error"][0]
    assert setting.report()["refused"] == 1


def test_no_force_beyond_any_number_is_taken(setting: Setting) -> None:
    program = setting.connect()
    program.say("/haptorb/force", 3e38, 0.0, 0.0)
    setting.look()
    assert setting.loop.receive()[0] == [0.0, 0.0, 0.0]


def test_parameters_are_requested_together_until_they_are_there(setting: Setting) -> None:
    program = setting.connect()
    for value in (1.0, 2.0, 1.5):
        program.say("/haptorb/parameter/moment", value)
    program.say("/haptorb/parameter/summit", 0.0, 0.6, 0.8)
    setting.look()
    request = setting.request()
    assert request is not None
    assert (request["name"], request["values"]["moment"]) == ("dome", 1.5)
    assert request["values"]["summit"] == pytest.approx([0.0, 0.6, 0.8])
    assert program.read_all() == []


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("momint", 1.0, "moment"),
        ("moment", 1e9, "between"),
        ("summit", 1.0, "3 numbers"),
        ("moment", (1.0, 2.0), "number"),
    ],
)
def test_a_parameter_that_cannot_be_is_answered_with_the_reason(
    setting: Setting, name: str, value: Any, reason: str
) -> None:
    program = setting.connect()
    program.say(f"/haptorb/parameter/{name}", *(value if isinstance(value, tuple) else (value,)))
    setting.look()
    assert reason in program.read()["/haptorb/error"][0]
    assert setting.request() is None


def test_worlds_are_changed_and_unknown_ones_are_refused(setting: Setting) -> None:
    program = setting.connect()
    program.say("/haptorb/world", "walll")
    setting.look()
    assert "wall" in program.read()["/haptorb/error"][0]
    assert setting.request() is None
    program.say("/haptorb/world", "wall")
    program.say("/haptorb/parameter/stiffness", 500.0)
    setting.look()
    assert setting.request() == {"name": "wall", "values": {"stiffness": 500.0}}


def test_the_world_and_the_ranges_of_its_parameters_can_be_asked_for(setting: Setting) -> None:
    program = setting.connect()
    program.say("/haptorb/parameters")
    setting.look()
    found = program.read_all()
    assert found[0] == {"/haptorb/world": ["dome"]}
    listed = {one["/haptorb/parameter"][0]: one["/haptorb/parameter"][1:] for one in found[1:]}
    *value, low, high, unit = listed["moment"]
    assert len(value) == 1
    assert low <= value[0] <= high
    assert unit == "A·m²"
    assert len(listed["summit"]) == 6


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"text",
        b"#bundle\0",
        b"#bundle\0" + bytes(8) + struct.pack(">i", -4) + b"/a\0\0",
        b"/" * 2000,
        b"/a\0\0,?\0\0",
    ],
)
def test_nonsense_is_counted_and_nothing_else_happens(setting: Setting, data: bytes) -> None:
    program = setting.connect()
    program.send(data)
    program.say("/haptorb/force", 1.0, 0.0, 0.0)
    setting.look()
    assert setting.loop.receive()[0] == [1.0, 0.0, 0.0]
    assert setting.report()["refused"] == 1


def test_the_newest_of_a_flood_counts_and_the_rest_is_counted(setting: Setting) -> None:
    flooding, other = setting.connect(), setting.connect()
    for _ in range(20):  # a flood that waited longer for a processor than a force is held is sent again
        for i in range(400):
            flooding.say("/haptorb/force", float(i % 7), 0.0, 0.0)
        flooding.say("/haptorb/force", 3.5, 0.0, 0.0)
        other.say("/haptorb/subscribe")
        sent = monotonic()
        for _ in range(5):
            setting.look()
        if (force := setting.loop.receive()[0]) != [0.0, 0.0, 0.0] or monotonic() < sent + HOLD_TIME_S:
            break
    assert force == [3.5, 0.0, 0.0]
    assert "/haptorb/subscribed" in other.read()
    report = setting.report()
    assert report["received"] + report["unread"] >= 402
    assert report["unread"] >= 401 - MAX_DATAGRAMS


def test_a_flood_of_others_does_not_push_out_who_was_understood_before(setting: Setting) -> None:
    program, flooding = setting.connect(), setting.connect()
    program.say("/haptorb/force", 0.5, 0.0, 0.0)
    setting.look()
    for _ in range(3000):  # more than the system keeps
        flooding.send(b"nonsense")
    program.say("/haptorb/force", 0.75, 0.0, 0.0)
    setting.look()
    assert setting.loop.receive()[0] == [0.75, 0.0, 0.0]
    for _ in range(20):
        setting.look()
        flooding.send(b"nonsense")  # the system tells with the next one what it dropped
    report = setting.report()
    assert report["received"] + report["unread"] >= 3000


def test_every_program_has_a_socket_of_its_own(setting: Setting) -> None:
    programs = [setting.connect() for _ in range(3)]
    for count, program in enumerate(programs, 1):
        program.say("/haptorb/subscribe")
        setting.look()
        assert len(setting.session.sockets) == 1 + count
    flooding = setting.connect()
    for program in programs:
        program.read_all()
        for _ in range(1500):  # more than the system keeps
            flooding.send(b"nonsense")
        program.say("/haptorb/parameters")
        setting.look()
        assert {"/haptorb/world": ["dome"]} in program.read_all()


@pytest.mark.parametrize("options", [("SO_REUSEADDR",), ("SO_REUSEPORT",), ("SO_REUSEADDR", "SO_REUSEPORT")])
def test_nobody_else_can_take_the_port(setting: Setting, options: tuple[str, ...]) -> None:
    for _ in range(2):
        setting.connect().say("/haptorb/subscribe")
        setting.look()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as thief:
        for option in options:
            thief.setsockopt(socket.SOL_SOCKET, getattr(socket, option), 1)
        with pytest.raises(OSError, match="in use"):
            thief.bind(setting.address)


class Hooked(socket.socket):
    """A socket that calls `before["bind"]` or `before["connect"]` with the address first."""

    before: ClassVar[dict[str, Callable[[Any], object]]] = {}

    def bind(self, address: Any) -> None:
        self.before.get("bind", bool)(address)
        super().bind(address)

    def connect(self, address: Any) -> None:
        self.before.get("connect", bool)(address)
        super().connect(address)


@pytest.fixture
def before(monkeypatch: pytest.MonkeyPatch) -> dict[str, Callable[[Any], object]]:
    """What happens before the server binds or connects the socket of a program."""
    monkeypatch.setattr(Hooked, "before", {})
    monkeypatch.setattr("haptorb.serve.osc.socket.socket", Hooked)
    return Hooked.before


def test_what_others_send_while_a_socket_is_opened_is_theirs(
    setting: Setting, before: dict[str, Callable[[Any], object]]
) -> None:
    program, others = setting.connect(), [setting.connect() for _ in range(12)]

    def speak(_: Any) -> None:
        for k, other in enumerate(others):
            other.say("/haptorb/subscribe", 0, 100 + k)

    before["connect"] = speak
    program.say("/haptorb/subscribe", 0, 500)
    setting.session.read_messages()
    before.clear()
    setting.look()
    assert program.read_all() == [{"/haptorb/subscribed": [500.0]}]
    for k, other in enumerate(others):
        assert other.read_all() == [{"/haptorb/subscribed": [100.0 + k]}]


@pytest.mark.parametrize("others", [0, 520])
def test_the_last_force_counts_that_was_sent_while_a_socket_was_opened(
    setting: Setting, before: dict[str, Callable[[Any], object]], others: int
) -> None:
    program, flooding = setting.connect(), setting.connect()

    def speak(address: Any) -> None:
        if address != setting.address:
            return
        for _ in range(others):  # so many that this turn does not read all
            flooding.send(b"nonsense")
        program.say("/haptorb/force", 0.5, 0.0, 0.0)

    before["bind"] = speak
    program.say("/haptorb/force", 0.25, 0.0, 0.0)
    setting.session.read_messages()
    before.clear()
    sleep(0.002)  # the order of messages from two sockets is known to 0.1 ms
    program.say("/haptorb/force", 0.75, 0.0, 0.0)
    setting.look()
    setting.look()
    assert setting.loop.receive()[0] == [0.75, 0.0, 0.0]
    assert setting.report()["received"] == 3 + others


def test_answers_to_nonsense_are_few(setting: Setting) -> None:
    program = setting.connect()
    for _ in range(20):
        program.say("/nothing/of/ours")
        setting.look()
    assert len(program.read_all()) <= 2
    assert setting.report()["refused"] == 20


def test_strangers_from_many_ports_do_not_add_up(setting: Setting) -> None:
    for _ in range(150):
        stranger = Program(setting.address)
        stranger.say("/haptorb/parameters")
        stranger.socket.close()
        setting.look()
    assert setting.report()["count"] <= 64


def test_the_holder_stays_while_programs_of_this_account_come_and_go(setting: Setting) -> None:
    holder = setting.connect()
    holder.say("/haptorb/force", 0.5, 0.0, 0.0)
    setting.look()
    session = setting.loop.receive()[1]
    for _ in range(3):
        for other in [setting.connect() for _ in range(30)]:
            other.say("/haptorb/unsubscribe")
        setting.look()
    holder.say("/haptorb/force", 0.75, 0.0, 0.0)
    setting.look()
    assert setting.loop.receive() == ([0.75, 0.0, 0.0], session)
    assert holder.read_all() == []


def test_nobody_without_the_token_takes_the_place_of_the_holder_or_gets_an_answer() -> None:
    with PublishedLoop(Remote()) as loop:
        setting = Setting(loop, token="a-token-of-this-run", beyond=True)
        holder = setting.connect()
        holder.say("/haptorb/force", "a-token-of-this-run", 0.5, 0.0, 0.0)
        setting.look()
        session = loop.receive()[1]
        strangers = [setting.connect() for _ in range(80)]
        for some in (strangers[:40], strangers[40:]):
            for stranger in some:
                stranger.send(b"nonsense")
                stranger.say("/haptorb/force", 9.0, 9.0, 9.0)
            setting.look()
        holder.say("/haptorb/force", "a-token-of-this-run", 0.75, 0.0, 0.0)
        setting.look()
        assert loop.receive() == ([0.75, 0.0, 0.0], session)
        assert [one for stranger in strangers for one in stranger.read_all()] == []
        report = setting.report()
        assert (report["count"], report["refused"]) == (1, 160)
        holder.send(b"nonsense")  # who showed the token is told
        setting.look()
        assert "/haptorb/error" in holder.read()
        setting.close()


def test_without_the_token_nothing_happens() -> None:
    with PublishedLoop(Nothing()) as loop:
        setting = Setting(loop, token="a-token-of-this-run", beyond=True)
        program = setting.connect()
        program.say("/haptorb/force", 1.0, 0.0, 0.0)
        program.say("/haptorb/force", "another", 1.0, 0.0, 0.0)
        program.say("/haptorb/subscribe")
        setting.look()
        assert loop.receive()[0] == [0, 0, 0]
        assert program.read_all() == []
        program.say("/haptorb/force", "a-token-of-this-run", 1.0, 0.0, 0.0)
        setting.look()
        assert loop.receive()[0] == [1.0, 0.0, 0.0]
        setting.close()


def test_what_waited_in_the_socket_is_not_felt_and_changes_no_world(setting: Setting) -> None:
    program = setting.connect()
    program.say("/haptorb/force", 1.0, 0.0, 0.0)
    program.say("/haptorb/world", "magnet")
    sleep(1.2)  # the server is stopped
    setting.look()
    assert setting.loop.receive() == ([0, 0, 0], 0.0)
    setting.look()
    assert setting.request() is None
    assert setting.report()["stale"] == 1
    program.say("/haptorb/force", 1.0, 0.0, 0.0)
    setting.look()
    assert setting.loop.receive()[0] == [1.0, 0.0, 0.0]


@pytest.mark.parametrize(
    "where", ["127.0.0.1", "host:", "127.0.0.1:99999", "127.0.0.1:-1", "no.such.host.example:9000", "a" * 300 + ":1"]
)
def test_an_address_that_is_none_is_refused(where: str) -> None:
    with pytest.raises(InputError, match="--serve osc"):
        prepare(where)


def test_a_port_in_use_is_told_with_who_has_it() -> None:
    taken = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    taken.bind(("127.0.0.1", 0))
    with taken, pytest.raises(InputError, match=r"in use by .*process"):
        prepare(f"127.0.0.1:{taken.getsockname()[1]}")


def test_beyond_this_computer_a_token_is_needed_and_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HAPTORB_SERVE_TOKEN", "a-token-that-stays-the-same")
    prepared = prepare("0.0.0.0:0")
    prepared.close()
    assert prepared.spec["token"] == "a-token-that-stays-the-same"
    assert "a-token-that-stays-the-same" in prepared.remarks[0]
    near = prepare("0")
    near.close()
    assert near.spec["token"] == "a-token-that-stays-the-same"  # for another account of this computer
    assert not near.spec["beyond"]
    assert near.remarks == ()
    assert near.address.startswith("osc.udp://127.0.0.1:")


def test_the_server_ends_with_the_servo() -> None:
    with PublishedLoop(Nothing()) as loop:
        prepared = prepare("127.0.0.1:0")
        loop.end()
        serve(prepared.spec, prepared.descriptors, loop.served)
        prepared.descriptors.clear()  # it has closed its socket


def test_a_request_that_was_met_is_not_repeated(setting: Setting) -> None:
    program = setting.connect()
    program.say("/haptorb/parameter/moment", 1.5)
    setting.look()
    version = setting.loop.shared.server_requests[0].version
    setting.loop.shared.announce_world(description(Dome(moment=1.5) + Remote()))
    sleep(0.06)
    setting.look()
    program.say("/haptorb/parameter/moment", 1.5)
    setting.look()
    assert setting.loop.shared.server_requests[0].version == version
