"""How a motor's rotor hangs: its joint from device and hand, the energy in it, and the edge of its workspace."""

from __future__ import annotations

from math import cos

import numpy as np
from numpy.polynomial import chebyshev

from haptorb.devices.motor.handle import Grasp
from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.numerics.arrays import Array, Records
from haptorb.simulation.motor.rotor import ROTOR
from haptorb.simulation.parts.tool import matrix

__all__ = ["limit_tilt", "make_rotor_record", "potential_energy"]


def make_rotor_record(device: SphericalMotor, grasp: Grasp) -> Records:
    """(1,) ROTOR of `device` with the hand `grasp` on its handle: upright and at rest."""
    rotor, made = device.rotor, np.zeros(1, dtype=ROTOR)
    arm = rotor.handle_length
    hand = np.array([grasp.mass * arm**2, grasp.mass * arm**2, 0.5 * grasp.mass * grasp.radius**2])
    made["inertia"] = np.array(rotor.inertia, dtype=np.float64) + hand
    made["damping"] = float(rotor.viscous_friction) + grasp.damping * arm**2
    made["friction"], made["grip"] = rotor.dry_friction, grasp.stiffness * arm**2
    made["least"], made["edge"] = device.tilt_torque[1], cos(device.workspace_tilt)
    made["stop"], made["stop_damping"] = device.end_stop.stiffness, device.end_stop.damping
    made["q"] = made["goal"] = (0.0, 0.0, 0.0, 1.0)
    return made


def potential_energy(coefficients: Array, least: float, cosine: float) -> float:
    """Potential of weight and regulator [J]: dU/d(cos) = −(torque over sin), which the coefficients (n,) give."""

    def integral(c: float) -> float:
        x = (2 * c - (1 + least)) / (1 - least)
        return 0.5 * (1 - least) * float(chebyshev.chebval(x, chebyshev.chebint(coefficients)))

    beyond = max(least - cosine, 0.0) * float(chebyshev.chebval(-1.0, coefficients))
    return integral(1.0) - integral(max(cosine, least)) + beyond


def limit_tilt(q: Array, tilt: float) -> Array:
    """`q`, its tilt reduced to `tilt` about the same axis if it leans further; the spin stays.

    Quaternions (4,), `tilt` in [rad].
    """
    R = np.empty((3, 3))
    matrix(q, R)
    nx, ny, nz = R[:, 2].tolist()
    lean = np.arctan2((nx * nx + ny * ny) ** 0.5, nz)
    if lean <= tilt:
        return q
    half = 0.5 * (lean - tilt)
    size = (nx * nx + ny * ny) ** 0.5
    ux, uy = (ny / size, -nx / size) if size > 1e-12 else (1.0, 0.0)
    x, y, z, w = q.tolist()
    a, b, d = np.sin(half) * ux, np.sin(half) * uy, np.cos(half)
    return np.array([d * x + w * a + b * z, d * y + w * b - a * z, d * z + a * y - b * x, d * w - a * x - b * y])
