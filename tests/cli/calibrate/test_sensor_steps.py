"""Steps `fields` and `sensors`: rejected inputs, leftovers, a failed sensor, and multiplexed readings."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from haptorb.cli.calibration_dialog import Dialog, check_steps, guide_calibration
from haptorb.cli.calibration_measurement import make_driver
from haptorb.cli.calibration_steps import CalibrationEffort, Step
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.field_sensors import draw_sensors
from haptorb.devices.loader import load
from haptorb.errors import CalibrationError
from haptorb.estimation.calibration_file import Calibration, read_calibration
from haptorb.estimation.types import Sample
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.simulation.electromagnet import SimulatedElectromagnet

OMNI = replace(load("omni"), tolerance=None)  # simulated as its file says
SEED = 5  #: chooses the device, too
BEFORE = ["rest", "currents", "magnetic"]
EFFORT = CalibrationEffort(levels=1, repeats=2, drives=2, led=10.0)
Change = Callable[[str, Sample], Sample]


def calibrate(
    out: Path,
    change: Change = lambda step, sample: sample,
    dead: tuple[int, ...] = (),
    led: float = 10.0,
    until: str = "",
) -> tuple[Calibration | None, list[str]]:
    """Calibrate the simulated device with failed sensors, up to step `until`; `change` makes other readings of it."""
    assert isinstance(OMNI, SphericalElectromagnet)
    driver, pace = make_driver("sim", OMNI, SEED)
    assert isinstance(driver, SimDriver)
    assert isinstance(driver.simulation, SimulatedElectromagnet)
    driver.simulation.fail(dead)
    read, said, begun = driver.read, [], [""]

    def begin(step: Step) -> bool:
        begun[0] = step.name
        return step.name != until

    driver.read = lambda now: change(begun[0], read(now))  # type: ignore[method-assign]
    steps = check_steps([*BEFORE, "fields", "sensors"])
    guide, effort = Dialog(said.append, begin), replace(EFFORT, led=led)
    try:
        found = guide_calibration(OMNI, driver, out, steps=steps, pace=pace, guide=guide, effort=effort)
    finally:
        assert not driver._duties.any()  # coils off, however it ended
    return found, said


def list_steps(out: Path) -> list[str]:
    """Steps whose results are kept; nothing else was written."""
    kept = out.with_name(out.name + ".steps")
    assert list(out.parent.iterdir()) == [kept]
    return list(json.loads(kept.read_text())["steps"])


@pytest.mark.parametrize(
    ("current", "message"),
    [
        (15.0, r"step 'fields': coil 'y' carries 15 A where 0 A should flow: it does not switch. Switch off .* supply"),
        (0.0, r"step 'fields': coil 'y' carries 0 A instead of 15 A: the coil is unplugged.*repeat the command"),
    ],
    ids=["always on", "never on"],
)
def test_a_coil_that_does_not_switch_ends_the_step(current: float, message: str, tmp_path: Path) -> None:
    def stick(step: str, sample: Sample) -> Sample:
        stuck = (np.arange(3) == 1) & (step == "fields")
        return replace(sample, currents=np.where(stuck, current, sample.currents))

    with pytest.raises(CalibrationError, match=message):
        calibrate(tmp_path / "omni.json", stick)
    assert list_steps(tmp_path / "omni.json") == BEFORE


def test_what_the_coils_leave_in_the_core_is_no_offset(tmp_path: Path) -> None:
    """4 mA·m² along each axis are up to 5 µT at a sensor: the last currents alternate, so that they cancel."""
    assert isinstance(OMNI, SphericalElectromagnet)
    calibrate(tmp_path / "omni.json", until="sensors")
    kept = json.loads((tmp_path / "omni.json.steps").read_text())["steps"]["fields"]
    away = np.array(kept["at_rest_t"]) - draw_sensors(OMNI.hall.errors, OMNI.sensors, SEED).offset
    away -= away.mean(axis=0)  # of the tool, half a metre away
    assert np.sqrt((away**2).mean()) < 1.2e-6


def test_a_tool_that_was_not_led_ends_the_step(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"step 'sensors': the tool was not moved enough: .*from the summit.*"):
        calibrate(tmp_path / "omni.json", led=4.0)
    assert list_steps(tmp_path / "omni.json") == [*BEFORE, "fields"]


def test_a_dead_sensor_is_named_and_the_rest_is_used_in_the_field_of_the_earth(tmp_path: Path) -> None:
    assert isinstance(OMNI, SphericalElectromagnet)
    earth = np.array([25e-6, 0.0, -43e-6])  # 0.05 mT, dips by 60°

    def add_earth(step: str, sample: Sample) -> Sample:
        return replace(sample, field=sample.field + earth * sample.field.any(axis=1, keepdims=True))

    found, said = calibrate(tmp_path / "omni.json", add_earth, dead=(4,))
    assert found is not None
    assert found.sensors is not None
    away = found.sensors.correction.offset - draw_sensors(OMNI.hall.errors, OMNI.sensors, SEED).offset
    assert away[np.arange(9) != 4].mean(axis=0) == pytest.approx(earth, abs=4e-6)  # it counts as offset
    assert found.sensors.failed == (5,)
    assert found.sensors.place < 1e-3
    assert sum("field sensor 5" in line for line in said) == 3  # magnetic, fields, sensors
    kept = read_calibration(tmp_path / "omni.json")
    assert kept.text() == found.text()


def test_readings_in_turns_are_enough(tmp_path: Path) -> None:
    """As from a board: every tick brings the next of 27 readings, six ticks all of them."""
    ticks = count()

    def take_turns(step: str, sample: Sample) -> Sample:
        due = np.arange(27).reshape(9, 3) * 6 // 27 == next(ticks) % 6
        return replace(sample, field=np.where(due, sample.field, np.nan))

    found, _ = calibrate(tmp_path / "omni.json", take_turns)
    assert found is not None
    assert found.sensors is not None
    assert found.sensors.failed == ()
    assert found.sensors.residual < 1.3
    assert found.sensors.place < 1e-3
