"""The virtual coupling: a spring and a damper between mover and a body of a scene, both limited.

After Colgate, Stanley and Brown 1995 and Adams and Hannaford 1999: the hand feels the coupling, never the scene
itself, so a loop that is stable with the coupling against a wall is stable with any passive scene.
"""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Array, Records, fields
from haptorb.numerics.compiled import kernel

__all__ = ["COUPLING", "fill_coupling"]

#: What the kernel goes by.
COUPLING = fields(
    ("stiffness", "f8"), ("damping", "f8"), ("greatest", "f8"),  # [N/m], [N·s/m], [N]
    ("turn_stiffness", "f8"), ("turn_damping", "f8"), ("turn_greatest", "f8"),  # [N·m/rad], [N·m·s/rad], [N·m]
)  # fmt: skip


@kernel
def _limit(spring: Array, stretch: Array, speed: Array, stiffness: float, damping: float, greatest: float) -> float:
    """spring (3,) becomes the spring's and damper's push along `stretch`, each at most `greatest`; the energy [J]."""
    length, fast = 0.0, 0.0
    for i in range(3):
        length += stretch[i] * stretch[i]
        fast += speed[i] * speed[i]
    length, fast = np.sqrt(length), damping * np.sqrt(fast)
    pull = stiffness * length
    share = 1.0 if pull <= greatest else greatest / pull
    drag = 1.0 if fast <= greatest else greatest / fast
    for i in range(3):
        spring[i] = share * stiffness * stretch[i] + drag * damping * speed[i]
    if share == 1.0:
        return float(0.5 * pull * length)
    most = greatest / stiffness
    return float(0.5 * greatest * most + greatest * (length - most))


@kernel
def _turn_between(R: Array, x: Array, turn: Array) -> None:
    """turn (3,) becomes the rotation vector [rad] from the attitude `x` (9,), by rows, to R (3, 3)."""
    D = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            D[i, j] = R[i, 0] * x[3 * j] + R[i, 1] * x[3 * j + 1] + R[i, 2] * x[3 * j + 2]
    turn[0], turn[1], turn[2] = D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]
    sine = 0.5 * np.sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    angle = np.arctan2(sine, 0.5 * (D[0, 0] + D[1, 1] + D[2, 2] - 1.0))
    factor = 0.5 * angle / sine if sine > 1e-9 else 0.5
    for i in range(3):
        turn[i] *= factor


@kernel
def fill_coupling(
    couplings: Records, pose: Array, R: Array, motion: Array, place: Array, attitude: Array, moving: Array,
    share: float, wrench: Array,
) -> float:  # fmt: skip
    """Fill wrench (6,) with the force [N] and torque about the body's origin [N·m] on the body; return the energy [J].

    couplings (1,) COUPLING. Target of the body: pose (3,) [m], R (3, 3), motion (6,) linear and angular. Actual
    pose: place (3,), attitude (9,) by rows, moving (6,) angular and linear as MuJoCo has it, in time that passes
    `share` times as fast.
    """
    c = couplings[0]
    stretch, speed = np.empty(3), np.empty(3)
    for i in range(3):
        stretch[i] = pose[i] - place[i]
        speed[i] = motion[i] - share * moving[3 + i]
    energy = _limit(wrench[:3], stretch, speed, c.stiffness, c.damping, c.greatest)
    if c.turn_stiffness == 0.0:
        wrench[3:] = 0.0
        return energy
    _turn_between(R, attitude, stretch)
    for i in range(3):
        speed[i] = motion[3 + i] - share * moving[i]
    return energy + _limit(wrench[3:], stretch, speed, c.turn_stiffness, c.turn_damping, c.turn_greatest)
