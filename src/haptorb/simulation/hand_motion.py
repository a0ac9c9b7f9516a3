"""Simulated hand: guided motion, commanded paths, a hand at rest, and a user who moves the tool."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import singledispatch
from math import acos, exp
from typing import Any, TypeAlias, final

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array
from haptorb.compiled import kernel
from haptorb.devices.base import MAX_DISTANCE_M, Device, check_distance, device_function, rotation_to_axis
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.motor import SphericalMotor
from haptorb.errors import InputError, quote
from haptorb.rotations import quaternion

__all__ = [
    "DURATION_S",
    "AtRest",
    "DomeMotion",
    "GuidedMotion",
    "HandPose",
    "HandleMotion",
    "PathFunction",
    "RelaxedHand",
    "SampledPath",
    "ScriptedMotion",
    "check_pose",
    "guide_hand",
    "handle_quaternion",
    "handle_quaternions",
    "lead_tool",
    "position_on_path",
    "split_pose",
    "upright_quaternion",
    "upright_quaternions",
]


# --------------------------------------------------------------------------------------------------
# Guided motion: default motion of the hand while the pointer is not in use, as a demonstration.
#
# Twelve seconds over the dome and four of leaning on it near the summit; then the hand moves to the dome's edge and
# rests there in contact, where almost no force is commanded: unattended, the coils do not overheat. A pure function of
# time: two runs have the same hand motion.


DURATION_S = 20.0  #: end of the motion [s]

_APPROACH_DISTANCE_M = 0.062  #: distance of the tool's magnet from the device's centre before touching down [m]
_PRESSED_DISTANCE_M = 0.048  #: while pressing [m]: 2 mm below contact, so that a compliant hand leans on the dome
_REST_DISTANCE_M = 0.0505  #: at rest [m]
_LEAN_TIME_S = 12.0  #: from here the hand leans on the dome without moving along it [s]
_LEAVE_TIME_S = 16.0  #: from here it moves to the edge [s]
_LANDING_TILT_RAD = math.radians(30.0)  #: tilt at touch-down [rad]
_CIRCLE_TILT_RAD = math.radians(18.0)  #: tilt of the circle around the summit [rad]
_LEAN_RAD = math.radians(10.0)  #: tilt near the summit, on the far side [rad]
_REST_TILT_RAD = math.radians(58.0)  #: tilt at rest, on the near side [rad]
_SLIDE_AZIMUTH_RAD = math.radians(-60.0)  #: azimuth of the slide [rad]
_GUIDED_MOTION_TURN = 2 * math.pi  #: one full turn


@kernel
def _smooth(t: float, start: float, end: float) -> float:
    """0 before `start`, 1 after `end`, minimum-jerk trajectory between (Flash and Hogan 1985)."""
    s = min(max((t - start) / (end - start), 0.0), 1.0)
    return s * s * s * (10.0 + s * (6.0 * s - 15.0))


@kernel
def _position(t: float, p: Array) -> None:
    # A signed tilt along one meridian passes the summit without a turn of the hand.
    tilt = (
        _LANDING_TILT_RAD
        - (_LANDING_TILT_RAD + _CIRCLE_TILT_RAD) * _smooth(t, 1.5, 5.0)  # across the summit to the far side
        + (_CIRCLE_TILT_RAD - _LEAN_RAD) * _smooth(t, 10.5, _LEAN_TIME_S)
        + (_LEAN_RAD + _REST_TILT_RAD) * _smooth(t, _LEAVE_TIME_S, DURATION_S)
    )
    bearing = _SLIDE_AZIMUTH_RAD + _GUIDED_MOTION_TURN * _smooth(t, 5.0, 10.5)
    d = (
        _APPROACH_DISTANCE_M
        + (_PRESSED_DISTANCE_M - _APPROACH_DISTANCE_M) * _smooth(t, 0.0, 1.5)
        + (_REST_DISTANCE_M - _PRESSED_DISTANCE_M) * _smooth(t, _LEAVE_TIME_S, DURATION_S)
    )
    s = d * math.sin(tilt)
    p[0], p[1], p[2] = s * math.cos(bearing), s * math.sin(bearing), d * math.cos(tilt)


def _turn_upright(p: Array, q: Array) -> None:
    x, y, z = p[0], p[1], p[2]
    length = math.sqrt(x * x + y * y + z * z)
    if length < 1e-12 or z <= -length * (1 - 1e-12):  # no direction, or no unique shortest rotation
        q[0], q[1], q[2], q[3] = 1.0, 0.0, 0.0, 0.0
        return
    w = length + z
    n = math.sqrt(x * x + y * y + w * w)
    q[0], q[1], q[2], q[3] = -y / n, x / n, 0.0, w / n


def position_on_path(t: float) -> Array:
    """(3,) [m] goal of the hand for the tool's magnet at time `t` [s], frame S; the summit is +z.

    >>> round(1e3 * float(np.linalg.norm(position_on_path(20.0))), 3)
    50.5
    """
    p = np.empty(3)
    _position(float(t), p)
    return p


def upright_quaternion(p: Array) -> Array:
    """(4,) quaternion (x, y, z, w) of the shortest rotation from the tool's z axis to the direction of `p` (3,).

    >>> upright_quaternion(np.array([0.0, -0.05, 0.0])).round(3).tolist()
    [0.707, 0.0, 0.0, 0.707]
    """
    q = np.empty(4)
    # Not the compiled version: a host needs it while it sends heartbeats, and compiling blocks all its threads for
    # seconds.
    _turn_upright(p, q)
    return q


def upright_quaternions(places: Array) -> Array:
    """(n, 4) the same of each of `places` (n, 3) [m].

    >>> upright_quaternions(np.array([[0.0, -0.05, 0.0], [0.0, 0.0, 0.05]])).round(3).tolist()
    [[0.707, 0.0, 0.0, 0.707], [-0.0, 0.0, 0.0, 1.0]]
    """
    x, y, z = places.T
    length = np.sqrt(x * x + y * y + z * z)
    w = length + z
    size = np.sqrt(x * x + y * y + w * w)
    known = (length >= 1e-12) & (z > -length * (1 - 1e-12))
    size[~known] = 1.0
    found: Array = np.stack([-y / size, x / size, np.zeros(len(x)), w / size], axis=1)
    found[~known] = 0.0, 0.0, 0.0, 1.0
    return found


# --------------------------------------------------------------------------------------------------
# Motion of the hand while the pointer is not in use: a path for each kind of device, and the return to its end.


class GuidedMotion(ABC):
    """Motion of the simulated hand that starts at time zero and ends at rest; a pure function of time.

    Attributes
    ----------
    duration : float
        Time after which the hand rests [s].
    relaxes : bool
        Whether the hand yields to a load after the motion.
    """

    duration: float
    relaxes = True  #: whether the hand yields to a load after the motion

    @abstractmethod
    def at(self, t: float) -> tuple[Array, Array]:
        """(3,) position [m] and (4,) quaternion (x, y, z, w) at time `t` [s]."""

    @abstractmethod
    def pose_on_return(self, p: Array, q: Array, share: float) -> tuple[Array, Array]:
        """(3,) position [m] and (4,) quaternion on the way to rest from where a hand released it, `p` (3,) [m] and `q`
        (4,); `share` of the way runs from 0 to 1."""


@final
class DomeMotion(GuidedMotion):
    """Stylus that slides over the dome and circles its summit: see `position_on_path`."""

    duration = DURATION_S

    def __init__(self) -> None:
        self._rest = position_on_path(DURATION_S)
        # Compiled at construction, not at the release.
        self.pose_on_return(self._rest, upright_quaternion(self._rest), 1.0)

    def at(self, t: float) -> tuple[Array, Array]:
        """(3,) position of the tool's magnet [m] and (4,) quaternion (x, y, z, w), axis radial."""
        p = position_on_path(t)
        return p, upright_quaternion(p)

    def pose_on_return(self, p: Array, q: Array, share: float) -> tuple[Array, Array]:
        """(3,) position [m] on the path from `p` (3,) [m] along the sphere, not through the device, and (4,)
        quaternion.

        The axis is radial all the way, however it was released: `q` (4,) is ignored.
        """
        place = np.empty(3)
        _fill_arc(np.ascontiguousarray(p), self._rest, share, place)
        return place, upright_quaternion(place)


@kernel
def _fill_arc(start: Array, rest: Array, s: float, p: Array) -> None:
    r0 = np.sqrt(start[0] ** 2 + start[1] ** 2 + start[2] ** 2)
    r1 = np.sqrt(rest[0] ** 2 + rest[1] ** 2 + rest[2] ** 2)
    for i in range(3):
        p[i] = rest[i] / r1
        if r0 >= 1e-6:  # a hand inside the device has no direction; from there the path is straight
            p[i] = (1.0 - s) * start[i] / r0 + s * p[i]
    length = np.sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2)
    if length < 1e-6:  # antipodal: no unique shortest path
        for i in range(3):
            p[i] = rest[i] / r1
        length = 1.0
    for i in range(3):
        p[i] *= ((1.0 - s) * r0 + s * r1) / length


@device_function
@singledispatch
def guide_hand(device: Device) -> GuidedMotion:
    """Create the motion of the simulated hand before a person points, by the kind of device.

    Parameters
    ----------
    device : Device
        The device.

    Returns
    -------
    GuidedMotion
        By default a hand at rest.
    """
    return AtRest(device)


@guide_hand.register(SphericalElectromagnet)
def _(device: SphericalElectromagnet) -> DomeMotion:
    return DomeMotion()


@final
class AtRest(GuidedMotion):
    """Hand at rest on the mover, for devices without a guided motion."""

    duration = 0.0

    def __init__(self, device: Device) -> None:
        self._rest = np.array(device.rest_position, dtype=np.float64)
        self._upright = np.array([0.0, 0.0, 0.0, 1.0])

    def at(self, t: float) -> tuple[Array, Array]:
        """Constant: (3,) the device's rest position [m], and (4,) the identity."""
        return self._rest, self._upright

    def pose_on_return(self, p: Array, q: Array, share: float) -> tuple[Array, Array]:
        """Straight from `p` (3,) [m], and from `q` (4,) by the shortest rotation, (3,) and (4,)."""
        upright = self._upright if q[3] >= 0.0 else -self._upright
        turned = (1.0 - share) * q + share * upright
        length = float(turned @ turned) ** 0.5
        return (1.0 - share) * p + share * self._rest, turned / length if length > 1e-9 else self._upright


# --------------------------------------------------------------------------------------------------
# Guided motion of a motor's handle: the plug is pulled out of its outlet, inserted, and wiggled.
#
# Eighteen seconds in the translating mode, where a tilt λ moves the plug out, ψ moves it sideways. Forty degrees of
# tilt are the plug's full travel with the gains of `assembly`. At rest the plug is out, without a commanded wrench.


_INSERTED_TILT = math.radians(-20.0)  #: λ with the plug inserted
_REMOVED_TILT = math.radians(20.0)  #: λ with the plug out
_HALF = math.radians(-13.0)  #: λ while wiggling: slightly pulled
_ASIDE = math.radians(6.0)  #: ψ amplitude while wiggling
_NOWHERE = np.zeros(3)


@kernel
def _fill_quaternion(psi: float, lam: float, phi: float, q: Array) -> None:
    a, b, c = math.sin(0.5 * psi), math.sin(0.5 * lam), math.sin(0.5 * phi)
    u, v, w = math.cos(0.5 * psi), math.cos(0.5 * lam), math.cos(0.5 * phi)
    q[0] = a * v * w + u * b * c
    q[1] = u * b * w - a * v * c
    q[2] = u * v * c + a * b * w
    q[3] = u * v * w - a * b * c


@kernel
def _handle(t: float, q: Array) -> None:
    lam = (
        _INSERTED_TILT
        + (_REMOVED_TILT - _INSERTED_TILT) * _smooth(t, 1.0, 5.0)  # out
        + (_INSERTED_TILT - _REMOVED_TILT) * _smooth(t, 5.5, 9.0)  # and in again
        + (_HALF - _INSERTED_TILT) * _smooth(t, 9.5, 11.0)
        + (_REMOVED_TILT - _HALF) * _smooth(t, 15.0, 18.0)
    )
    psi = _ASIDE * (_smooth(t, 11.0, 12.0) - 2.0 * _smooth(t, 12.0, 13.5) + _smooth(t, 13.5, 15.0))
    _fill_quaternion(psi, lam, 0.0, q)


def handle_quaternion(psi: float, lam: float, phi: float) -> Array:
    """(4,) quaternion (x, y, z, w) of R = Rx(ψ) Ry(λ) Rz(φ), angles in [rad].

    >>> handle_quaternion(0.0, 0.0, np.pi).round(12).tolist()
    [0.0, 0.0, 1.0, 0.0]
    """
    q = np.empty(4)
    _fill_quaternion(float(psi), float(lam), float(phi), q)
    return q


def handle_quaternions(angles: Array) -> Array:
    """(n, 4) the same of each of `angles` (n, 3), ψ, λ, φ [rad].

    >>> handle_quaternions(np.array([[0.0, 0.0, np.pi]])).round(12).tolist()
    [[0.0, 0.0, 1.0, 0.0]]
    """
    (a, b, c), (u, v, w) = np.sin(0.5 * angles.T), np.cos(0.5 * angles.T)
    found: Array = np.stack(
        [a * v * w + u * b * c, u * b * w - a * v * c, u * v * c + a * b * w, u * v * w - a * b * c], axis=1
    )
    return found


@final
class HandleMotion(GuidedMotion):
    """Hand on the handle of a motor."""

    duration = 18.0

    def __init__(self) -> None:
        self._rest = self.at(self.duration)[1]

    def at(self, t: float) -> tuple[Array, Array]:
        """No position, (3,) zeros [m]; orientation of the handle, (4,) quaternion (x, y, z, w).

        >>> HandleMotion().at(0.0)[1].round(4).tolist()
        [0.0, -0.1736, 0.0, 0.9848]
        """
        q = np.empty(4)
        _handle(float(t), q)
        return _NOWHERE, q

    def pose_on_return(self, p: Array, q: Array, share: float) -> tuple[Array, Array]:
        """No position, (3,) zeros [m], for any `p` (3,); from `q` (4,) by the shortest rotation, (4,) quaternion."""
        rest = self._rest if float(q @ self._rest) >= 0.0 else -self._rest
        way = (1.0 - share) * q + share * rest
        length = float(way @ way) ** 0.5
        return _NOWHERE, way / length if length > 1e-9 else self._rest


@guide_hand.register(SphericalMotor)
def _(device: SphericalMotor) -> HandleMotion:
    return HandleMotion()


# --------------------------------------------------------------------------------------------------
# Pose or path of the hand commanded by a program, checked before the loop receives it.


#: (3,) position [m] and (4,) quaternion (x, y, z, w)
HandPose: TypeAlias = tuple[Array, Array]
#: path computed by a program: pose as a function of the time [s] since its start
PathFunction: TypeAlias = Callable[[float], Any]


def check_pose(
    p: ArrayLike, q: ArrayLike | None = None, farthest: float = MAX_DISTANCE_M, *, upright: bool = False
) -> HandPose:
    """(3,) `p` [m] and (4,) normalised quaternion `q`; None: the tool's axis radial, or `upright`.

    Raises InputError for another shape, a non-finite number, a position farther than `farthest` [m] from the
    device's centre, or a quaternion of zeros.
    """
    position = _check_numbers(p, 3, "p must be the position of the tool's magnet, 3 finite numbers [m]")
    check_distance(position, "p", farthest)
    if q is None:
        return position, np.array([0.0, 0.0, 0.0, 1.0]) if upright else upright_quaternion(position)
    wanted = "q must be a quaternion (x, y, z, w), 4 finite numbers that are not all zero"
    turn = _check_numbers(q, 4, wanted)
    length = float(np.linalg.norm(turn))
    if length < 1e-6:
        raise InputError(f"{wanted}; got {quote(q)}. Leave it out for a radial axis")
    return position, turn / length


def split_pose(pose: Any) -> tuple[Any, Any]:
    """Position and quaternion or None, from a position (3,) [m], a pair (position, quaternion), or one row of both
    (7,).

    >>> split_pose((0.0, 0.0, 0.05))
    ((0.0, 0.0, 0.05), None)
    >>> split_pose(np.arange(7.0))[1]
    array([3., 4., 5., 6.])
    """
    if isinstance(pose, tuple) and len(pose) == 2:
        return pose
    if isinstance(pose, np.ndarray | list | tuple) and len(pose) == 7:
        return pose[:3], pose[3:]
    return pose, None


@final
class SampledPath:
    """Sampled poses with linear interpolation; the last one remains from its time on.

    poses   (n, 3) places [m], or (n, 7) places and quaternions (x, y, z, w)
    times   (n,) of the poses [s] after the start, increasing
    farthest   maximum distance from the device's centre [m]
    upright    whether the tool is upright, not radial, for a position without a quaternion

    >>> path = SampledPath([(0, 0, 0.05), (0, 0, 0.06)], [0.0, 1.0])
    >>> path(0.5)[0].round(3).tolist(), path(9.0)[0].tolist()
    ([0.0, 0.0, 0.055], [0.0, 0.0, 0.06])
    """

    def __init__(
        self, poses: ArrayLike, times: ArrayLike, farthest: float = MAX_DISTANCE_M, *, upright: bool = False
    ) -> None:
        """Raises InputError for other shapes, times that do not increase, and poses as `check_pose` does."""
        rows = _check_numbers(poses, None, "path must be poses (n, 3) or (n, 7), finite numbers [m]")
        if rows.ndim != 2 or rows.shape[1] not in (3, 7) or not len(rows):
            raise InputError(
                f"path must be poses (n, 3), or (n, 7) with quaternions, or a function of time [s] that returns one; "
                f"got shape {rows.shape}"
            )
        self.times = _check_numbers(times, len(rows), f"times must be {len(rows)} numbers [s], one for each pose")
        if not (np.diff(self.times) > 0).all() or self.times[0] < 0:
            raise InputError(f"times must increase from pose to pose and begin at 0 s or later; got {quote(times)}")
        with np.errstate(over="ignore"):
            lengths = np.linalg.norm(rows[:, 3:], axis=1) if rows.shape[1] == 7 else np.ones(len(rows))
            wrong = (np.linalg.norm(rows[:, :3], axis=1) > farthest) | (lengths < 1e-6) | ~np.isfinite(lengths)
        if wrong.any():
            number = int(np.argmax(wrong))
            try:
                check_pose(*split_pose(rows[number]), farthest, upright=upright)
            except InputError as cause:
                raise InputError(f"pose {number} of the path: {cause}") from cause
            raise InputError(f"pose {number} of the path: its numbers are too large; got {quote(rows[number])}")
        self.poses = np.empty((len(rows), 7))  #: (n, 7) position [m], quaternion (x, y, z, w)
        self.poses[:, :3] = rows[:, :3]
        if rows.shape[1] == 7:
            lengths[np.abs(lengths - 1.0) < 1e-12] = 1.0  # a recorded pose is reproduced bit for bit
            self.poses[:, 3:] = rows[:, 3:] / lengths[:, None]
        elif upright:
            self.poses[:, 3:] = 0.0, 0.0, 0.0, 1.0
        else:
            self.poses[:, 3:] = upright_quaternions(rows)
        turned = np.sum(self.poses[1:, 3:] * self.poses[:-1, 3:], axis=1) < 0.0
        # equivalent quaternion of the shorter interpolation
        self.poses[1:, 3:][np.logical_xor.accumulate(turned)] *= -1.0

    def __call__(self, t: float) -> HandPose:
        """(3,) position [m] and (4,) quaternion `t` [s] after the start."""
        after = int(np.searchsorted(self.times, t, side="right"))
        if after == 0 or after == len(self.times):
            pose = self.poses[min(after, len(self.times) - 1)]
            return pose[:3].copy(), pose[3:].copy()
        start, before = self.times[after - 1], self.poses[after - 1]
        share = float((t - start) / (self.times[after] - start))
        if share == 0.0:  # at a sample, exactly that sample
            return before[:3].copy(), before[3:].copy()
        pose = before + share * (self.poses[after] - before)
        length = float(pose[3:] @ pose[3:]) ** 0.5
        return pose[:3], pose[3:] / length if length > 1e-6 else upright_quaternion(pose[:3])


_TICK_ROUNDING_S = 1e-9  #: rounding tolerance of a tick's deadline [s]


@final
class ScriptedMotion(GuidedMotion):
    """Scripted motion of a hand from a file or a test: poses, opening of the gripper, and buttons, over time.

    It starts at time zero of the loop's clock and stays at the last pose; a held pointer overrides it.

    path     poses at times
    presses  times (k,) [s] and pressed buttons (k,) [1] from then on, a sum: 1 a, 2 b, 4 c
    grip     times (n,) [s] and the gripper's opening (n,) [m], interpolated linearly; None: no gripper
    name     of the file; `digest` is its SHA-256

    >>> motion = ScriptedMotion(SampledPath([(0, 0, 0.06), (0, 0, 0.05)], [0.0, 1.0]), presses=([0.5], [1]))
    >>> motion.at(1.0)[0].tolist(), motion.signals_at(0.4), motion.signals_at(0.5)
    ([0.0, 0.0, 0.05], (0, nan), (1, nan))
    """

    relaxes = False

    def __init__(
        self,
        path: SampledPath,
        *,
        presses: tuple[ArrayLike, ArrayLike] | None = None,
        grip: tuple[ArrayLike, ArrayLike] | None = None,
        name: str = "",
        digest: str = "",
    ) -> None:
        self.path, self.name, self.digest = path, name, digest
        times, pressed = ((), ()) if presses is None else presses
        self.press_times, self.pressed = np.asarray(times, dtype=np.float64), np.asarray(pressed, dtype=np.int64)
        self.grip: tuple[Array, Array] | None = None
        ends = [float(self.path.times[-1]), *self.press_times[-1:].tolist()]
        if grip is not None:
            self.grip = np.asarray(grip[0], dtype=np.float64), np.asarray(grip[1], dtype=np.float64)
            ends.append(float(self.grip[0][-1]))
        self.duration = max(ends)

    def at(self, t: float) -> tuple[Array, Array]:
        """(3,) position [m] and (4,) quaternion (x, y, z, w) at time `t` [s]."""
        return self.path(t)

    def signals_at(self, t: float) -> tuple[int, float]:
        """Pressed buttons at time `t` [s], a sum of 1, 2 and 4, and the gripper's opening [m], NaN without one."""
        after = int(np.searchsorted(self.press_times, t + _TICK_ROUNDING_S, side="right"))
        bits = int(self.pressed[after - 1]) if after else 0
        return bits, math.nan if self.grip is None else float(np.interp(t, *self.grip))

    def pose_on_return(self, p: Array, q: Array, share: float) -> tuple[Array, Array]:
        """Straight from `p` (3,) [m] to the last pose, and from `q` (4,) by the shortest rotation, (3,) and (4,)."""
        place, turn = self.path.poses[-1, :3], self.path.poses[-1, 3:]
        way = (1.0 - share) * q + share * (turn if float(q @ turn) >= 0.0 else -turn)
        length = float(way @ way) ** 0.5
        return (1.0 - share) * p + share * place, way / length if length > 1e-9 else turn


def _check_numbers(value: ArrayLike, count: int | None, wanted: str) -> Array:
    """Check that `value` has finite numbers, `count` of them in a row; None: any shape."""
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as cause:
        raise InputError(f"{wanted}; got {quote(value)}") from cause
    if not np.isfinite(numbers).all() or (count is not None and numbers.shape != (count,)):
        raise InputError(f"{wanted}; got {quote(value)}")
    return numbers


# --------------------------------------------------------------------------------------------------
# Relaxed hand at rest: yields to a sustained force, so that an unattended device is not loaded permanently.
#
# A resting hand moves slowly in the direction of the device's force, as a relaxed arm does, so that the commanded force
# decreases and the coils stay cool. It moves around the device, not away from it, where the same force would need more
# current, and no further than a hand can without moving its arm. Where yielding does not reduce the force, as in a
# flow, the hand returns, and tries again later.


_YIELD_TIME_CONSTANT_S = 1.0  #: time constant of yielding [s]
_MAX_DISPLACEMENT_M = 0.03  #: maximum displacement from rest [m]
_MAX_ROTATION_RAD = np.radians(40.0)  #: maximum rotation from rest [rad]
_LEVER_ARM_M = 0.05  #: lever arm that converts rotation to displacement [m]
_SAMPLING_PERIOD_S = 0.02  #: sampling period of the tool's pose [s]
_SETTLING_TIME_S = 1.0  #: rest time before the hand yields; its deflection by then must decrease [s]
_TRIAL_TIME_S = 12.0  #: time in which it must halve [s]
_RETRY_INTERVAL_S = 120.0  #: time until the next attempt [s]


@final
class RelaxedHand:
    """Goal of a resting hand for the mover, with yielding."""

    def __init__(self) -> None:
        self._place = np.zeros(7)
        self._rest = np.full(7, np.nan)
        self._start = self._next = 0.0
        self._pushed = 0.0  # deflection at the start of yielding, as a length [m]
        self._helps = True

    def rest_at(self, rest: Array, now: float) -> Array:
        """(7,) [m], quaternion (x, y, z, w): pose of a hand that rests at `rest` (7,), at `now` [s]; displaced from it
        if it has yielded there before."""
        if not np.array_equal(rest, self._rest):
            self._rest[:] = self._place[:] = rest
            self._start = self._next = now
        return self._place

    def is_due(self, now: float) -> bool:
        """Whether `yield_to` must be called at `now` [s]."""
        return now >= self._next

    def yield_to(self, tool: Array, now: float) -> None:
        """Move slowly towards the mover at `tool` (7,) [m], quaternion (x, y, z, w), at `now` [s], or back to rest."""
        self._next = now + _SAMPLING_PERIOD_S
        pushed = _distance(tool, self._place)
        if now - self._start >= _RETRY_INTERVAL_S:
            self._start = now
        since = now - self._start
        if since < _SETTLING_TIME_S:
            self._pushed, self._helps = pushed, True
            return
        if since >= _TRIAL_TIME_S and pushed > 0.5 * self._pushed:
            self._helps = False
        place = _approach(
            self._place, tool if self._helps else self._rest, 1.0 - exp(-_SAMPLING_PERIOD_S / _YIELD_TIME_CONSTANT_S)
        )
        far, length = float(np.linalg.norm(self._rest[:3])), float(np.linalg.norm(place[:3]))
        place[:3] *= far / length if length > 0.5 * far > 0.0 else 0.0
        if (
            float(np.linalg.norm(place[:3] - self._rest[:3])) <= _MAX_DISPLACEMENT_M
            and _turn(place, self._rest) <= _MAX_ROTATION_RAD
        ):
            self._place[:] = place


def _approach(place: Array, goal: Array, share: float) -> Array:
    """(7,) pose at `share` of the path from `place` to `goal`, both (7,)."""
    found = place + share * (goal - place)
    turned = goal[3:] if float(goal[3:] @ place[3:]) >= 0.0 else -goal[3:]
    found[3:] = place[3:] + share * (turned - place[3:])
    found[3:] /= float(found[3:] @ found[3:]) ** 0.5
    return found


def _turn(a: Array, b: Array) -> float:
    return 2.0 * acos(min(1.0, abs(float(a[3:] @ b[3:]))))


def _distance(a: Array, b: Array) -> float:
    return float(np.linalg.norm(a[:3] - b[:3])) + _LEVER_ARM_M * _turn(a, b)


# --------------------------------------------------------------------------------------------------
# Motion of a user who moves the tool over the dome for the self-calibration of the field sensors: simulated.


_LED_TOOL_LEAN = 0.4  #: maximum slope of the moved tool, each way


def lead_tool(device: SphericalElectromagnet, now: float, reach: float = 1.0) -> tuple[Array, Array]:
    """Position (3,) [m] and quaternion (4,) at `now` [s] of a user who moves the tool over the whole dome.

    It circles, moves up and down to `reach` of the workspace's angle, is lifted, and tilts to all sides, with periods
    of three to thirteen seconds.
    """
    turn = 2 * np.pi * now / 4.7
    polar = device.workspace_half_angle * reach * (0.52 - 0.46 * np.cos(2 * np.pi * now / 13.1))
    lift = device.shell_thickness * (0.45 - 0.40 * np.cos(2 * np.pi * now / 3.1))
    outward = np.array([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)])
    lean = _LED_TOOL_LEAN * np.array([np.sin(2 * np.pi * now / 5.3), np.sin(2 * np.pi * now / 7.9 + 1.0)])
    R = rotation_to_axis(outward)
    axis = outward + lean[0] * R[:, 0] + lean[1] * R[:, 1]
    return (device.contact_distance + lift) * outward, quaternion(rotation_to_axis(axis / np.linalg.norm(axis)))
