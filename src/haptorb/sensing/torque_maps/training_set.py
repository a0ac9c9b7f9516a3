"""The orientations that a motor's estimators learn from: a grid over the workspace, Bai 2012 §2.3."""

from __future__ import annotations

import numpy as np

from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.numerics.rotations import rotation_from_euler
from haptorb.sensing.orientation.spin_ambiguity import spin_period

__all__ = ["GRID", "workspace_grid"]

GRID = (15, 15, 72)  #: of ψ, λ and φ: 16 200 orientations


def workspace_grid(motor: SphericalMotor, counts: tuple[int, int, int] = GRID) -> Array:
    """(n, 3, 3) R_SR over |ψ|, |λ| ≤ the workspace's tilt and one period of spin.

    Spin repeats with the magnets' period (60°): 72 values around the circle are 12 different ones. Here they are spread
    over one period, so that each orientation teaches something.

    Raises InputError for a count below one. Rotations have no unit: [1].

    >>> import haptorb
    >>> workspace_grid(haptorb.load("pmsm")).shape
    (16200, 3, 3)
    """
    if any(count < 1 for count in counts):
        raise InputError(f"a training grid needs at least one value of each angle; got {counts}")
    tilt, period = motor.workspace_tilt, spin_period(motor) or 2 * np.pi
    psi, lam = (np.linspace(-tilt, tilt, count) if count > 1 else np.zeros(1) for count in counts[:2])
    phi = period * np.arange(counts[2]) / counts[2]
    angles = np.meshgrid(psi, lam, phi, indexing="ij")
    return rotation_from_euler(*(angle.ravel() for angle in angles))
