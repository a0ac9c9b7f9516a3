"""Guided calibration through the emulated firmware: deviations are found, the id is stored in the EEPROM."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from haptorb.cli.calibration_dialog import Dialog, check_steps, guide_calibration
from haptorb.cli.calibration_measurement import Pace
from haptorb.cli.calibration_steps import CalibrationEffort, Step
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.loader import load
from haptorb.runtime.drivers.emulator_process import EmulatedDevice, Emulator
from haptorb.runtime.drivers.serial import SerialDriver
from haptorb.runtime.servo_process import disagreement

# Its two halves are in every run: the dialog on a simulated device, and the id in the EEPROM (test_emulated_board.py).
pytestmark = [pytest.mark.firmware, pytest.mark.realtime, pytest.mark.slow, pytest.mark.timeout(900)]

PACE = 0.2
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


class Person:
    """Holds the simulated tool where each step wants it."""

    def __init__(self, device: SphericalElectromagnet) -> None:
        self._device = device
        self.at = np.array([0.0, 0.0, 0.5])

    def goal(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        return self.at, UPRIGHT

    def place(self, step: Step, emulated: EmulatedDevice) -> bool:
        self.at = np.array([0.0, 0.0, self._device.contact_distance if step.hand == "summit" else 0.5])
        emulated.place(self.at, UPRIGHT)
        return True


def slowly(driver: SerialDriver, emulator: Emulator) -> SerialDriver:
    """Opened at real time, measured at a fifth of it: a busy computer may then be silent for a moment."""
    original = driver.open

    def open_then_slow() -> None:
        emulator.execute("pace 1")
        original()
        emulator.execute(f"pace {PACE}")

    driver.open = open_then_slow  # type: ignore[method-assign]
    return driver


def test_a_device_behind_the_real_firmware_is_calibrated(built: Path, tmp_path: Path) -> None:
    omni = load("omni")
    assert isinstance(omni, SphericalElectromagnet)
    skew = np.array([[1.04, 0.03, 0.0], [0.0, 0.97, 0.0], [0.0, 0.02, 1.03]])
    truth = replace(omni, moment_per_current=skew @ omni.moment_per_current, tolerance=None)
    person, out, said = Person(omni), tmp_path / "omni.json", []
    emulated = EmulatedDevice(truth, tmp_path / "physics", person.goal)
    pace = Pace(lambda: time.monotonic() * PACE, lambda seconds: time.sleep(seconds / PACE))
    try:
        with Emulator(built, tmp_path / "omni", physics=emulated) as emulator:
            driver = slowly(SerialDriver(omni, emulator.port, timeout=1.0, warm_up=90.0), emulator)
            guide = Dialog(said.append, lambda step: person.place(step, emulated))
            steps = check_steps(["rest", "currents", "magnetic", "tool"])
            found = guide_calibration(
                omni, driver, out, steps=steps, pace=pace, guide=guide, effort=CalibrationEffort(levels=1, repeats=2)
            )
            assert found is not None, said
            assert not found.simulated
            scale = np.linalg.norm(truth.moment_per_current, axis=0)
            assert np.abs((found.moment_per_current - truth.moment_per_current) / scale).max() < 0.02
            assert found.resistance == pytest.approx(omni.coils.resistance, rel=0.02)
            assert any(found.id.hex() in line for line in said)
            with driver:
                assert driver.calibration == found.id
                assert disagreement(driver.calibration, found.id) == ""
                assert "load its file" in disagreement(driver.calibration, None)
    finally:
        emulated.close()
