"""Limits of a gripper's force: size, rate, commanding client, and off with the coils."""

from __future__ import annotations

import math

import pytest

from haptorb.control.gripper import GripperGuard
from haptorb.devices.gripper import Gripper

GRIPPER = Gripper(0.025, 8.0, 0.1, 0.02, 0.05, 0.2, 1e-5, 0.02, 300.0, 2.0)
STEP = 8.0 * 1e-3 / 0.02


def test_clamped_and_slewed_to_the_devices_own_force() -> None:
    guard = GripperGuard(GRIPPER, 1e-3)
    found = [guard.limit(1e9, 1.0, 1.0) for _ in range(40)]
    assert found[:3] == pytest.approx([STEP, 2 * STEP, 3 * STEP])
    assert found[-1] == 8.0
    assert guard.limit(-1e9, 0.5, 1.0) == pytest.approx(0.5 * (8.0 - STEP))


@pytest.mark.parametrize("off", [(8.0, 0.0), (math.nan, 1.0), (math.inf, 1.0)])
def test_off_at_once_and_from_zero_again(off: tuple[float, float]) -> None:
    guard = GripperGuard(GRIPPER, 1e-3)
    for _ in range(40):
        guard.limit(8.0, 1.0, 1.0)
    assert guard.limit(*off, 1.0) == 0.0
    assert guard.limit(8.0, 1.0, 1.0) == pytest.approx(STEP)


def test_another_client_is_felt_after_zero() -> None:
    guard = GripperGuard(GRIPPER, 1e-3)
    for _ in range(40):
        guard.limit(8.0, 1.0, 1.0)
    found = [guard.limit(8.0, 1.0, 2.0) for _ in range(60)]
    assert min(found) == 0.0
    assert found[-1] == 8.0


def test_its_state_can_be_kept() -> None:
    first, second = GripperGuard(GRIPPER, 1e-3), GripperGuard(GRIPPER, 1e-3)
    for _ in range(7):
        first.limit(8.0, 1.0, 3.0)
    first.gather_state()
    second.state_arrays()["gripper"][:] = first.state_arrays()["gripper"]
    second.apply_state()
    assert second.limit(-8.0, 1.0, 3.0) == first.limit(-8.0, 1.0, 3.0) != 0.0
