"""The tool's field at the sensors against the simulation, and its derivatives against differences."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from haptorb.devices.base import rotation_to_axis
from haptorb.devices.loader import load
from haptorb.estimation.hall_pose_fit import ToolModel, coil_field, tool_field
from haptorb.estimation.sensor_calibration import without_errors
from haptorb.magnetics.magnets import ChargedRing
from haptorb.magnetics.soft_sphere import SoftSphere

OMNI = without_errors(load("omni"))  # sensors with noise and steps only
angle = st.floats(-1.0, 1.0)


def model_field(model, p, R):
    B, J = np.empty((len(model.sensors), 3)), np.empty((len(model.sensors), 3, 5))
    tool_field(model, np.array(p, dtype=float), np.ascontiguousarray(R), B, J)
    return B, J


def truth(device, p, R):
    """Fine charges, and the core's answer to all of them, by the general solver."""
    tool = device.tool
    ring = ChargedRing(tool.outer_radius, tool.inner_radius, tool.length, tool.remanence, radial=6, azimuth=24)
    at = ring.points @ R.T + p
    own = ring.field((device.hall.positions - p) @ R) @ R.T
    sphere = SoftSphere(device.core_radius, device.core_permeability)
    return own + sphere.compute_induced_field(at, ring.charges, device.hall.positions)


@settings(max_examples=25, deadline=None)
@given(angle, angle, st.floats(0.05, 0.07), angle, angle)
def test_eight_charges_are_enough(a, b, distance, c, d):
    """0.3 % where the tool's end is 15 mm from a sensor, a fortieth of the noise elsewhere."""
    u = Rotation.from_rotvec((a, b, 0)).apply((0, 0, 1))
    assume(u[2] >= np.cos(OMNI.workspace_half_angle))  # outside it the magnet can be 3 mm from a sensor
    R = rotation_to_axis(u + 0.4 * np.cross(u, (c, d, 1)))
    B, _ = model_field(ToolModel.of(OMNI), distance * u, R)
    exact = truth(OMNI, distance * u, R)
    assert (np.abs(B - exact) < 5e-7 + 3e-3 * np.linalg.norm(exact, axis=1, keepdims=True)).all()


@pytest.mark.parametrize("permeability", [np.inf, 50.0])
@settings(max_examples=25, deadline=None)
@given(angle, angle, st.floats(0.045, 0.09), angle, angle)
def test_derivatives_are_those_of_the_field(permeability, a, b, distance, c, d):
    model = ToolModel.of(replace(OMNI, core_permeability=permeability))
    p = distance * Rotation.from_rotvec((a, b, 0)).apply((0, 0, 1))
    R = Rotation.from_rotvec((c, d, a)).as_matrix()
    _, J = model_field(model, p, R)
    h = 1e-6
    for column in range(5):
        if column < 3:
            step = h * np.eye(3)[column]
            ahead, behind = model_field(model, p + step, R)[0], model_field(model, p - step, R)[0]
        else:
            turn = Rotation.from_rotvec(h * R[:, column - 3]).as_matrix()
            ahead, behind = model_field(model, p, turn @ R)[0], model_field(model, p, turn.T @ R)[0]
        slope = (ahead - behind) / (2 * h)
        assert np.abs(J[:, :, column] - slope).max() < 1e-5 * np.abs(slope).max() + 1e-9


def test_coils_without_sizes_are_the_calibrated_dipole():
    per_ampere = coil_field(replace(OMNI, windings=None))
    at, m = OMNI.hall.positions, OMNI.moment_per_current[:, 1]
    r = np.linalg.norm(at, axis=1)[:, None]
    u = at / r
    assert np.allclose(per_ampere[:, :, 1], 1e-7 * (3 * (u @ m)[:, None] * u - m) / r**3, rtol=1e-6)
