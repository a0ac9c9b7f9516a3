"""Inputs that failed in the field, as they were sent in, each with the right answer."""

from __future__ import annotations

import json
import math
import socket
import time
from pathlib import Path

import pytest
from pythonosc.osc_message_builder import OscMessageBuilder

from haptorb.devices.loader import load
from haptorb.errors import DeviceError
from haptorb.runtime.trackers.osc import OscFeed, osc_socket
from haptorb.runtime.trackers.pose_filter import PoseFilter
from haptorb.worlds.scene import parse_scene_file
from oracles.command import run_command

DEVICE = 'based_on = "omni"\nname = "{}"\ntitle = "Omni from an editor"\n'


def test_a_device_file_with_a_byte_order_mark_is_read(tmp_path: Path) -> None:
    path = tmp_path / "device.toml"
    path.write_bytes(b"\xef\xbb\xbf" + DEVICE.format("with-bom").encode())
    assert load(path).name == "with-bom"


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be"])
def test_a_device_file_in_utf_16_says_what_to_do(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "device.toml"
    path.write_bytes(DEVICE.format("sixteen").encode(encoding))
    with pytest.raises(DeviceError, match="save it as UTF-8"):
        load(path)


SCENES = {
    "outer.xml": """<mujoco model="included in single quotes">
  <option timestep="0.001"/>
  <include file='middle.xml'/>
</mujoco>
""",
    "middle.xml": """<mujocoinclude>
  <include file="inner.xml"/>
</mujocoinclude>
""",
    "inner.xml": """<mujocoinclude>
  <worldbody>
    <geom type="plane" size="1 1 0.1"/>
    <body name="held" pos="0 0 0.1"><freejoint/><geom type="sphere" size="0.02" mass="0.05"/></body>
  </worldbody>
</mujocoinclude>
""",
    "with-actuator.xml": """<mujoco model="a lever with a motor">
  <option timestep="0.001"/>
  <worldbody>
    <body name="lever" pos="0 0 0.1"><joint name="hinge" type="hinge" axis="0 1 0" damping="0.002"/>
      <geom type="capsule" fromto="0 0 0 0.08 0 0" size="0.006" mass="0.05"/></body>
  </worldbody>
  <actuator><position joint="hinge" kp="0.5"/></actuator>
</mujoco>
""",
}


@pytest.fixture
def scenes(tmp_path: Path) -> Path:
    for name, text in SCENES.items():
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.mark.parametrize("name", ["outer.xml", "middle.xml", "inner.xml"])
def test_a_change_of_any_included_file_reloads_the_scene(name: str, scenes: Path) -> None:
    watched = parse_scene_file("outer.xml", "held", scenes)
    assert watched.load().name == "scene-outer"
    before = watched.stamp
    (scenes / name).write_text(SCENES[name].replace("\n", "\n\n"))
    assert watched.stamp != before


def test_a_scene_with_an_actuator_runs(scenes: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = str(scenes / "with-actuator.xml")
    code, out, err = run_command(
        capsys, "run", "omni", "--scene", scene, "--body", "lever", "--headless", "--duration", "0.5", "--json"
    )
    assert code == 0, err
    assert json.loads(out)["world"] == "scene-with-actuator"
    assert "1 actuators" in " ".join(err.split())


@pytest.mark.parametrize("days", [None, 1.0, 10.0])
def test_poses_with_a_time_of_four_bytes_are_accepted(days: float | None) -> None:
    """Unix time, or a clock that has run for days; python-osc sends a Python float like that."""
    listening = osc_socket("127.0.0.1", 0)
    target = listening.getsockname()
    feed = OscFeed(listening)

    class Block:
        def write(self, pose: object) -> None:
            pass

    checked = PoseFilter(feed, Block())  # type: ignore[arg-type]
    offset, start, sent = time.time() if days is None else 86400.0 * days, time.monotonic(), 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        while (passed := time.monotonic() - start) < 1.0:
            made = OscMessageBuilder("/haptorb/pose")
            for number in (0.005 * math.sin(passed), 0.0, 0.052, 0.0, 0.0, 0.0, 1.0, offset + passed):
                made.add_arg(number, "f")
            sender.sendto(made.build().dgram, target)
            sent += 1
            checked.listen(0.004)
    checked.listen(0.05)
    feed.close()
    assert checked.accepted > 0.98 * sent > 50
    assert "time of arrival is used" in checked.facts()["remark"]
