"""Inputs that failed in the field, as reported, each with the correct result."""

from __future__ import annotations

import json
import math
import socket
import time
from pathlib import Path

import pytest
from pythonosc.osc_message_builder import OscMessageBuilder

from fuzz.hostile_files import Kind, kinds
from haptorb.devices.loader import load
from haptorb.errors import DeviceError, HaptorbError
from haptorb.runtime.trackers.formats import parse_format, split_format
from haptorb.runtime.trackers.osc_feed import OscFeed, osc_socket
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


@pytest.fixture(scope="module")
def text_kinds(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Kind]:
    """A good file of every kind of text that haptorb reads, and its reader."""
    return {one.name: one for one in kinds(tmp_path_factory.mktemp("kinds")) if one.text}


TEXTS = ("device", "motor", "variant", "design", "study", "calibration", "frame", "progress", "ratings", "thermal",
         "loads", "hand", "hand table")  # fmt: skip


@pytest.mark.parametrize("name", TEXTS)
def test_a_byte_order_mark_or_an_ending_in_capitals_changes_no_file(
    name: str, text_kinds: dict[str, Kind], tmp_path: Path
) -> None:
    kind = text_kinds[name]
    path = tmp_path / f"file{kind.ending.upper() if kind.ending not in ('.network', '.steps') else kind.ending}"
    path.write_bytes(b"\xef\xbb\xbf" + kind.good)
    kind.read(path)


#: files of the program's own, not a person's: one that cannot be read is ignored with a line, or partly read
OWN = ("progress", "ratings")


@pytest.mark.parametrize("encoding", ["utf-16", "latin-1"])
@pytest.mark.parametrize("name", [one for one in TEXTS if one not in OWN])
def test_another_encoding_says_what_to_do_in_one_line(
    encoding: str, name: str, text_kinds: dict[str, Kind], tmp_path: Path
) -> None:
    kind = text_kinds[name]
    path = tmp_path / f"file{kind.ending}"
    path.write_bytes((kind.good.decode() + "# \N{MICRO SIGN}\n").encode(encoding, "replace"))
    with pytest.raises(HaptorbError, match="save it as UTF-8") as told:
        kind.read(path)
    assert "\n" not in str(told.value)


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


@pytest.mark.realtime
def test_a_scene_with_an_actuator_runs(scenes: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = str(scenes / "with-actuator.xml")
    code, out, err = run_command(
        capsys, "run", "omni", "--scene", scene, "--body", "lever", "--headless", "--duration", "0.5", "--json"
    )
    assert code == 0, err
    assert json.loads(out)["world"] == "scene-with-actuator"
    assert "1 actuator (actuator 1) holds" in " ".join(err.split())


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "latin-1"])
@pytest.mark.parametrize("name", ["outer.xml", "inner.xml"])
def test_a_scene_of_another_editor(name: str, encoding: str, scenes: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also an included file, and endings in capitals."""
    (scenes / name).write_bytes((SCENES[name] + "<!-- \N{MICRO SIGN} -->\n").encode(encoding))
    (scenes / "outer.xml").rename(scenes / "OUTER.XML")
    words = ("check", "pmsm", "--scene", str(scenes / "OUTER.XML"), "--body", "held", "--json")
    code, out, err = run_command(capsys, *words)
    if encoding == "utf-8-sig":
        assert json.loads(out)["scene"] == "OUTER", err
    else:
        assert (code, out) == (2, "")
        assert "save it as UTF-8" in " ".join(err.split())
        assert ("OUTER.XML" if name == "outer.xml" else name) in err


def test_every_command_takes_a_file_whose_name_ends_in_capitals(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in {
        "DEVICE.TOML": DEVICE.format("capitals"),
        "POSES.TOML": "[[messages]]\naddress = '/pose'\nvalues = ['x', 'y', 'z', 'qx', 'qy', 'qz', 'qw']\n",
        "WORLD.PY": "import numpy as np\n\n\ndef Push(state):\n    return np.zeros(6)\n",
        "COST.PY": "def cost(candidate):\n    return candidate.device.dome_radius\n",
        "SEARCH.TOML": "name = 'search'\nbase = 'DEVICE.TOML'\n[parameters.radius]\nlow = '27 mm'\nhigh = '30 mm'\n"
        "places = ['dome.radius']\n[objectives.cost]\nfunction = 'COST.PY:cost'\n",
    }.items():
        Path(name).write_text(text)
    for words in (
        "inspect DEVICE.TOML --json",
        "show DEVICE.TOML -o DRAWING.PNG",
        "check DEVICE.TOML --world WORLD.PY:Push --json",
        "study new STUDY.TOML",
        "study check STUDY.TOML",
        "study simulate STUDY.TOML --participants 1 --db S.SQLITE",
        "study export S.SQLITE TRIALS.CSV",
        "study export S.SQLITE OTHER.PARQUET",
        "study analyse S.SQLITE --out REPORT",
        "design sweep SEARCH.TOML --count 2 --processes 1 --into R.SQLITE",
        "design report R.SQLITE -o REPORT.HTML",
    ):
        code, _, err = run_command(capsys, *words.split())
        assert code in (0, 1), (words, err)
    assert Path("DRAWING.PNG").read_bytes().startswith(b"\x89PNG")
    assert Path("TRIALS.CSV").read_text().count("\n") > 2
    assert Path("OTHER.PARQUET").read_bytes().startswith(b"PAR1")
    assert split_format("9000,POSES.TOML") == ("9000", ("POSES.TOML",))
    assert parse_format(["POSES.TOML"])[0] is not None


@pytest.mark.parametrize("days", [1.0, *(pytest.param(days, marks=pytest.mark.slow) for days in (None, 10.0))])
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
