"""Markers and poses for other equipment: content, time stamps, and the message without the library."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from time import monotonic
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
import pytest

from haptorb.devices.loader import load
from haptorb.errors import InputError
from haptorb.recording.row import RowLayout
from haptorb_study.database import database
from haptorb_study.lsl_streams import Streams, open_streams
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import Study
from haptorb_study.trial_device import TrialDevice
from haptorb_study.trial_runner import TrialRunner

pytestmark = pytest.mark.realtime


class MemoryStream:
    """An outlet that keeps what it is given."""

    def __init__(self) -> None:
        self.samples: list[Any] = []
        self.times: list[float] = []

    def push_sample(self, x: Any, timestamp: float = 0.0) -> None:
        self.samples.append(x)
        self.times.append(timestamp)

    def push_chunk(self, x: Any, timestamp: Any = 0.0) -> None:
        self.samples += x.tolist()
        self.times += timestamp


class Rows:
    """A servo of which only rows are wanted: the n-th tick began at 100 + n/1000 s and saw the tool at x = n mm."""

    def __init__(self) -> None:
        self.layout = RowLayout.of(load("omni"))
        self.count = 0

    def rows(self, cursor: int = 0) -> tuple[int, np.ndarray]:
        first = max(cursor, self.count - 1000)
        rows = np.zeros((self.count - first, self.layout.width))
        n = np.arange(first, self.count)
        rows[:, self.layout["p"]] = np.stack([1e-3 * n, 0 * n, 0 * n], axis=1)
        rows[:, self.layout["wall"]] = (100 + 1e-3 * n)[:, None]
        rows[:, self.layout["valid"]] = 1
        return self.count, rows


def test_every_tick_is_sent_once_with_its_own_time() -> None:
    markers, pose, servo = MemoryStream(), MemoryStream(), Rows()
    streams = Streams(markers, pose, offset=5.0)
    for count in (3, 3, 10, 400):
        servo.count = count
        streams.poses(servo)  # type: ignore[arg-type]
    sent = np.array(pose.samples)
    assert sent.shape == (397, 8)  # from where the stream was when it was first asked
    assert sent[:, 0] == pytest.approx(1e-3 * np.arange(3, 400))
    assert pose.times == pytest.approx(105 + 1e-3 * np.arange(3, 400))
    assert (sent[:, 7] == 1).all()
    assert streams.lost == 0
    servo.count = 2000
    streams.poses(servo)  # type: ignore[arg-type]
    assert streams.lost == 600


def test_markers_tell_a_session_in_its_order(identify: Study, tmp_path: Path) -> None:
    from importlib.util import module_from_spec, spec_from_file_location

    spec = spec_from_file_location("fake_servo", Path(__file__).parents[1] / "fake_servo.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    servo, markers, now = module.FakeServo(), MemoryStream(), [0.0]
    streams = Streams(markers, MemoryStream(), offset=0.0)
    with StoredSession(database(tmp_path / "s.db"), identify, "P01") as session:
        runner = TrialRunner(session, TrialDevice(identify, servo), None, streams.mark, clock=lambda: now[0])
        servo.trip(module.Trip.OVERHEATED)
        runner.tick()
        runner.engage()
        runner.tick()
        runner.answer(1)
        runner.pause("test")
        now[0] += 100.0
        runner.tick()
        assert runner.rest_left == pytest.approx(2.0)  # a rest stands still in a pause
        runner.resume()
        now[0] += 2.0
        runner.tick()
    told = [json.loads(sample[0]) for sample in markers.samples]
    assert [one["kind"] for one in told] == [
        "trial", "safety", "device off", "repeat", "trial", "answer", "pause", "resume", "trial",
    ]  # fmt: skip
    assert told[1]["code"] == "OVERHEATED"
    assert told[3] == {"kind": "repeat", "trial": 1, "why": "the device was off: OVERHEATED"}
    assert told[5] == {"kind": "answer", "trial": 1, "answer": 1, "set_point": told[0]["set_point"]}
    assert [told[n]["trial"] for n in (0, 1, 2, 4, 8)] == [1, 1, 1, 1, 2]  # as the pages count
    assert markers.times == sorted(markers.times)


def test_an_unknown_reach_is_refused() -> None:
    with pytest.raises(InputError, match="'computer' or 'network'"):
        open_streams("everywhere")


def test_without_the_library_nothing_is_started(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pylsl", None)
    with pytest.raises(InputError, match="pip install pylsl"):
        open_streams("computer")


@pytest.mark.parametrize("own", ["", "the_laboratory_s.cfg"])
def test_the_network_is_configured_by_no_file_of_the_current_folder(
    own: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The library reads the file that LSLAPICFG names before all others, `lsl_api.cfg` of the current folder second."""
    monkeypatch.setenv("LSLAPICFG", own)
    if not own:
        monkeypatch.delenv("LSLAPICFG")
    monkeypatch.setenv("HOME", str(tmp_path))
    library = SimpleNamespace(StreamInfo=mock.MagicMock(), StreamOutlet=mock.MagicMock(), local_clock=monotonic)
    for name in ("IRREGULAR_RATE", "cf_string", "cf_double64"):
        setattr(library, name, 0)
    monkeypatch.setitem(sys.modules, "pylsl", library)
    open_streams("network")
    assert os.environ["LSLAPICFG"] == (own or os.devnull)


#: its own process: the library reads its configuration once
INLET = """
import json
import os
import numpy as np
import pylsl
from haptorb_study.lsl_streams import MARKERS, POSE, open_streams
from haptorb.devices.loader import load
from haptorb.recording.row import RowLayout

streams = open_streams("computer")
inlets = []
for name in (MARKERS, POSE):
    found = pylsl.resolve_byprop("name", name, timeout=20)
    assert len(found) == 1, (name, found)
    inlets.append(pylsl.StreamInlet(found[0]))
    inlets[-1].open_stream(timeout=20)
layout = RowLayout.of(load("omni"))

class Servo:
    count = 0
    def __init__(self): self.layout = layout
    def rows(self, cursor=0):
        rows = np.zeros((self.count - cursor, layout.width))
        rows[:, layout["p"]] = 0.05
        rows[:, layout["wall"]] = 7.0 + np.arange(cursor, self.count)[:, None] * 1e-3
        return self.count, rows

servo = Servo()
streams.poses(servo)
servo.count = 50
streams.poses(servo)
streams.mark("answer", {"trial": 3, "answer": 12})
told, when = inlets[0].pull_sample(timeout=20)
poses, times = [], []
while len(poses) < 50:
    more, stamps = inlets[1].pull_chunk(timeout=5)
    assert more
    poses += more
    times += stamps
offset = pylsl.local_clock() - __import__("time").monotonic()
print(json.dumps({"told": json.loads(told[0]), "now": abs(pylsl.local_clock() - when), "poses": len(poses),
                  "width": len(poses[0]), "first": times[0] - offset, "step": float(np.diff(times).mean())}))
"""


def test_an_inlet_on_this_computer_hears_both_streams() -> None:
    pytest.importorskip("pylsl", reason="pylsl is not installed")
    ran = subprocess.run([sys.executable, "-c", INLET], capture_output=True, text=True, timeout=120, check=False)
    assert ran.returncode == 0, ran.stderr
    heard = json.loads(ran.stdout.splitlines()[-1])
    assert heard["told"] == {"kind": "answer", "trial": 3, "answer": 12}
    assert (heard["poses"], heard["width"]) == (50, 8)
    assert heard["first"] == pytest.approx(7.0, abs=0.01)
    assert heard["step"] == pytest.approx(1e-3, rel=1e-3)
    assert heard["now"] < 60
