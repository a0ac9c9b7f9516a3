"""Servo, server process and client, end to end: commands are rendered, and end with the commanding client."""

from __future__ import annotations

import json
import os
import signal
import time

import numpy as np
import pytest
from websockets.sync.client import connect

from haptorb import Recording, RunConfig, Servo
from haptorb.replay.replay import Replay
from haptorb.serve.base import Serving, add_client_force, check_servers, hold_tool
from haptorb.worlds import Remote, Terrain
from haptorb.worlds.user_world import parse_world_file

pytestmark = pytest.mark.realtime


def wait_for(condition, seconds=30.0):
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.005)
    return found


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    path = tmp_path_factory.mktemp("serve") / "run.mcap"
    choices = check_servers(["haply:0:0"])
    servo = Servo(hold_tool(RunConfig.of("omni", Terrain() + Remote()), choices), record=path)
    with Serving(choices, servo) as serving, servo:
        serving.start()
        yield servo, int(serving.lines[0].split(",")[0].rpartition(":")[2])


def memory(servo, name):
    """A field of the world's memory in the newest row."""
    world, row = servo.latest(), 0
    known = json.loads(servo._shared.worlds_since(0)[-1][1])["memory"]
    for field in known:
        size = int(np.prod(field["shape"]))
        if field["name"] == name:
            values = world.memory[row : row + size]
            return values if size > 1 else float(values[0])
        row += size
    raise AssertionError(f"no {name} in {[field['name'] for field in known]}")


def push(client, z):
    client.send(json.dumps({"inverse3": [{"commands": {"set_cursor_force": {"vector": {"x": 0, "y": 0, "z": z}}}}]}))
    return json.loads(client.recv(timeout=20))


def test_a_clients_force_is_felt_and_recorded_with_its_session_and_ends_with_silence_and_loss(running):
    servo, port = running
    with connect(f"ws://localhost:{port}", compression=None) as client:
        session = json.loads(client.recv(timeout=20))["session_id"]
        wait_for(lambda: push(client, 0.0)["inverse3"][0]["status"]["calibrated"])
        wait_for(lambda: push(client, 0.4) and memory(servo, "remote_fade") == 1.0)
        assert memory(servo, "remote_force").tolist() == [0.0, 0.0, 0.4]
        assert memory(servo, "remote_session") == session
        wait_for(lambda: any(one["clients"] for one in servo.connections))
        wait_for(lambda: memory(servo, "remote_fade") == 0.0)  # silent, with the socket open
        assert memory(servo, "remote_lost") == 0.0
        wait_for(lambda: push(client, 0.4) and memory(servo, "remote_fade") == 1.0)
    wait_for(lambda: memory(servo, "remote_lost") > 0.0)
    wait_for(lambda: memory(servo, "remote_fade") == 0.0)


def test_a_server_that_is_stopped_or_killed_leaves_no_force(running):
    servo, port = running
    with connect(f"ws://localhost:{port}", compression=None) as client:
        client.recv(timeout=20)
        (server,) = _children(os.getpid(), "server_process")
        wait_for(lambda: push(client, 0.4) and memory(servo, "remote_fade") == 1.0)
        os.kill(server, signal.SIGSTOP)
        wait_for(lambda: memory(servo, "remote_fade") == 0.0)
        os.kill(server, signal.SIGCONT)
        wait_for(lambda: push(client, 0.4) and memory(servo, "remote_fade") == 1.0)
        os.kill(server, signal.SIGKILL)
        wait_for(lambda: memory(servo, "remote_fade") == 0.0)
        assert servo.alive


OWN = """import numpy as np
from haptorb.worlds import World

class Floor(World):
    def wrench(self, state):
        return np.array([0.0, 0.0, {force}, 0.0, 0.0, 0.0])
"""


@pytest.mark.slow
def test_the_users_own_world_is_felt_beside_the_clients_and_keeps_them_when_it_is_saved(tmp_path):
    haply, file, path = check_servers(["haply:0:0"]), tmp_path / "floor.py", tmp_path / "run.mcap"
    file.write_text(OWN.format(force=0.05))
    world = add_client_force(parse_world_file(f"{file}:Floor"), haply)
    servo = Servo(hold_tool(RunConfig.of("omni", world), haply), record=path)
    with Serving(haply, servo) as serving, servo:
        serving.start()
        port = int(serving.lines[0].split(",")[0].rpartition(":")[2])
        with connect(f"ws://localhost:{port}", compression=None) as client:
            client.recv(timeout=20)
            wait_for(lambda: push(client, 0.2) and servo.latest().wrench_commanded[2] == pytest.approx(0.25))
            file.write_text(OWN.format(force=0.07))
            wait_for(lambda: push(client, 0.2) and servo.latest().wrench_commanded[2] == pytest.approx(0.27))
            wait_for(
                lambda: servo.latest().wrench_commanded[2] == pytest.approx(0.07)
            )  # it ends with its client's silence
        assert servo.world[0] == "floor"
        assert list(servo.own_worlds) == ["floor"]
    recording = Recording(path)
    replay = Replay(recording)
    found = replay.run()
    assert "has changed" in " ".join(replay.remarks), "the first version is gone"
    assert found.identical, found.first


def _children(parent, module):
    found = []
    for number in filter(str.isdecimal, os.listdir("/proc")):
        try:
            with open(f"/proc/{number}/stat") as stat, open(f"/proc/{number}/cmdline") as command:
                if int(stat.read().rpartition(")")[2].split()[1]) == parent and module in command.read():
                    found.append(int(number))
        except OSError:
            continue
    return found
