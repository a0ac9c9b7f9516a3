"""Path guidance without memory: the tool is attracted to a curve and free along it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from haptorb.arrays import Array, check_finite
from haptorb.compiled import kernel
from haptorb.devices.base import State
from haptorb.errors import InputError
from haptorb.worlds.base import World, parameter

__all__ = ["Guidance", "loop_path"]


@kernel
def _nearest(p: Array, path: Array, out: Array) -> None:
    """out (3,): vector from the polyline's nearest point to p."""
    best = np.inf
    for n in range(path.shape[0] - 1):
        along, square = 0.0, 0.0
        for i in range(3):
            step = path[n + 1, i] - path[n, i]
            along += (p[i] - path[n, i]) * step
            square += step * step
        s = 0.0 if square == 0.0 else min(max(along / square, 0.0), 1.0)
        distance = 0.0
        for i in range(3):
            distance += (p[i] - path[n, i] - s * (path[n + 1, i] - path[n, i])) ** 2
        if distance < best:
            best = distance
            for i in range(3):
                out[i] = p[i] - path[n, i] - s * (path[n + 1, i] - path[n, i])


def loop_path(tilt_deg: float = 30.0, wave_deg: float = 10.0, waves: int = 3, radius: float = 0.05) -> Array:
    """(n, 3) [m] closed wavy path around the summit, on the sphere of `radius` of a touching tool's magnet."""
    turn = np.linspace(0, 2 * np.pi, 241)
    tilt = np.radians(tilt_deg + wave_deg * np.cos(waves * turn))
    return radius * np.column_stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])


_MAX_POINTS = 10_000  #: of a path: every tick visits them all


@dataclass(frozen=True)
class Guidance(World):
    """Attraction to the nearest point of a path (n, 3) [m], free along it: the gradient of a valley around the path.

    U = F s (√(1 + r²/s²) − 1): a spring of stiffness F/s near the path that never exceeds F. Where two sections of
    the path are equally near, the force jumps.

    Parameters
    ----------
    path : array_like, shape (n, 3)
        Points of the path in the stator frame [m], 2 to 10,000, joined by straight lines; a closed path ends at its
        first point. Empty: a closed wavy path around the summit, 50 mm from the centre.
    """

    asks = "force"
    continuous: ClassVar[bool] = False

    strength: float = parameter(0.35, "N", 0, 1, "F: maximum pull")
    width: float = parameter(0.003, "m", 0.0005, 0.03, "s: distance over which the pull increases")
    path: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        World.__post_init__(self)
        given = check_finite(self.path, "Guidance.path")
        path = given if given.size else loop_path()
        if path.ndim != 2 or path.shape[1] != 3 or not 2 <= len(path) <= _MAX_POINTS:
            raise InputError(f"Guidance.path must be 2 to {_MAX_POINTS} points, shape (n, 3); got shape {path.shape}")
        if not isinstance(self.path, tuple):  # worlds are compared, and neither arrays nor lists have a hash
            object.__setattr__(self, "path", tuple(map(tuple, given.tolist())))
        object.__setattr__(self, "_path", np.ascontiguousarray(path))

    @property
    def bound(self) -> float:
        """[N]"""
        return self.strength

    def wrench(self, state: State) -> Array:
        """(6,) attraction to the path [N]."""
        away = np.empty(3)
        _nearest(state.p, self._path, away)  # type: ignore[attr-defined]
        x, y, z = away.tolist()
        pull = -self.strength / (self.width**2 + x * x + y * y + z * z) ** 0.5
        wrench = np.zeros(6)
        wrench[0], wrench[1], wrench[2] = pull * x, pull * y, pull * z
        return wrench
