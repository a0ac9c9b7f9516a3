"""A calibrated device with tolerances renders the commanded wrench (benchmarks/built_devices.py)."""

from __future__ import annotations

import importlib
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.optimize import least_squares

from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.field_sensors import SensorErrors
from haptorb.devices.loader import load
from haptorb.estimation.coil_calibration import MagneticCalibration, excitation, magnetic_calibration
from haptorb.magnetics import dipole
from haptorb.simulation.electromagnet_specimen import ElectromagnetSpecimen, compute_fields, draw_electromagnet
from oracles.repetitions import repetitions

OMNI = load("omni")
assert isinstance(OMNI, SphericalElectromagnet)


@pytest.fixture
def benchmark_of_built_devices(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(Path(__file__).parents[3] / "benchmarks")
    return importlib.import_module("built_devices")


def test_the_force_is_within_two_per_cent_for_half_of_them_and_five_for_nearly_all(benchmark_of_built_devices):
    found = benchmark_of_built_devices.measure(OMNI, repetitions(10, 50), 4000, 0.15, "tracker")
    before, after = found["before_percent"], found["after_percent"]
    assert after["median"] <= 2.0
    assert after["95"] <= 5.0
    assert after["median"] < 0.8 * before["median"]
    assert after["95"] < 0.8 * before["95"]


def read(built: ElectromagnetSpecimen, errors: SensorErrors) -> MagneticCalibration:
    """The calibration of a device whose sensors are as good as the errors say, and whose field is that of `built`."""
    device = replace(OMNI, hall=replace(OMNI.hall, errors=errors))
    currents = excitation(device, levels=1, repeats=1)
    fields = compute_fields(built.compute_map(OMNI.dome_radius), OMNI.hall.positions)
    return magnetic_calibration(device, currents, currents, np.einsum("sim,nm->nsi", fields, currents))


def find_centre(built: ElectromagnetSpecimen, coil: int) -> np.ndarray:
    """(3,) [m] where the dipole is that has the coil's field far away."""
    rng = np.random.default_rng(1)
    far = rng.standard_normal((40, 3))
    far *= 0.3 / np.linalg.norm(far, axis=1, keepdims=True)
    far = np.concatenate([far, -far])  # the third harmonic is no shift then
    field = compute_fields(built.compute_map(OMNI.dome_radius), far)[:, :, coil]

    def rest(x: np.ndarray) -> np.ndarray:
        return 1e9 * (dipole.field(np.broadcast_to(x[:3], far.shape), far - 1e-3 * x[3:]) - field).ravel()

    found: np.ndarray = 1e-3 * least_squares(rest, np.append(built.compute_moments()[:, coil], np.zeros(3))).x[3:]
    return found


@pytest.mark.parametrize("specimen", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 2))])
def test_sensors_without_errors_find_from_where_each_coils_field_comes(specimen: int):
    """As seen from far away: what the core answers to a winding that is off its middle moves it, too, most along the
    innermost coil's axis."""
    built = draw_electromagnet(replace(OMNI, tolerance=OMNI.tolerance.model_copy(update={"winding": 0.0})), specimen)
    found = read(built, SensorErrors()).centres
    true = np.stack([find_centre(built, coil) for coil in range(3)])
    assert np.abs(true).max() > 0.05e-3
    assert np.abs(found - true).max() < 0.03e-3


def test_sensors_with_errors_find_less_and_say_so():
    errors, away = OMNI.hall.errors, []
    for specimen in range(repetitions(5, 300)):
        built = draw_electromagnet(OMNI, specimen)
        rng = np.random.default_rng(specimen)
        moved = OMNI.hall.positions + errors.placement * rng.standard_normal((9, 3))
        mixing = np.eye(3) + rng.standard_normal((9, 3, 3)) * np.where(np.eye(3, dtype=bool), errors.gain, errors.cross)
        turns = errors.angle * rng.standard_normal((9, 3))
        fields = compute_fields(built.compute_map(OMNI.dome_radius), moved)
        fields = fields + np.cross(turns[:, None], fields, axisb=1, axisa=2).transpose(0, 2, 1)
        fields = np.einsum("sij,sjm->sim", mixing, fields)
        currents = excitation(OMNI, levels=1, repeats=1)
        found = magnetic_calibration(OMNI, currents, currents, np.einsum("sim,nm->nsi", fields, currents))
        true = np.stack([find_centre(built, coil) for coil in range(3)])
        away.append((found.centres - true) / found.centre_uncertainty)
    assert np.sqrt(np.mean(np.square(away))) == pytest.approx(1.0, abs=0.2)


def test_a_file_without_tolerances_has_its_coils_in_the_centre():
    exact = replace(OMNI, tolerance=None)
    currents = excitation(exact, levels=1, repeats=1)
    fields = np.einsum("sim,nm->nsi", exact.coil_fields(OMNI.hall.positions), currents)
    found = magnetic_calibration(exact, currents, currents, fields)
    assert found.centres is None
    assert np.allclose(found.moment_per_current, OMNI.moment_per_current, rtol=1e-6)
