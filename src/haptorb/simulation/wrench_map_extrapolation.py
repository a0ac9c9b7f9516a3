"""Extrapolation of wrench maps that are too expensive for every step of the simulation.

Between two evaluations they are extrapolated with the mover's change from the last to the newest. The error is then of
second order in that displacement.
"""

from __future__ import annotations

from haptorb.arrays import Array
from haptorb.compiled import kernel

__all__ = ["find_share", "is_elsewhere"]


_MAP_DISTANCE_M = 2e-5  #: the map is computed again when the mover has moved by this [m] …
_MAP_ROTATION = 1e-3  #: … or an entry of its rotation has changed by this
_LEVER_ARM_M = 0.02  #: lever arm that converts rotation to displacement [m]
_MAX_MAP_DISPLACEMENT_M = 4e-3  #: a larger displacement between two maps gives no valid slope [m]
_MIN_CONTINUATION, _MAX_CONTINUATION = -1.0, 4.0  #: extrapolation limits, relative to that displacement


@kernel
def is_elsewhere(pose: Array, R: Array, p: Array) -> bool:
    """Whether a map computed at `pose` (4, 3), R above p, is outdated for the mover at R (3, 3) and p (3,) [m]."""
    square, turn = 0.0, 0.0
    for i in range(3):
        square += (pose[3, i] - p[i]) ** 2
        for j in range(3):
            turn = max(turn, abs(pose[i, j] - R[i, j]))
    return not (square <= _MAP_DISTANCE_M * _MAP_DISTANCE_M and turn <= _MAP_ROTATION)


@kernel
def find_share(pose: Array, change: Array, R: Array, p: Array) -> float:
    """Displacement of the mover, at R (3, 3) and p (3,) [m], from `pose` (4, 3), relative to its `change` (4, 3) before
    that."""
    along, square = 0.0, 0.0
    for j in range(3):
        along += (p[j] - pose[3, j]) * change[3, j]
        square += change[3, j] * change[3, j]
        for i in range(3):
            along += _LEVER_ARM_M * _LEVER_ARM_M * (R[i, j] - pose[i, j]) * change[i, j]
            square += _LEVER_ARM_M * _LEVER_ARM_M * change[i, j] * change[i, j]
    if not (1e-18 < square < _MAX_MAP_DISPLACEMENT_M * _MAX_MAP_DISPLACEMENT_M):
        return 0.0
    return float(min(max(along / square, _MIN_CONTINUATION), _MAX_CONTINUATION))
