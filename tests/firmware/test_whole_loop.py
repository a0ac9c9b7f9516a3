"""Whole loop with the emulated firmware: a dome rendered through emulated chips and the simulated Omni."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from haptorb.control.allocation import LeastSquaresAllocator
from haptorb.control.trip_reasons import GuardState
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.loader import load
from haptorb.estimation.registry import make_estimator
from haptorb.estimation.sensor_calibration import without_errors
from haptorb.runtime.drivers.base import Driver, invalid_pose
from haptorb.runtime.drivers.emulator_process import EmulatedDevice, Emulator
from haptorb.runtime.drivers.serial import SerialDriver
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.runtime.tick import Tick
from haptorb.worlds.dome import Dome

pytestmark = [pytest.mark.firmware, pytest.mark.realtime, pytest.mark.timeout(600)]

PACE = 0.06
AT = np.array([0.0, 0.0, 0.052])
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


@pytest.fixture
def omni() -> SphericalElectromagnet:
    device = load("omni")
    assert isinstance(device, SphericalElectromagnet)
    return without_errors(device)  # sensors with noise and steps only: what turns cost is tried here


@pytest.fixture
def emulated(built: Path, tmp_path: Path, omni: SphericalElectromagnet) -> Iterator[tuple[EmulatedDevice, Emulator]]:
    device = EmulatedDevice(omni, tmp_path / "physics", lambda t: (AT, UPRIGHT))
    device.place(AT, UPRIGHT)
    with Emulator(built, tmp_path / "omni", physics=device) as emulator:
        yield device, emulator
    device.close()


@pytest.mark.parametrize("tracker", [pytest.param("tracker", marks=pytest.mark.slow), "hall"])
def test_a_dome_is_felt_through_the_real_firmware(
    omni: SphericalElectromagnet, emulated: tuple[EmulatedDevice, Emulator], tracker: str
) -> None:
    """With a perfect tracker, and with the field sensors alone, one axis of one block in each tick."""
    device, emulator = emulated
    pose = device.pose if tracker == "tracker" else invalid_pose
    driver = SerialDriver(
        omni, emulator.port, pose, timeout=1.0, warm_up=90.0, hall_axes=3, clock=lambda: time.monotonic() * PACE
    )

    def chain(through: Driver) -> Tick:
        allocator = LeastSquaresAllocator.force(omni.coils.current_limit, compensate_passive=True)
        estimator = make_estimator(omni, tracker, "exact", in_turns=True)
        return Tick(omni, Dome(), through, estimator, allocator, 1e-3)

    tick = chain(driver)
    at = tick.layout
    row = at.empty()
    with SimDriver.of(omni, 1e-3) as practice:  # compiling takes longer than the firmware's timeout
        rehearsal = chain(practice)
        for k in range(100):
            rehearsal.step(row, k * 1e-3)
    rows, away = [], []
    with driver:
        assert driver.field_axes is None
        emulator.set_pace(PACE)
        deadline = time.monotonic()
        for k in range(370):
            deadline += 1e-3 / PACE
            time.sleep(max(0.0, deadline - time.monotonic()))
            tick.step(row, k * 1e-3)
            rows.append(row.copy())
            away.append(row[at["p"]] - device.pose(0.0).p)
        truth = device.wrench_actual()
    log = np.array(rows)
    assert tick.error == ""
    assert log[-1, at["guard"]][0] == GuardState.RUNNING
    asked = log[-50:, at["wrench_commanded"]].mean(axis=0)
    assert asked[2] > 0.05  # the summit pushes back
    assert truth[2] == pytest.approx(asked[2], rel=0.1 if tracker == "tracker" else 0.25)
    currents = log[-50:, at["current_measured"]]
    assert np.abs(currents).max() > 0.5
    field = log[:, at["field"]]
    assert np.isfinite(field[1:]).sum(axis=1).max() <= 5  # the first has what was read while it was opened
    assert np.isfinite(field[-20:]).any(axis=0).all()  # every axis of every sensor in its turn
    # the coil's own field is seen by the sensor below it, −z, in proportion to the current
    assert abs(np.nanmean(field[-20:].reshape(-1, 9, 3)[:, 4, 2])) > 1e-4
    assert np.sqrt(np.square(away[150:]).sum(axis=1).mean()) < (1e-5 if tracker == "tracker" else 1.5e-3)
