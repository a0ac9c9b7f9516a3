"""Tracker with errors: noisy and late poses, otherwise identical to the driver's."""

from __future__ import annotations

import numpy as np
import pytest

from haptorb.cli.check_world import PoseDelay
from haptorb.devices.loader import load
from haptorb.estimation.types import Pose
from haptorb.runtime.drivers.sim import ImperfectTracker, PoseDistortion, SimDriver
from haptorb_papers.guidance.trial import PoseNoise

DT = 1e-3
SPEED = np.array([0.2, 0.0, 0.0])  #: of the tool [m/s]


def move(t: float) -> Pose:
    """The pose of a tool that moves uniformly."""
    return Pose(t, np.eye(3), t * SPEED, np.zeros(3), SPEED, True)


@pytest.mark.parametrize("rate", [None, 250.0, 240.0])
def test_a_delayed_pose_is_the_true_one_of_its_time(rate: float | None) -> None:
    delay = PoseDelay(rate, 5e-3)
    poses = [delay.distort(n * DT, move(n * DT)) for n in range(200)]
    late = poses[50:]
    for n, pose in enumerate(late, start=50):
        assert pose.p == pytest.approx(pose.t * SPEED, abs=1e-12)
        assert pose.v == pytest.approx(SPEED, rel=1e-6)
        assert 5e-3 - 1e-9 <= n * DT - pose.t < 5e-3 + (1.0 / rate if rate else 1e-9)
    assert len({pose.t for pose in late}) == pytest.approx(150 * DT * (rate or 1000.0), abs=1)


def test_noise_has_its_deviation_and_is_the_same_after_a_reset() -> None:
    noise = PoseNoise(2e-5, 3)
    first = np.array([noise.distort(0.0, move(0.0)).p for _ in range(2000)])
    assert first.std(axis=0) == pytest.approx(2e-5, rel=0.06)  # four standard errors of 2000 samples
    noise.reset()
    assert (np.array([noise.distort(0.0, move(0.0)).p for _ in range(2000)]) == first).all()


def test_only_the_pose_differs_from_that_of_the_driver_behind_it() -> None:
    class Shift(PoseDistortion):
        def reset(self) -> None:
            self.count = 0

        def distort(self, now: float, pose: Pose) -> Pose:
            self.count += 1
            return Pose(pose.t, pose.R_SR, 2.0 * pose.p, pose.w, pose.v, pose.valid)

    omni, shift = load("omni"), Shift()
    plain, changed = SimDriver.of(omni, DT, seed=2), ImperfectTracker(SimDriver.of(omni, DT, seed=2), shift, shift)
    assert not changed.simulated
    with plain, changed:
        for n in range(20):
            changed.prepare(n * DT)
            one, other = plain.read(n * DT), changed.read(n * DT)
            assert (other.pose.p == 4.0 * one.pose.p).all()
            assert (other.currents == one.currents).all()
            assert (other.field == one.field).all()
            assert (plain.write(np.ones(3)) == changed.write(np.ones(3))).all()
            assert changed.coil_state == plain.coil_state
        assert (changed.wrench_actual() == plain.wrench_actual()).all()
        assert (changed.hand_goal() == plain.hand_goal()).all()
        assert shift.count == 40
