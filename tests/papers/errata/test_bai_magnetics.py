"""Bai 2012, magnetics: the published multipole models in numbers, and a fit with as many dipoles.

Errors of the torque characteristic are over the workspace, against exact bodies: `scale` is the factor that matches
best, less one; `shape` is what is left after it.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haptorb.devices import tables
from haptorb.devices.base import rotation_to_axis
from haptorb.devices.tables import torque_table
from haptorb.magnetics.multipole import MultipoleSource, load_published
from haptorb.magnetics.multipole_fit import MultipoleFit, fit_multipole, shell_region

R_PM, R_EM = 67.9e-3, 56.8e-3
UP_PM, UP_EM = np.array([0, 0, R_PM]), np.array([0, 0, R_EM])
PM, EM = load_published("bai2012-pm"), load_published("bai2012-em")
#: where the coils are, as one magnet sees them, and where the magnets are, as one coil sees them
BY_MAGNET = shell_region(R_PM, 53.0e-3, 60.61e-3, 1.2)
BY_COIL = shell_region(R_EM, 65.36e-3, 70.44e-3, 1.2)


def axes(latitude: float, longitudes: np.ndarray) -> np.ndarray:
    lat, lon = np.deg2rad(latitude), np.deg2rad(longitudes)
    return np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.full_like(lon, np.sin(lat))], axis=1)


MAGNETS = np.concatenate([axes(-15, 30.0 * np.arange(12)), axes(15, 30.0 * np.arange(12))])
POLARITY = np.concatenate([(-1.0) ** np.arange(12), -((-1.0) ** np.arange(12))])
COILS = np.concatenate(
    [axes(-26, 45.0 * np.arange(8) + 22.5), axes(26, 45.0 * np.arange(8) + 22.5), axes(0, 45.0 * np.arange(8))]
)


def workspace(count: int) -> np.ndarray:
    rng = np.random.default_rng(12)
    tilt, spin = rng.uniform(-22.5, 22.5, (count, 2)), rng.uniform(0, 360, (count, 1))
    return Rotation.from_euler("XYZ", np.hstack([tilt, spin]), degrees=True).as_matrix()


WORKSPACE = workspace(25)


def model_torque(magnet: MultipoleSource, coil: MultipoleSource) -> np.ndarray:
    """(n, 3, 24) torque on the rotor per ampere by pole pairs: F = Σ q B at every pole, torque about the centre."""
    frames = np.array([rotation_to_axis(u) for u in MAGNETS])
    poles = (np.einsum("iab,pb->ipa", frames, magnet.poles) + R_PM * MAGNETS[:, None]).reshape(-1, 3)
    charges = np.outer(POLARITY, magnet.strengths).ravel()
    out = np.empty((len(WORKSPACE), 3, len(COILS)))
    for n, R in enumerate(WORKSPACE):
        at = poles @ R.T
        for j, c in enumerate(COILS):
            frame = rotation_to_axis(c)
            field = coil.field((at - R_EM * c) @ frame) @ frame.T
            out[n, :, j] = np.cross(at, charges[:, None] * field).sum(axis=0)
    return out


def exact(body) -> np.ndarray:
    table = torque_table(PM.body, R_PM, body, R_EM, precision=1e-6)
    out = np.empty((len(WORKSPACE), 3, len(COILS)))
    tables.torque_characteristic(table.cells, table.scale, MAGNETS, POLARITY, COILS, WORKSPACE, out)
    return out


def scale_and_shape(model: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    scale = float((model * true).sum() / (true * true).sum())
    return scale - 1, float(np.linalg.norm(model - scale * true) / np.linalg.norm(scale * true))


@pytest.fixture(scope="module")
def true() -> np.ndarray:
    return exact(EM.body)


def test_e28_the_loops_of_equation_7_divide_the_radius_evenly(numbers):
    assert numbers("bai2012", "equations 7 to 9", "dmp-7-pm", "dmp-7-em") == pytest.approx([12.7, 13.611], abs=1e-3)
    for model, radius, loops in ((PM.model, 15.875e-3, 4), (EM.model, 15.88e-3, 6)):
        found = np.unique(np.hypot(model.poles[:, 0], model.poles[:, 1]).round(9))
        assert found == pytest.approx(np.arange(loops + 1) * radius / (loops + 1), abs=1e-8)


def test_moments_in_the_readings_of_table_1(numbers):
    """E1: the magnet's poles and its polarization agree for l̄/l = 0.2, not for the printed 0.3."""
    ids = "t1-pm-per-metre", "t1-pm-ratio", "t1-pm-printed", "t1-em-moment", "t1-em-aspect"
    assert numbers("bai2012", "table 1", *ids) == pytest.approx([825.35, 0.1996, 1.503, 0.36707, 1.371], abs=2e-3)


def test_published_model_against_exact_bodies_over_the_workspace(true):
    model = model_torque(PM.model, EM.model)
    scale, shape = scale_and_shape(model, true)
    assert scale == pytest.approx(0.045, abs=0.004)
    assert shape == pytest.approx(0.025, abs=0.004)
    rms_of_peak = np.sqrt(np.mean((model - (1 + scale) * true) ** 2)) / np.abs((1 + scale) * true).max()
    assert rms_of_peak < 0.012


@pytest.mark.slow
def test_other_readings_are_far_off(true):
    """E1: the coil's length as l/2a = 0.3, or the magnet's l̄/l as printed."""
    aspect = load_published("bai2012-em-aspect")
    assert scale_and_shape(model_torque(PM.model, aspect.model), exact(aspect.body))[0] == pytest.approx(0.29, abs=0.02)
    assert scale_and_shape(model_torque(load_published("bai2012-pm-printed").model, EM.model), true)[0] > 0.5


def test_field_of_the_published_models_in_the_gap(numbers):
    assert numbers("bai2012", "table 1", "t1-pm-gap", "t1-em-gap") == pytest.approx([0.098, 0.095], abs=0.005)


@pytest.fixture(scope="module")
def fits() -> tuple[MultipoleFit, MultipoleFit]:
    """As many dipoles as published, in the published arrangement for the magnet and in the best for the coil."""
    magnet = fit_multipole(PM.body, BY_MAGNET, loops=4, per_loop=10)
    return magnet, fit_multipole(EM.body, BY_COIL, loops=4, per_loop=24)


def test_fitted_models_with_no_more_dipoles_are_within_half_a_percent(true, fits):
    magnet, coil = fits
    assert magnet.model.dipoles <= PM.model.dipoles
    assert coil.model.dipoles <= EM.model.dipoles
    assert magnet.rms < 0.015
    assert coil.rms < 0.002
    found = model_torque(magnet.model, coil.model)
    assert np.linalg.norm(found - true) / np.linalg.norm(true) < 0.005
