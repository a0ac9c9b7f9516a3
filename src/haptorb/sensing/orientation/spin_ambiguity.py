"""What the field cannot tell: the rotor's spin, but for a multiple of the magnets' period."""

from __future__ import annotations

import numpy as np

from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.numerics.arrays import Array
from haptorb.numerics.rotations import rotation_from_euler

__all__ = ["nearest_branch", "spin_period"]


def spin_period(motor: SphericalMotor) -> float:
    """The smallest turn about the rotor's own z axis that takes the magnets to themselves [rad]; 0 if there is none.

    Orientations that differ by it give the same field everywhere: no sensor can tell them apart.

    >>> import haptorb
    >>> float(np.degrees(spin_period(haptorb.load("pmsm"))).round(9))
    60.0
    """
    axes = motor.magnets.directions
    for fold in range(len(axes), 1, -1):
        turn = rotation_from_euler(0.0, 0.0, 2 * np.pi / fold)
        gaps = np.linalg.norm((axes @ turn.T)[:, None] - axes[None], axis=2)
        onto = gaps.argmin(axis=1)
        if gaps.min(axis=1).max() < 1e-6 and np.abs(motor.polarity[onto] - motor.polarity).max() < 1e-9:
            return float(2 * np.pi / fold)
    return 0.0


def nearest_branch(R_SR: Array, near: Array, period: float) -> Array:
    """R_SR (3, 3) turned about its own z axis by the multiple of `period` [rad] that brings it nearest to `near`.

    >>> third = rotation_from_euler(0, 0, 2 * np.pi / 3)
    >>> bool(np.allclose(nearest_branch(third, np.eye(3), np.pi / 3), np.eye(3)))
    True
    """
    if period == 0.0:
        return R_SR
    relative = R_SR.T @ near
    # the trace of Rz(−a) relative is greatest at this angle
    angle = np.arctan2(relative[1, 0] - relative[0, 1], relative[0, 0] + relative[1, 1])
    return R_SR @ rotation_from_euler(0.0, 0.0, period * np.round(angle / period))
