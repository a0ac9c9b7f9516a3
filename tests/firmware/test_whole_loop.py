"""The whole loop with the real firmware in it: a dome felt through emulated chips and the simulated Omni."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from haptorb.control.least_squares import LeastSquaresAllocator
from haptorb.control.trip import GuardState
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.loader import load
from haptorb.runtime.driver import Driver
from haptorb.runtime.emulator import EmulatedDevice, Emulator
from haptorb.runtime.serial_driver import SerialDriver
from haptorb.runtime.sim_driver import SimDriver
from haptorb.runtime.tick import Tick
from haptorb.sensing.estimator import TrackedPose
from haptorb.worlds.dome import Dome

pytestmark = [pytest.mark.firmware, pytest.mark.timeout(600)]

PACE = 0.02


@pytest.fixture
def omni() -> SphericalElectromagnet:
    device = load("omni")
    assert isinstance(device, SphericalElectromagnet)
    return device


@pytest.fixture
def emulated(built: Path, tmp_path: Path, omni: SphericalElectromagnet) -> Iterator[tuple[EmulatedDevice, Emulator]]:
    at = np.array([0.0, 0.0, 0.052])
    device = EmulatedDevice(omni, tmp_path / "physics", lambda t: (at, np.array([0.0, 0.0, 0.0, 1.0])))
    device.simulation.place(at, (0, 0, 0, 1))
    with Emulator(built, tmp_path / "omni", physics=device) as emulator:
        yield device, emulator
    device.close()


def test_a_dome_is_felt_through_the_real_firmware(
    omni: SphericalElectromagnet, emulated: tuple[EmulatedDevice, Emulator]
) -> None:
    device, emulator = emulated
    driver = SerialDriver(omni, emulator.port, device.pose, patience=1.0, warm_up=90.0)

    def chain(through: Driver) -> Tick:
        allocator = LeastSquaresAllocator.force(omni.coils.current_limit, compensate_passive=True)
        return Tick(omni, Dome(), through, TrackedPose(omni, "exact"), allocator, 1e-3)

    tick = chain(driver)
    at = tick.layout
    row = at.empty()
    with SimDriver.of(omni, 1e-3) as practice:  # compiling takes longer than the firmware's patience
        rehearsal = chain(practice)
        for k in range(100):
            rehearsal.step(row, k * 1e-3)
    rows = []
    with driver:
        emulator.slow(PACE)
        deadline = time.monotonic()
        for k in range(400):
            deadline += 1e-3 / PACE
            time.sleep(max(0.0, deadline - time.monotonic()))
            tick.step(row, k * 1e-3)
            rows.append(row.copy())
        truth = device.truth()
    log = np.array(rows)
    assert tick.error == ""
    assert log[-1, at["guard"]][0] == GuardState.RUNNING
    asked = log[-50:, at["asked"]].mean(axis=0)
    assert asked[2] > 0.05  # the summit pushes back
    assert truth[2] == pytest.approx(asked[2], rel=0.1)
    currents = log[-50:, at["currents"]]
    assert np.abs(currents).max() > 0.5
    assert np.isfinite(log[:, at["field"]]).all()
    # the coil's own field is seen by the sensor below it, −z, in proportion to the current
    below = log[-1, at["field"]].reshape(9, 3)[4, 2]
    assert abs(below) > 1e-4
