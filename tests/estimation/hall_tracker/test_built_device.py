"""Hall tracker with coils that deviate from their file, at maximum currents."""

from __future__ import annotations

import importlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from haptorb.cli.calibration_measurement import Pace, hold_tool
from haptorb.devices.base import rotation_to_axis
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.loader import load
from haptorb.estimation.registry import make_estimator
from haptorb.rotations import quaternion
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.simulation.electromagnet import SimulatedElectromagnet

OMNI = load("omni")
assert isinstance(OMNI, SphericalElectromagnet)
TICKS, SETTLED = 900, 300


def follow(believed: SphericalElectromagnet, specimen: int, amperes: float) -> tuple[float, float]:
    """Share of valid ticks, and the median error of the place [m], with `amperes` in all coils, past the guard."""
    hand = OMNI.hand
    firm = replace(
        hand, stiffness=100 * hand.stiffness, damping=30 * hand.damping,
        turn_stiffness=100 * hand.turn_stiffness, turn_damping=30 * hand.turn_damping,
    )  # fmt: skip
    simulated, tracker = (
        SimulatedElectromagnet(replace(OMNI, hand=firm), specimen),
        make_estimator(believed, "hall", None),
    )
    valid, errors = 0, []
    for tick in range(TICKS):
        t = 1e-3 * tick
        axis = np.array([0.5 * np.sin(2 * t), 0.5 * np.cos(3 * t), 1.0])
        axis /= np.linalg.norm(axis)
        p, q = (OMNI.contact_distance + 0.004 + 0.004 * np.sin(5 * t)) * axis, quaternion(rotation_to_axis(axis))
        if not tick:
            simulated.place(p, q)
        share = min(1.0, tick / SETTLED) * amperes * OMNI.coils.resistance / OMNI.supply.voltage
        simulated.advance(1e-3, simulated.quantise(share * [1, -1, 1]), p, q)
        found = tracker.update(simulated.sample(t, t, True))
        if tick >= SETTLED:
            valid += found.valid
            errors.append(np.linalg.norm(found.state.p - simulated.state().p))
    assert np.abs(simulated.currents).min() > 0.9 * amperes  # warm windings carry a little less
    return valid / (TICKS - SETTLED), float(np.median(errors))


@pytest.mark.slow  # a calibration, and a tracker beside currents: each has tests of its own
def test_calibrated_it_holds_the_tool_beside_twenty_amperes_in_all_coils(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parents[3] / "benchmarks")
    benchmark = importlib.import_module("calibrated_budget")
    driver = SimDriver(SimulatedElectromagnet(OMNI, 2), benchmark.READING, seed=2)
    hold_tool(driver, OMNI, "away")
    calibration = benchmark.find_calibration(OMNI, driver, Pace.for_simulation(), "hall")
    assert "run `haptorb calibrate omni`" in make_estimator(OMNI, "hall", None).remark  # which the run prints first
    assert not make_estimator(calibration.apply(OMNI), "hall", None).remark
    share, error = follow(calibration.apply(OMNI), 2, 20.0)
    assert share >= 0.99
    assert error < 1.5e-3
    before, wrong = follow(OMNI, 2, 20.0)
    assert before >= 0.99
    assert wrong > 2 * error
