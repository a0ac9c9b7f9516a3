"""Whole loop on the field sensors alone: renders without a tracker, and not with a reversed magnet."""

from dataclasses import replace

import numpy as np
import pytest

from haptorb.cli.calibration_measurement import calibrate, make_driver
from haptorb.control.protection import Protection
from haptorb.control.registry import make_allocator
from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.devices.loader import load
from haptorb.errors import CalibrationError, InputError, UnknownName
from haptorb.estimation.hall_tracker import HallTracker
from haptorb.estimation.registry import check_estimator, make_estimator
from haptorb.estimation.sensor_calibration import without_errors
from haptorb.runtime.assembly import assemble
from haptorb.runtime.config import RunConfig
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.servo import Servo
from haptorb.runtime.tick import Tick
from haptorb.worlds import find_world

OMNI = without_errors(load("omni"))  # sensors with noise and steps only


def run(tick, seconds):
    """Rows of `seconds` at 1 kHz, in the simulation's own time, and the tool's true places."""
    rows, places = [], []
    with tick.driver:
        for n in range(round(1e3 * seconds)):
            row = tick.layout.empty()
            tick.step(row, n * 1e-3)
            rows.append(row)
            places.append(tick.driver.simulation.state().p)
    return np.array(rows), np.array(places)


def test_the_dome_is_rendered_from_the_field():
    tick = assemble(
        RunConfig(device=OMNI, world=find_world("dome")(), seed=3, model="exact", estimator="hall"), PointerTracker()
    )
    assert isinstance(tick.estimator, HallTracker)
    rows, places = run(tick, 2.5)
    at = tick.layout
    valid = rows[:, at["valid"].start] == 1.0
    assert valid[5:].all()
    assert tick.error == ""
    assert not rows[:, at["trip"].start].any()
    away = np.linalg.norm(rows[:, at["p"]] - places, axis=1)[100:]
    assert np.sqrt((away**2).mean()) < 1e-3  # the sensors' assumed places, coils driven
    asked, given = rows[200:, at["wrench_commanded"]][:, :3], rows[200:, at["wrench_actual"]][:, :3]
    assert np.abs(asked).max() > 0.1
    assert np.sqrt(((asked - given) ** 2).sum(axis=1).mean()) < 0.1 * np.linalg.norm(asked, axis=1).max()


def test_a_reversed_magnet_is_never_pushed():
    """With it every force would be the opposite of what is asked: the coils must stay off."""
    wrong = replace(OMNI, tool=replace(OMNI.tool, remanence=-OMNI.tool.remanence))
    driver = SimDriver.of(wrong, 1e-3, PointerTracker().goal, 0)
    tick = Tick(OMNI, find_world("dome")(), driver, HallTracker(OMNI, "exact"), make_allocator(OMNI), 1e-3)
    rows, _ = run(tick, 0.6)
    assert not rows[:, tick.layout["valid"].start].any()
    assert not rows[:, tick.layout["duty_applied"]].any()
    assert tick.estimator.verdict == HallTracker.REVERSED
    assert rows[-1, tick.layout["guard"].start] == GuardState.TRIPPED
    assert rows[-1, tick.layout["trip"].start] == Trip.MAGNET_REVERSED  # the console shows its sentence


def test_who_has_no_such_tracker_is_told():
    with pytest.raises(UnknownName, match="estimator of device 'pmsm'"):
        Servo("pmsm", tracker="hall")
    with pytest.raises(UnknownName, match="tracker"):
        Servo("omni", tracker="hal")
    assert check_estimator(OMNI, None) == "tracker"
    assert Servo("omni", tracker="hall").estimator == "hall"


def test_a_calibration_is_believed_by_the_controller_only(tmp_path):
    truth = replace(OMNI, moment_per_current=1.04 * OMNI.moment_per_current)
    driver, pace = make_driver("sim", truth)
    found = calibrate(OMNI, driver, pace=pace)
    tick = assemble(
        RunConfig(device=OMNI, world=find_world("dome")(), model="exact", estimator="hall", calibration=found),
        PointerTracker(),
    )
    assert np.array_equal(tick._device.moment_per_current, found.moment_per_current)
    assert np.array_equal(tick.driver.simulation.device.moment_per_current, OMNI.moment_per_current)
    assert isinstance(tick.protection, Protection)
    path = tmp_path / "omni.json"
    path.write_text(found.text())
    assert Servo("omni", calibration=path).config.calibration.text() == found.text()
    path.write_text(replace(found, digest="f" * 64).text())
    with pytest.raises(CalibrationError, match="calibrate again"):
        Servo("omni", calibration=path)
    with pytest.raises(CalibrationError, match="cannot be read"):
        Servo("omni", calibration=tmp_path / "none.json")
    with pytest.raises(InputError, match="spherical motor; a calibration works for spherical electromagnets"):
        Servo("pmsm", calibration=found)


def test_offsets_go_to_the_tracker():
    earth = np.tile([2e-5, 0.0, 0.0], (9, 1))
    assert np.array_equal(make_estimator(OMNI, "hall", None, earth)._sensors["offset"], earth)
