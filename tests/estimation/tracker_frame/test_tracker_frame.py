"""A tracker's frame as text, and poses transformed by it, for any frame and body."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from haptorb.devices.loader import load
from haptorb.errors import CalibrationError
from haptorb.estimation.calibration_file import read_frame, write_frame
from haptorb.estimation.tracker_frame import TrackerFrame
from haptorb.simulation.synthetic_tracker import SyntheticTracker

OMNI = load("omni")


def frame_of(tracker: SyntheticTracker, name: str = "osc:9000", simulated: bool = True) -> TrackerFrame:
    magnet = tracker.tip + OMNI.tool.tip_distance * tracker.axis
    return TrackerFrame(
        "omni", OMNI.digest, name, simulated, tracker.R, tracker.t, tracker.tip, magnet, tracker.axis,
        1e-4, 4.5, 1e-4, 3e-3,
    )  # fmt: skip


FRAME = frame_of(SyntheticTracker.draw(7))


@given(st.integers(0, 10**6))
def test_a_pose_of_the_body_becomes_that_of_the_tool(seed: int) -> None:
    tracker = SyntheticTracker.draw(seed, 0.0, 0.0)
    rng = np.random.default_rng(seed)
    tool = Rotation.random(random_state=rng).as_matrix()
    tip = rng.uniform(-0.1, 0.1, 3)
    seen = tracker.observe(tip[None], tool[None], rng)
    p, q = frame_of(tracker).transform_pose(seen.p[0].tolist(), seen.q[0].tolist())
    assert np.allclose(p, tip + OMNI.tool.tip_distance * tool[:, 2], atol=1e-12)
    assert np.allclose(Rotation.from_quat(q).as_matrix()[:, 2], tool[:, 2], atol=1e-12)


@given(st.lists(st.floats(), max_size=5), st.lists(st.floats(), max_size=5))
def test_what_cannot_be_a_pose_stays_for_others_to_refuse(p: list[float], q: list[float]) -> None:
    placed, turned = FRAME.transform_pose(p, q)
    if not (len(p) == 3 and len(q) == 4 and np.isfinite([*p, *q]).all() and np.hypot.reduce(p) < 1e3):
        assert str((placed, turned)) == str((tuple(p), tuple(q)))  # also where a number is none
    elif 0.5 < np.hypot.reduce(q) < 2.0:
        assert np.isclose(np.hypot.reduce(turned), np.hypot.reduce(q))  # its length is judged after this


def test_the_text_is_read_back_and_the_file_is_written_whole(tmp_path: Path) -> None:
    path = tmp_path / "omni.frame.json"
    write_frame(FRAME, path)
    again = read_frame(path)
    assert again.text() == FRAME.text()
    assert np.array_equal(again.R, FRAME.R)
    with pytest.raises(CalibrationError, match=r"exists; choose another name, .* overwrite=True$") as refused:
        write_frame(FRAME, path)
    assert refused.value.command_message.endswith("--force")  # as the command line calls it
    assert [one.name for one in tmp_path.iterdir()] == ["omni.frame.json"]
    with pytest.raises(CalibrationError, match=r"frame .*none.json: cannot be read \(No such file"):
        read_frame(tmp_path / "none.json")


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("format", "haptorb-calibration-1", "not a tracker's frame that this version can read"),
        ("digest", 7, "must be a text"),
        ("simulated", "no", "true or false"),
        ("shift_m", [0.0, 1.0], r"shape \(3,\)"),
        ("shift_m", ["here", 0, 0], "must be numbers"),
        ("turn", np.diag([1.0, 1.0, -1.0]).tolist(), "reflection"),
        ("turn", (2 * np.eye(3)).tolist(), "not a rotation"),
        ("axis", [0.0, 0.0, 0.5], "length 1"),
        ("magnet_m", [0.0, 0.0, 20.0], "more than 1 m from its rigid body"),
        ("residual_m", None, "finite"),
        ("strange", 1, "'strange' is not a known key"),
    ],
)
def test_a_file_that_is_none_says_what_was_expected(key: str, value: object, told: str) -> None:
    raw = json.loads(FRAME.text())
    raw[key] = value
    with pytest.raises(CalibrationError, match=told):
        TrackerFrame.parse(json.dumps(raw), "omni.frame.json")
    if key in json.loads(FRAME.text()) and key != "format":
        del raw[key]
        with pytest.raises(CalibrationError, match=f"{key} is missing"):
            TrackerFrame.parse(json.dumps(raw), "omni.frame.json")


def test_another_devices_and_another_trackers_frame_is_refused() -> None:
    assert FRAME.check_for(OMNI, "osc:9000") is FRAME
    with pytest.raises(CalibrationError, match=r"device 'omni' with file .*register again"):
        FRAME.check_for(replace(OMNI, digest="0" * 64), "osc:9000")
    with pytest.raises(CalibrationError, match="to tracker 'osc:9000', not to 'lsl:pen'"):
        FRAME.check_for(OMNI, "lsl:pen")
    with pytest.raises(CalibrationError, match="is not JSON"):
        TrackerFrame.parse("{", "omni.frame.json")
