"""Access of a server's process to the device: one client holds it, the others observe."""

from __future__ import annotations

import json
import math

import pytest

from haptorb.runtime.shared_memory import CAPACITY, Phase, Word
from haptorb.runtime.world_requests import description
from haptorb.serve import base
from haptorb.worlds import Remote, Terrain
from haptorb.worlds.client_force import FADE_TIME_S


def test_who_commands_first_holds_the_device_until_the_connection_is_lost(bench):
    first, second = bench.served.open_session(), bench.served.open_session()
    assert first != second
    assert bench.served.command(first, (0.1, 0.2, 0.3))
    assert not bench.served.command(second, (1.0, 1.0, 1.0))
    assert bench.served.busy == 1
    assert bench.read_client()["force"].tolist() == [0.1, 0.2, 0.3]
    assert bench.read_client()["session"] == first
    bench.served.lose(second)  # a watcher that goes changes nothing
    assert bench.read_client()["lost"] == 0.0
    bench.served.lose(first)
    assert bench.read_client(later=FADE_TIME_S)["lost"] >= FADE_TIME_S
    assert bench.served.command(second, (1.0, 0.0, 0.0))


def test_who_is_silent_lets_the_device_go(bench, monkeypatch):
    first, second = bench.served.open_session(), bench.served.open_session()
    bench.served.command(first, (0.1, 0.0, 0.0))
    now = base.monotonic()
    monkeypatch.setattr(base, "monotonic", lambda: now + base.CLIENT_TIMEOUT_S + 0.1)
    assert bench.served.holder == 0
    assert bench.served.command(second, (0.2, 0.0, 0.0))


def test_who_sends_zeros_to_be_answered_takes_nothing(bench):
    watcher, program = bench.served.open_session(), bench.served.open_session()
    assert bench.served.command(watcher, (0.0, 0.0, 0.0))
    assert bench.served.holder == 0
    assert bench.served.command(program, (0.0, 0.0, 0.5))
    assert bench.served.command(watcher, (0.0, 0.0, 0.0))  # neither refused nor felt
    assert bench.read_client()["force"].tolist() == [0.0, 0.0, 0.5]
    assert bench.served.command(program, (0.0, 0.0, 0.0))  # in free space: it still holds the device
    assert bench.served.holder == program
    assert not bench.read_client()["force"].any()


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e308])
def test_what_is_no_force_commands_nothing(bench, bad):
    session = bench.served.open_session()
    assert not bench.served.command(session, (0.0, bad, 0.0))
    assert bench.read_client()["session"] == 0
    assert bench.served.holder == 0


def test_rows_come_once_and_those_that_were_lost_are_counted(bench):
    bench.served.read_rows()
    for t in (2.0, 3.0):
        bench.publish(t=t)
    rows = bench.served.read_rows()
    assert rows[:, bench.shared.layout["t"].start].tolist() == [2.0, 3.0]
    assert len(bench.served.read_rows()) == 0
    for _ in range(CAPACITY + 9):
        bench.shared.ring.publish(rows[0])
    assert len(bench.served.read_rows()) + bench.served.dropped == CAPACITY + 9
    assert bench.served.dropped > 0


def test_buttons_reports_and_requests_pass_between_the_processes(bench):
    bench.shared.words[Word.BUTTONS] = 0b101
    assert bench.served.buttons == {"a": True, "b": False, "c": True}
    assert math.isnan(bench.served.grip)
    bench.shared.hand.write(0b010, 0.02)  # a scripted hand presses another button, with a gripper
    assert bench.served.buttons == {"a": True, "b": True, "c": True}
    assert bench.served.grip == 0.02
    bench.shared.hand.write(0, math.nan)
    assert bench.served.buttons == {"a": True, "b": False, "c": True}
    bench.served.report("haply", "ws://here", [{"name": "one", "session": 1, "rate_hz": 9.0, "holds": True}])
    assert json.loads(bench.shared.server_facts[0].read()[1])["clients"][0]["name"] == "one"
    bench.served.request_world("terrain", {"height": 0.5})
    assert json.loads(bench.shared.server_requests[0].read()[1]) == {"name": "terrain", "values": {"height": 0.5}}


def test_whether_the_world_that_is_felt_has_the_clients_force_in_it(bench):
    for world, has in ((Terrain() + Remote(), True), (Terrain(), False), (Remote(), True)):
        bench.shared.announce_world(description(world))
        assert bench.served.renders_force is has


def test_it_is_over_with_the_servo(bench):
    assert not bench.served.over
    bench.shared.words[Word.PHASE] = Phase.ENDED
    assert bench.served.over
