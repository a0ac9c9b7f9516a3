"""The virtual coupling: a spring and a damper between mover and a body of a scene, both limited.

After Colgate, Stanley and Brown 1995 and Adams and Hannaford 1999: the hand feels the coupling, never the scene
itself, so a loop that is stable with the coupling against a wall is stable with any passive scene.

In a scene whose time passes s times as fast, bodies feel 1/s² times as heavy. With the same coupling the damping
ratio of the body in it would fall to s times its value, and the body would oscillate. So the damper grows to 1/s of
itself, up to `slow_damping`; beyond that the spring becomes softer, by (s d/b)², where d is the damper instead of b.
The damping ratio is always that of full speed, and the coupling is never stiffer.
"""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Array, Records, fields
from haptorb.numerics.compiled import kernel

__all__ = ["COUPLING", "SCENE_TIME", "fill_coupling", "fit_to_pace"]

#: What the kernel goes by.
COUPLING = fields(
    ("stiffness", "f8"), ("damping", "f8"), ("greatest", "f8"),  # [N/m], [N·s/m], [N]
    ("turn_stiffness", "f8"), ("turn_damping", "f8"), ("turn_greatest", "f8"),  # [N·m/rad], [N·m·s/rad], [N·m]
    ("slow_damping", "f8"), ("slow_turn_damping", "f8"),  # at a slower pace [N·s/m], [N·m·s/rad]
)  # fmt: skip

#: Time of a scene in a tick.
SCENE_TIME = fields(
    ("pace", "f8"),  # how fast it passes, 0 to 1
    ("flow", "f8"),  # the same in this tick alone: 0 while it waits for a step
    ("ahead", "f8"),  # time that has passed since the body's last pose [s]
)


@kernel
def fit_to_pace(stiffness: float, damping: float, most: float, pace: float) -> tuple[float, float]:
    """Stiffness and damping while the scene's time passes `pace` times as fast, 0 to 1, with a damper of at most
    `most`; the body keeps its damping ratio.

    >>> fit_to_pace(100.0, 2.0, 8.0, 0.25), fit_to_pace(100.0, 2.0, 4.0, 0.25), fit_to_pace(100.0, 2.0, 0.0, 0.25)
    ((100.0, 8.0), (25.0, 4.0), (6.25, 2.0))
    """
    if pace >= 1.0:
        return stiffness, damping
    damper = max(min(damping / pace, most), damping)
    share = pace * damper / damping if damping > 0.0 else pace
    return share * share * stiffness, damper


@kernel
def _limit(
    spring: Array, stretch: Array, speed: Array, stiffness: float, damping: float, greatest: float
) -> tuple[float, float]:
    """Fill spring (3,) with the force of spring and damper, each at most `greatest`; return the spring's energy [J] and
    the damper's power [W]."""
    length, fast = 0.0, 0.0
    for i in range(3):
        length += stretch[i] * stretch[i]
        fast += speed[i] * speed[i]
    length, fast = np.sqrt(length), np.sqrt(fast)
    pull = stiffness * length
    share = 1.0 if pull <= greatest else greatest / pull
    drag = 1.0 if damping * fast <= greatest else greatest / (damping * fast)
    for i in range(3):
        spring[i] = share * stiffness * stretch[i] + drag * damping * speed[i]
    power = drag * damping * fast * fast
    if share == 1.0:
        return 0.5 * pull * length, power
    most = greatest / stiffness
    return 0.5 * greatest * most + greatest * (length - most), power


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
    time: Records, wrench: Array,
) -> tuple[float, float]:  # fmt: skip
    """Fill wrench (6,) with the force [N] and torque about the body's origin [N·m] on the body; return the energy of
    the springs [J] and the power that the dampers take [W].

    couplings (1,) COUPLING. Target of the body: pose (3,) [m], R (3, 3), motion (6,) linear and angular. Last
    pose: place (3,), attitude (9,) by rows, moving (6,) angular and linear as MuJoCo has it. `time` (1,) is a
    SCENE_TIME.
    """
    c, t = couplings[0], time[0]
    stretch, speed = np.empty(3), np.empty(3)
    for i in range(3):
        stretch[i] = pose[i] - place[i] - t.ahead * moving[3 + i]
        speed[i] = motion[i] - t.flow * moving[3 + i]
    stiffness, damping = fit_to_pace(c.stiffness, c.damping, c.slow_damping, t.pace)
    energy, power = _limit(wrench[:3], stretch, speed, stiffness, damping, c.greatest)
    if c.turn_stiffness == 0.0:
        wrench[3:] = 0.0
        return energy, power
    _turn_between(R, attitude, stretch)
    for i in range(3):
        stretch[i] -= t.ahead * moving[i]
        speed[i] = motion[3 + i] - t.flow * moving[i]
    stiffness, damping = fit_to_pace(c.turn_stiffness, c.turn_damping, c.slow_turn_damping, t.pace)
    more = _limit(wrench[3:], stretch, speed, stiffness, damping, c.turn_greatest)
    return energy + more[0], power + more[1]
