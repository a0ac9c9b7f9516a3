"""A user's own world in the console: offered with its sliders, drawn, and reloaded when its file is saved."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from websockets.sync.client import ClientConnection, connect

from haptorb.devices.loader import load
from haptorb.simulation.force_map import force_map
from haptorb.web.force_map_process import ForceMapProcess
from haptorb.worlds.base import parameter
from haptorb.worlds.user_world import WorldFile
from oracles.groove import Groove

pytestmark = [pytest.mark.realtime, pytest.mark.usefixtures("quick_starts")]


@dataclass(frozen=True)
class Wider(Groove):
    """A wider groove."""

    width: float = parameter(0.01, "m", 0, 0.1, "of its floor")


def _until(socket: ClientConnection, event: str, **wanted: Any) -> dict[str, Any]:
    end = time.monotonic() + 10
    while time.monotonic() < end:
        message = socket.recv(timeout=5)
        if isinstance(message, str):
            told = json.loads(message)
            if told["event"] == event and wanted.items() <= told.items():
                return told
    raise AssertionError("it did not come")


def _describe(worlds: list[dict[str, Any]], name: str) -> dict[str, Any]:
    return next(world for world in worlds if world["name"] == name)


def _headers(console: Any) -> dict[str, str]:
    return {"Authorization": f"Bearer {console.token}"}


def test_it_is_offered_with_sliders_and_told_anew_after_it_was_loaded_again(console, servo):
    servo.own_worlds = {"groove": Groove(stiffness=30.0)}
    told = httpx.get(f"{console.origin}/api/session", headers=_headers(console)).json()
    groove = _describe(told["worlds"], "groove")
    assert groove["about"] == "A spring across y = 0."
    assert [(p["name"], p["default"], p["high"], p["unit"]) for p in groove["parameters"]] == [
        ("stiffness", 30.0, 200, "N/m")
    ]
    address = f"ws://127.0.0.1:{console.port}/ws"
    with connect(address, additional_headers=_headers(console), origin=console.origin) as socket:
        socket.send(json.dumps({"do": "world", "name": "groove", "values": {"stiffness": 40.0}}))
        assert _until(socket, "world", name="groove")["values"] == {"stiffness": 40.0}
        servo.own_worlds = {"groove": Wider()}
        again = _describe(_until(socket, "worlds")["worlds"], "groove")
        assert [p["name"] for p in again["parameters"]] == ["stiffness", "width"]


def test_a_bug_is_told_with_its_place_and_a_page_can_name_no_file(console, servo, tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ran = tmp_path / "ran"
    (tmp_path / "evil.py").write_text("open('ran', 'w')\n")
    servo.world_trouble = servo.warning = "world 'groove' failed: \n  File \"groove.py\", line 12, in Groove.wrench"
    address = f"ws://127.0.0.1:{console.port}/ws"
    with connect(address, additional_headers=_headers(console), origin=console.origin) as socket:
        assert "line 12" in _until(socket, "health")["world_trouble"]
        socket.send(json.dumps({"do": "world", "name": "evil.py:Groove", "values": {}}))
        assert "unknown world" in _until(socket, "mistake")["text"]
    assert not ran.exists()


def test_it_is_painted_with_the_code_of_its_file(tmp_path: Path):
    file = tmp_path / "groove.py"
    text = "from dataclasses import dataclass\nimport numpy as np\nfrom haptorb.worlds import World\n"
    text += "from haptorb.worlds.base import parameter\n@dataclass(frozen=True)\nclass Slope(World):\n"
    text += '    push: float = parameter(0.1, "N", 0, 1, "up")\n    def wrench(self, state):\n'
    text += "        return np.array([0, 0, self.push, 0, 0, 0])\n"
    file.write_text(text)
    slope = WorldFile(file).load()
    points = 0.05 * np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]])
    painted = ForceMapProcess(load("omni"))
    painted.own_worlds = lambda: {"slope": slope}
    try:
        force, _ = painted("slope", {"push": 0.2}, "exact", points)
    finally:
        painted.close()
    expected, _ = force_map(load("omni"), slope.replace(push=0.2), points)
    assert force == pytest.approx(expected)
