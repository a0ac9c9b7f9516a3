"""Commanding client and its mapping: only the holder changes its own, and queued commands are dropped."""

from __future__ import annotations

import json
import time

import pytest

from haptorb.serve.base import MAX_WAIT_S
from haptorb.serve.haply import reply
from haptorb.serve.haply_protocol import Service
from haptorb.worlds.client_force import HOLD_TIME_S


def push(x, **more):
    return json.dumps({"inverse3": [{"commands": {"set_cursor_force": {"vector": {"x": x, "y": 0, "z": 0}}}, **more}]})


@pytest.fixture
def service(bench):
    return Service(bench.served, lambda *event: None)


TURNED = json.dumps({"rotation": {"x": 0, "y": 0, "z": 1, "w": 0}}).encode()


@pytest.mark.parametrize("query", ["", "?session=%d"])
def test_nobody_else_changes_the_holders_mapping(bench, service, query):
    holder, watcher = service.open("127.0.0.1"), service.open("127.0.0.1")
    service.answer(holder, push(1.0), time.monotonic())
    before = holder.space
    target = "/inverse3/0/config/workspace" + (query % holder.number if query else "")
    answer = reply(service, "POST", target, TURNED)
    assert answer.status == 400
    assert "commands the device" in answer.body["error"]
    assert holder.space == before
    assert watcher.space == before  # all or nothing
    assert reply(service, "DELETE", target, b"").status == 400
    service.answer(holder, push(1.0), time.monotonic())
    assert bench.read_client()["force"].tolist() == [1.0, 0.0, 0.0]
    assert reply(service, "POST", f"/inverse3/0/config/workspace?session={watcher.number}", TURNED).status == 200
    service.close(holder)
    assert reply(service, "POST", "/inverse3/0/config/workspace", TURNED).status == 200


def test_the_holder_changes_its_own_and_the_loop_knows(bench, service):
    holder = service.open("127.0.0.1")
    service.answer(holder, push(1.0), time.monotonic())
    number = bench.read_client()["mapping"]
    service.answer(holder, push(1.0, configure={"preset": "defaults"}), time.monotonic())
    assert bench.read_client()["mapping"] == number  # nothing has changed
    service.answer(holder, push(1.0, configure={"preset": "led_front"}), time.monotonic())
    client = bench.read_client()
    assert client["mapping"] != number
    assert client["force"].tolist() == pytest.approx([-1.0, 0.0, 0.0])


def test_small_turns_of_a_workspace_that_moves_stay_one_mapping_and_large_ones_do_not(bench, service):
    holder = service.open("127.0.0.1")

    def turn(half):
        moved = {"set_transform": {"transform": {"rotation": {"x": 0, "y": 0, "z": half, "w": (1 - half**2) ** 0.5}}}}
        commands = {"set_cursor_force": {"vector": {"x": 1}}, **moved}
        service.answer(holder, json.dumps({"inverse3": [{"commands": commands}]}), time.monotonic())
        return float(bench.read_client()["mapping"])

    first = turn(0.0)
    assert turn(0.01) == turn(0.02) == first
    assert turn(0.7) == first + 1


def test_a_command_that_waited_is_not_felt_and_takes_no_device(bench, service):
    client = service.open("127.0.0.1")
    service.answer(client, push(1.0), time.monotonic() - HOLD_TIME_S - 0.01)
    assert bench.read_client()["session"] == 0
    assert bench.served.holder == 0
    assert bench.served.stale == 1
    service.answer(client, push(1.0), time.monotonic() - HOLD_TIME_S / 2)
    assert bench.read_client()["age"] >= HOLD_TIME_S / 2


def test_what_waited_for_long_changes_no_mapping_either(service):
    client = service.open("127.0.0.1")
    before = client.space
    answer = service.answer(client, push(1.0, configure={"preset": "led_front"}), time.monotonic() - MAX_WAIT_S - 0.1)
    assert "inverse3" in answer
    assert client.space == before
