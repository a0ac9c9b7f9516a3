"""The guided motion: the hand's motion while the pointer is not held, so that a first look shows something.

Twelve seconds over the dome and four of leaning on it near the summit; then the hand goes to the dome's edge and rests
there, touching, where next to no force is asked of it: left alone, the coils never grow too warm. A pure function of
time: two runs see the same hand.
"""

from __future__ import annotations

import math

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel

__all__ = ["DURATION", "position_on_path", "upright_quaternion"]

DURATION = 20.0  #: after this the hand rests [s]

_HIGH = 0.062  #: distance of the tool's magnet from the device's centre before touching down [m]
_PRESSED = 0.048  #: while pressing [m]: 2 mm below contact, so that a soft hand leans on the dome
_TOUCHING = 0.0505  #: at rest [m]
_STILL = 12.0  #: from here the hand leans on the dome without moving along it [s]
_LEAVE = 16.0  #: from here it goes to the edge [s]
_LANDING = math.radians(30.0)  #: tilt at touch-down [rad]
_CIRCLE = math.radians(18.0)  #: tilt of the circle around the summit [rad]
_LEAN = math.radians(10.0)  #: tilt of leaning near the summit, on the far side [rad]
_EDGE = math.radians(58.0)  #: tilt at rest, on the near side [rad]
_BEARING = math.radians(-60.0)  #: meridian of the slide [rad]
_TURN = 2 * math.pi  #: once around


@kernel
def _smooth(t: float, start: float, end: float) -> float:
    """0 before `start`, 1 after `end`, between them the path of least jerk (Flash and Hogan 1985): a hand's."""
    s = min(max((t - start) / (end - start), 0.0), 1.0)
    return s * s * s * (10.0 + s * (6.0 * s - 15.0))


@kernel
def _position(t: float, p: Array) -> None:
    # A signed tilt along one meridian passes the summit without a turn of the hand.
    tilt = (
        _LANDING
        - (_LANDING + _CIRCLE) * _smooth(t, 1.5, 5.0)  # over the summit to the far side
        + (_CIRCLE - _LEAN) * _smooth(t, 10.5, _STILL)
        + (_LEAN + _EDGE) * _smooth(t, _LEAVE, DURATION)
    )
    bearing = _BEARING + _TURN * _smooth(t, 5.0, 10.5)
    d = _HIGH + (_PRESSED - _HIGH) * _smooth(t, 0.0, 1.5) + (_TOUCHING - _PRESSED) * _smooth(t, _LEAVE, DURATION)
    s = d * math.sin(tilt)
    p[0], p[1], p[2] = s * math.cos(bearing), s * math.sin(bearing), d * math.cos(tilt)


def _turn_upright(p: Array, q: Array) -> None:
    x, y, z = p[0], p[1], p[2]
    length = math.sqrt(x * x + y * y + z * z)
    if length < 1e-12 or z <= -length * (1 - 1e-12):  # no direction, or no shortest way to it
        q[0], q[1], q[2], q[3] = 1.0, 0.0, 0.0, 0.0
        return
    w = length + z
    n = math.sqrt(x * x + y * y + w * w)
    q[0], q[1], q[2], q[3] = -y / n, x / n, 0.0, w / n


def position_on_path(t: float) -> Array:
    """(3,) [m] where the hand wants the tool's magnet at time `t` [s], frame S; the summit is +z.

    >>> round(1e3 * float(np.linalg.norm(position_on_path(20.0))), 3)
    50.5
    """
    p = np.empty(3)
    _position(float(t), p)
    return p


def upright_quaternion(p: Array) -> Array:
    """(4,) the quaternion (x, y, z, w) that turns the tool's z axis to the direction of `p` (3,) by the shortest way.

    >>> upright_quaternion(np.array([0.0, -0.05, 0.0])).round(3).tolist()
    [0.707, 0.0, 0.0, 0.707]
    """
    q = np.empty(4)
    # Not the compiled one: a host says it while its heart beats, and compiling holds up all of its threads for seconds.
    _turn_upright(p, q)
    return q
