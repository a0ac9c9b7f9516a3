"""A tracker in its own frame, through its process, into the loop: pose, velocities, losses and times."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haptorb.arrays import Array
from haptorb.devices.loader import load
from haptorb.errors import CalibrationError, InputError
from haptorb.estimation.tracker_frame import TrackerFrame
from haptorb.runtime.servo import Servo
from haptorb.runtime.shared_memory import WORDS, PoseBlock
from haptorb.runtime.trackers.base import Feed, FramedFeed, RawPose, RejectedPose
from haptorb.runtime.trackers.pose_filter import PoseFilter
from haptorb.simulation.synthetic_tracker import SyntheticTracker

from .test_trackers import free_port, message, running, sending, until

OMNI = load("omni")
TRACKER = SyntheticTracker.draw(12, 0.0, 0.0)
UP = OMNI.tool.tip_distance


def frame(name: str, simulated: bool = True) -> TrackerFrame:
    magnet = TRACKER.tip + UP * TRACKER.axis
    return TrackerFrame(
        "omni", OMNI.digest, name, simulated, TRACKER.R, TRACKER.t, TRACKER.tip, magnet, TRACKER.axis,
        1e-4, 4.5, 1e-4, 3e-3,
    )  # fmt: skip


def body_seen_at(magnet: Array, turn: Array) -> tuple[list[float], list[float]]:
    """Where the tracker sees the body while the tool's magnet is there, turned so."""
    one = TRACKER.observe((magnet - UP * turn[:, 2])[None], turn[None], np.random.default_rng(0))
    return one.p[0].tolist(), one.q[0].tolist()


class ScriptFeed(Feed):
    """A feed that says what the test wants."""

    def __init__(self) -> None:
        self.next: list[RawPose | RejectedPose] = []
        self.closed = False

    def receive(self, timeout: float) -> Iterator[RawPose | RejectedPose]:
        while self.next:
            yield self.next.pop(0)

    def close(self) -> None:
        self.closed = True


def test_pose_velocity_and_turning_rate_are_the_stators_and_times_are_untouched() -> None:
    told = ScriptFeed()
    block = PoseBlock((memory := memoryview(bytearray(8 * WORDS))).cast("q"), memory.cast("d"), 0)
    pose_filter = PoseFilter(FramedFeed(told, frame("osc:9000")), block)
    v, w = np.array([0.05, -0.1, 0.02]), np.array([0.3, -0.2, 0.8])
    for k in range(60):
        t = 0.005 * k
        turn = Rotation.from_rotvec(w * t).as_matrix()
        told.next = [RawPose(*map(tuple, body_seen_at(np.array([0.0, 0.0, 0.05]) + v * t, turn)), 10.0 + t, 10.001 + t)]
        pose_filter.listen(0.0)
    now = block.read_pose()
    assert now.valid
    assert now.stamp == 10.0 + 0.005 * 59  # as it was measured
    assert np.allclose(now.p, [0.0, 0.0, 0.05] + v * 0.295, atol=1e-9)
    assert np.allclose(Rotation.from_quat(now.q).as_matrix()[:, 2], Rotation.from_rotvec(w * 0.295).as_matrix()[:, 2])
    assert np.allclose(now.v, v, atol=1e-6)
    assert np.allclose(now.w, w, atol=1e-6)
    told.next = [RawPose((), (), 10.4, 10.4, False), RejectedPose("stranger")]
    pose_filter.listen(0.0)
    assert not block.read_pose().valid
    assert pose_filter.lost == 1
    assert pose_filter.refused["stranger"] == 1
    FramedFeed(told, frame("osc:9000")).close()
    assert told.closed


@pytest.mark.realtime
@pytest.mark.usefixtures("quick_starts")
def test_the_loop_follows_a_tracker_in_its_own_frame() -> None:
    """The tool's magnet at (10, −5, 55) mm, tilted, told as a rigid body's pose a metre away in a turned frame."""
    port = free_port()
    place, turn = np.array([0.010, -0.005, 0.055]), Rotation.from_rotvec([0.2, 0.1, 0.5]).as_matrix()
    p, q = body_seen_at(place, turn)
    assert np.linalg.norm(p) > 0.5
    name = f"osc:{port}"
    with (
        Servo("omni", "nothing", tracker=name, frame=frame(name), record=False) as servo,
        sending(port, make=lambda: message("/haptorb/pose", *p, *q)),
    ):
        until(servo, lambda: running(servo))
        until(servo, lambda: bool(np.allclose(servo.latest()[servo.layout["hand_goal"]], place, atol=1e-6)))
        told = servo.latest()[servo.layout["hand_goal_q"]]
        assert np.allclose(Rotation.from_quat(told).as_matrix()[:, 2], turn[:, 2], atol=1e-6)
        end = time.monotonic() + 10.0
        while np.linalg.norm(servo.latest()[servo.layout["p"]] - place) > 0.01 and time.monotonic() < end:
            time.sleep(0.01)
        assert np.linalg.norm(servo.latest()[servo.layout["p"]] - place) < 0.01  # the simulated hand went there


@pytest.mark.parametrize(
    ("tracker", "made", "error", "told"),
    [
        ("pointer", frame("pointer"), InputError, "already reports poses in the stator's frame"),
        ("replay:run.mcap", frame("replay:run.mcap"), InputError, "already reports poses in the stator's frame"),
        ("osc:9001", frame("osc:9000"), CalibrationError, "to tracker 'osc:9000', not"),
        (
            "osc:9000",
            replace(frame("osc:9000"), digest="1" * 64),
            CalibrationError,
            "device 'omni' with file '1111",
        ),
    ],
)
def test_a_frame_that_is_another_ones_is_refused_before_anything_starts(
    tracker: str, made: TrackerFrame, error: type[Exception], told: str
) -> None:
    with pytest.raises(error, match=told):
        Servo("omni", tracker=tracker, frame=made)


def test_a_rehearsed_frame_never_moves_a_real_device() -> None:
    with pytest.raises(InputError, match="registered in a rehearsal, driver 'serial:/dev/none' moves a real device"):
        Servo("omni", driver="serial:/dev/none", tracker="osc:9000", frame=frame("osc:9000"))
    assert Servo(
        "omni", driver="serial:/dev/none", tracker="osc:9000", frame=frame("osc:9000", simulated=False)
    ).config.frame
