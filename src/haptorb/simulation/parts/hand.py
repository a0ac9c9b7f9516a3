"""A hand on the tool: springs and dampers towards where it wants the tool, in place and in turn.

The hand moves with the tool (its mass is added) and carries the tool's weight, as people do without thinking: what is
seen of its yielding is the device's doing. The dampers act against the stator. Grips from the literature run from 0.1
kg, 2 N·s/m, 100 N/m (a pen, lightly) to 0.8 kg, 10 N·s/m, 500 N/m.
"""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Array, fields
from haptorb.numerics.compiled import kernel

__all__ = ["GRIP", "fill_remaining_rotation"]

#: How firmly the tool is held; zeros: no hand at all.
GRIP = fields(
    ("stiffness", "f8"),  # [N/m]
    ("damping", "f8"),  # [N·s/m]
    ("turn_stiffness", "f8"),  # [N·m/rad]
    ("turn_damping", "f8"),  # [N·m·s/rad]
)


@kernel
def fill_remaining_rotation(q: Array, goal: Array, out: Array) -> None:
    """out (3,) [rad], stator frame: the shortest turn from the unit quaternion q to `goal` (both (x, y, z, w))."""
    x = -goal[3] * q[0] + goal[0] * q[3] - goal[1] * q[2] + goal[2] * q[1]
    y = -goal[3] * q[1] + goal[1] * q[3] - goal[2] * q[0] + goal[0] * q[2]
    z = -goal[3] * q[2] + goal[2] * q[3] - goal[0] * q[1] + goal[1] * q[0]
    w = goal[3] * q[3] + goal[0] * q[0] + goal[1] * q[1] + goal[2] * q[2]
    if w < 0.0:
        x, y, z, w = -x, -y, -z, -w
    s = np.sqrt(x * x + y * y + z * z)
    scale = 2.0 * np.arctan2(s, w) / s if s > 1e-12 else 2.0
    out[0], out[1], out[2] = scale * x, scale * y, scale * z
