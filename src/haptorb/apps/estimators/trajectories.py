"""Where estimators are compared: the trajectory of Bai 2012 fig. 4, and the whole workspace; and by which measure."""

from __future__ import annotations

import numpy as np

from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.numerics.arrays import Array
from haptorb.numerics.rotations import rotation_from_euler

__all__ = ["figure_4", "random_workspace", "relative_error"]


def figure_4(count: int = 361) -> Array:
    """(count, 3, 3) one period of ψ = 10° sin t, λ = 5° sin t, φ = 5°.

    >>> figure_4(5).shape
    (5, 3, 3)
    """
    t = np.linspace(0, 2 * np.pi, count)
    return rotation_from_euler(np.radians(10) * np.sin(t), np.radians(5) * np.sin(t), np.radians(5))


def random_workspace(motor: SphericalMotor, count: int, seed: int) -> Array:
    """(count, 3, 3) orientations spread evenly over |ψ|, |λ| ≤ the workspace's tilt and all φ."""
    rng = np.random.default_rng(seed)
    tilt = motor.workspace_tilt
    psi, lam = rng.uniform(-tilt, tilt, (2, count))
    return rotation_from_euler(psi, lam, rng.uniform(-np.pi, np.pi, count))


def relative_error(found: Array, true: Array) -> float:
    """NRMSE: root mean square error of all components over their root mean square.

    >>> relative_error(np.array([1.0, 1.0]), np.array([1.0, 0.0]))
    1.0
    """
    return float(np.sqrt(((found - true) ** 2).mean() / (true**2).mean()))
