"""Registration of a tracker's frame: fit from touched points, and checks of their poses.

Every check raises CalibrationError with finding, location and remedy.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, permutations
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, check_finite
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.errors import CalibrationError, InputError

__all__ = [
    "UNKNOWNS",
    "FrameFit",
    "FrameRegistration",
    "Pivot",
    "Roll",
    "TouchSession",
    "Touches",
    "check_centre",
    "check_enough",
    "check_handedness",
    "check_marks",
    "check_pivot",
    "check_roll",
    "check_scale",
    "check_sphere",
    "check_spread",
    "find_roll",
    "find_unobservable",
    "fit_points",
    "frame_registration",
    "pivot",
    "sphere",
]


# --------------------------------------------------------------------------------------------------
# Tracker data of a registration: poses of the tool's rigid body at touched points, in the tracker's frame.


_NORM_TOLERANCE = 0.1  #: tolerance of a quaternion's norm


@final
@dataclass(frozen=True)
class Touches:
    """Poses of the rigid body.

    p  (n, 3) its origin, tracker frame [m]
    q  (n, 4) unit quaternions (x, y, z, w) that rotate the body's vectors into the tracker's frame
    """

    p: Array
    q: Array

    @classmethod
    def of(cls, p: ArrayLike, q: ArrayLike, what: str) -> Touches:
        """Create from arrays, with normalised quaternions.

        Raises InputError for other shapes or non-finite values, CalibrationError for invalid quaternions.
        """
        places, turns = check_finite(p, f"{what}: positions"), check_finite(q, f"{what}: quaternions")
        places, turns = places.reshape(-1, 3), turns.reshape(len(places), 4)
        length = np.linalg.norm(turns, axis=1)
        if (np.abs(length - 1.0) > _NORM_TOLERANCE).any():
            worst = float(length[np.argmax(np.abs(length - 1.0))])
            raise CalibrationError(
                f"{what}: the tracker's quaternions must have length 1; one has {worst:.3g}. Angles or a matrix must "
                "be sent as a quaternion x y z w"
            )
        return cls(places, turns / length[:, None])

    def __len__(self) -> int:
        return len(self.p)

    @cached_property
    def R(self) -> Array:
        """(n, 3, 3) rotations from the body's frame to the tracker's."""
        x, y, z, w = self.q.T
        rows = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    def point(self, at: Array) -> Array:
        """(n, 3) [m] positions of the body's point `at` (3,) [m], tracker frame."""
        places: Array = self.p + self.R @ at
        return places

    def select(self, which: Array) -> Touches:
        """Those for which `which` (n,) is true."""
        return Touches(self.p[which], self.q[which])


@final
@dataclass(frozen=True)
class TouchSession:
    """Poses of one registration.

    dome   tip anywhere on the dome, the tool tilted in all directions; occasionally lifted
    marks  by mark: tip in the mark, the tool tilted to all sides
    roll   tool rotated about its own axis, with the axis at rest
    """

    dome: Touches
    marks: Mapping[str, Touches]
    roll: Touches


# --------------------------------------------------------------------------------------------------
# Tip, sphere, frame and axis in closed form, each independent: starting point of the least squares.
#
# None of them needs the result of another except the tip, so they also serve as a check.


_MAX_REJECTION_ROUNDS = 6  #: maximum number of iterations of outlier rejection
_FRAME_START_LEFT_OUT = 4.0  #: robust standard deviations above which a touch is not on the sphere
_START_TOLERANCE_M = 0.3e-3  #: nor is one rejected that is nearer to it than this [m]


@final
@dataclass(frozen=True)
class Pivot:
    """Pivot calibration: tip that stood at several points while its body was rotated about it."""

    tip: Array  #: (3,) in the body [m]
    places: Array  #: (k, 3) of the tip, tracker frame [m]
    rms: float  #: of the residual per axis [m]
    weakest: float  #: smallest singular value per square root of the number of poses: observability of the tip, 0 … 1


def pivot(stands: Sequence[Touches]) -> Pivot:
    """Tip and pivot points: P + Q a = b is linear in both."""
    poses = sum(len(one) for one in stands)
    rows, right = np.zeros((3 * poses, 3 + 3 * len(stands))), np.empty(3 * poses)
    at = 0
    for k, one in enumerate(stands):
        end = at + 3 * len(one)
        rows[at:end, :3] = one.R.reshape(-1, 3)
        rows[at:end, 3 + 3 * k : 6 + 3 * k] = -np.tile(np.eye(3), (len(one), 1))
        right[at:end] = -one.p.ravel()
        at = end
    found = np.asarray(np.linalg.lstsq(rows, right, rcond=None)[0], dtype=np.float64)
    left = rows @ found - right
    # information on the tip alone: the pivot points are free
    spread = np.concatenate([(one.R - one.R.mean(axis=0)).reshape(-1, 3) for one in stands])
    weakest = float(np.linalg.svd(spread, compute_uv=False)[-1] / np.sqrt(poses))
    return Pivot(found[:3], found[3:].reshape(-1, 3), float(np.sqrt((left**2).mean())), weakest)


def sphere(points: Array) -> tuple[Array, float, Array]:
    """(centre (3,), radius [m], (n,) inliers): |x|² = 2 c·x + (r² − |c|²) is linear in c and the remainder.

    Points far off it, where the tip was lifted, are rejected iteratively.
    """
    middle = np.median(points, axis=0)
    x = points - middle
    on = np.ones(len(x), dtype=bool)
    centre, radius = np.zeros(3), 0.0
    for _ in range(_MAX_REJECTION_ROUNDS):
        rows = np.column_stack([2.0 * x[on], np.ones(int(on.sum()))])
        found, *_ = np.linalg.lstsq(rows, (x[on] ** 2).sum(axis=1), rcond=None)
        centre = found[:3]
        radius = float(np.sqrt(max(found[3] + centre @ centre, 0.0)))
        off = np.linalg.norm(x - centre, axis=1) - radius
        scale = 1.4826 * float(np.median(np.abs(off[on] - np.median(off[on]))))
        before, on = on, np.abs(off) <= max(_FRAME_START_LEFT_OUT * scale, _START_TOLERANCE_M)
        if (on == before).all() or on.sum() < 4:
            break
    return centre + middle, radius, on


def fit_points(places: Array, known: Array, *, mirrored: bool = False) -> tuple[Array, Array, float]:
    """(R (3, 3), t (3,), rms [m]): rotation, or reflection, that maps places (k, 3) onto known (k, 3), least squares.

    R places + t ≈ known, by the singular value decomposition of their covariance (Kabsch).
    """
    a, b = places.mean(axis=0), known.mean(axis=0)
    U, _, Vt = np.linalg.svd((known - b).T @ (places - a))
    sign = np.linalg.det(U @ Vt) * (-1.0 if mirrored else 1.0)
    R = U @ np.diag([1.0, 1.0, np.sign(sign)]) @ Vt
    t = b - R @ a
    return R, t, float(np.sqrt(((places @ R.T + t - known) ** 2).sum(axis=1).mean()))


@final
@dataclass(frozen=True)
class Roll:
    """Body rotated about one of its own axes."""

    axis: Array  #: (3,) unit vector in the body; its sign is undetermined
    wobble: float  #: rms angular motion of the axis [rad]
    angle: float  #: rotation angle, up to a full turn [rad]


def find_roll(poses: Touches) -> Roll:
    """Axis u with the smallest spread of Q u: the longest mean, so the first eigenvector of Q̄ᵀ Q̄."""
    mean = poses.R.mean(axis=0)
    axis: Array = np.linalg.eigh(mean.T @ mean)[1][:, -1]
    directions = poses.R @ axis
    middle = directions.mean(axis=0)
    middle /= np.linalg.norm(middle)
    wobble = float(np.sqrt((np.linalg.norm(np.cross(directions, middle), axis=1) ** 2).mean()))
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    shown, flat = poses.R @ across, np.cross(middle, poses.R[0] @ across)
    turned = np.sort(np.arctan2(shown @ flat, shown @ np.cross(flat, middle)))
    gaps = np.diff(np.append(turned, turned[0] + 2 * np.pi))
    return Roll(axis, wobble, float(2 * np.pi - gaps.max()))


# --------------------------------------------------------------------------------------------------
# Diagnosis of a tracker whose poses do not fit: common mistakes are tried and reported by name.
#
# Every check raises CalibrationError with cause, location and remedy.


LEAST_DOME, LEAST_MARK, LEAST_ROLL = 30, 8, 12  #: minimum number of distinct poses of each step

#: limit on the rms of a tip in the marks; as a share of the marks' distances beyond [m]
_FRAME_CHECKS_LOOSE = 2e-3
_MIN_TILT = np.sin(np.deg2rad(5.0))  #: rms tilt in the marks below which the tip is not observable
_SCALE_TOLERANCE = 0.02  #: tolerance of the tracker's scale
_UNITS = {1e3: "millimetres", 1e2: "centimetres", 1 / 0.0254: "inches", 1 / 0.3048: "feet"}
_RADIUS_TOLERANCE_M = 1e-3  #: tolerance of the dome's radius against the file's [m]
_MAX_OUTLIER_SHARE = 0.25  #: maximum share of the touches on the dome that may be outliers
_CENTRE_TOLERANCE_M = 4e-3  #: tolerance between the centres by dome and by marks, and between the marks [m]
_MIN_SPREAD_RAD = np.deg2rad(35.0)  #: minimum half angle of the touches on the dome [rad]
_MAX_WOBBLE_RAD, _MIN_ROLL_RAD = np.deg2rad(1.5), np.deg2rad(90.0)  #: [rad]


def check_enough(touched: TouchSession, names: Sequence[str]) -> None:
    """Check for enough poses, for every mark of `names`."""
    wanted = [("on the dome", touched.dome, LEAST_DOME), ("while rolling", touched.roll, LEAST_ROLL)]
    missing = [name for name in names if name not in touched.marks]
    if missing:
        raise CalibrationError(f"mark '{missing[0]}' was not touched; all of {', '.join(names)} are needed")
    wanted += [(f"in mark '{name}'", touched.marks[name], LEAST_MARK) for name in names]
    for where, one, least in wanted:
        if len(one) < least:
            raise CalibrationError(
                f"only {len(one)} distinct poses {where}; at least {least} are needed: keep moving or tilting the "
                "tool, and check that the tracker sees it"
            )


def check_pivot(stands: Sequence[Touches]) -> Pivot:
    """Tip from the marks alone; checks that the poses are those of a rigid body about a tip."""
    found = pivot(stands)
    size = max(float(np.linalg.norm(found.places - found.places.mean(axis=0), axis=1).mean()), 1e-9)
    loose = _FRAME_CHECKS_LOOSE * max(1.0, size / 0.03)  # in millimetres everything is a thousand times larger
    if found.rms > loose:
        for name, q in _list_misreadings(stands).items():
            again = pivot([Touches(one.p, turn) for one, turn in zip(stands, q, strict=True)])
            if again.rms < 0.3 * found.rms and again.rms < loose:
                raise CalibrationError(
                    f"no tip fits the tracker's poses as they are sent (rms {1e3 * found.rms:.1f} mm), but one does if "
                    f"{name}: send the x y z w that rotates vectors from body to tracker"
                )
        raise CalibrationError(
            f"no tip fits the tracker's poses in the marks (rms {1e3 * found.rms:.1f} mm): the tip must stay in its "
            "mark while the tool is tilted, the markers must not move on the tool, and positions and quaternions must "
            "be of the same, right-handed frame"
        )
    if found.weakest < _MIN_TILT:
        raise CalibrationError(
            f"in the marks the tool was tilted by no more than {np.rad2deg(np.arcsin(found.weakest)):.1f}° (rms, about "
            "the least of three axes): the tip's place in the body is not observable. Tilt by 20° or more to all "
            "sides, and roll the tool"
        )
    return found


def _list_misreadings(stands: Sequence[Touches]) -> dict[str, list[Array]]:
    """Quaternions under the common mistakes in the order of their components."""
    first = [one.q[:, [1, 2, 3, 0]] for one in stands]
    return {
        "the quaternion's w came first (w x y z)": first,
        "the quaternion turned the other way (tracker into body)": [one.q * [-1, -1, -1, 1] for one in stands],
        "the quaternion's w came first and it turned the other way": [q * [-1, -1, -1, 1] for q in first],
    }


def check_scale(places: Array, known: Array) -> None:
    """Check that the tracker's unit is the metre: by the distances between places and known marks (k, 3) [m], in any
    order."""

    def size(points: Array) -> float:
        return sum(float(np.linalg.norm(a - b)) for a, b in combinations(points, 2))

    scale = size(places) / size(known)
    if abs(scale - 1.0) <= _SCALE_TOLERANCE:  # safety: frame-scale
        return
    unit = next((f" {name}" for factor, name in _UNITS.items() if abs(scale / factor - 1.0) < 0.05), "")
    what = f"reports{unit}: " if unit else "is out of scale: "
    raise CalibrationError(
        f"the tracker {what}the marks appear {scale:.4g} times as far apart as they are. Poses must be in metres"
        + ("" if unit else "; calibrate the tracker, or check that all marks were touched")
    )


def check_sphere(radius: float, on: Array, known: float) -> None:
    """Check that the dome's `radius` [m] is the file's `known` [m], and that most touches, on (n,), are inliers."""
    if (share := 1.0 - float(on.mean())) > _MAX_OUTLIER_SHARE:
        raise CalibrationError(
            f"{100 * share:.0f} % of the touches on the dome are not on it: keep the tip on the dome, keep the side "
            "of the tool off it, and lift it only occasionally"
        )
    if abs(radius - known) > _RADIUS_TOLERANCE_M:
        raise CalibrationError(
            f"the touches on the dome lie on a sphere of {1e3 * radius:.1f} mm; the device's dome has {1e3 * known:g} "
            "mm. Check that it is this device, and that the tip touched the dome itself"
        )


def check_spread(points: Array, centre: Array) -> None:
    """Check that the points (n, 3) [m] touched on the dome cover a wide angle about its centre (3,) [m]."""
    directions = (points - centre) / np.linalg.norm(points - centre, axis=1)[:, None]
    middle = directions.mean(axis=0)
    middle /= np.linalg.norm(middle)
    half = float(np.percentile(np.arccos(np.clip(directions @ middle, -1.0, 1.0)), 90))
    if half < _MIN_SPREAD_RAD:
        raise CalibrationError(
            f"the touches on the dome are all within {np.rad2deg(half):.0f}° of one point: the dome's centre is not "
            f"observable from there. Touch the whole dome, {np.rad2deg(_MIN_SPREAD_RAD):.0f}° or more to every side"
        )


def check_handedness(places: Array, centre: Array, known: Array) -> None:
    """Check that the frame is right-handed: places (k, 3) and centre (3,) [m] are not a mirror image of known (k, 3)
    and 0."""
    found, wanted = np.vstack([places, centre]), np.vstack([known, np.zeros(3)])
    right, left = fit_points(found, wanted)[2], fit_points(found, wanted, mirrored=True)[2]
    if right > _CENTRE_TOLERANCE_M / 2 and left < 0.3 * right:  # safety: left-handed
        raise CalibrationError(
            f"the tracker's frame is left-handed: the marks and the dome fit mirrored (rms {1e3 * left:.1f} mm) and "
            f"not as they are ({1e3 * right:.1f} mm). Switch its axes, or send −x with the quaternion x −y −z w"
        )


def check_marks(places: Array, known: Array, names: Sequence[str]) -> None:
    """Check that each of the places (k, 3) is that of the requested mark, known (k, 3) [m]."""
    rms = fit_points(places, known)[2]
    if rms <= _CENTRE_TOLERANCE_M / 2:
        return
    for order in permutations(range(len(names))):
        if fit_points(places[list(order)], known)[2] < 0.3 * rms:
            wrong = ", ".join(
                f"'{names[order.index(k)]}' instead of '{name}'" for k, name in enumerate(names) if order[k] != k
            )
            raise CalibrationError(f"the marks were touched in another order: {wrong}. Touch them in the printed order")
    raise CalibrationError(
        f"the marks are {1e3 * rms:.1f} mm (rms) from their places in the device file: check that each was touched "
        "in its centre, and that the file's marks are those of this device"
    )


def check_centre(by_dome: Array, by_marks: Array) -> None:
    """Check that dome and marks agree on the centre (3,) [m]."""
    if (apart := float(np.linalg.norm(by_dome - by_marks))) > _CENTRE_TOLERANCE_M:
        raise CalibrationError(
            f"the dome's centre is {1e3 * apart:.1f} mm from its place by the marks: check that device and cameras "
            "did not move between the steps, and that no mark was missed"
        )


def check_roll(found: Roll) -> None:
    """Check that the tool was rotated far enough, about a fixed axis."""
    if found.angle < _MIN_ROLL_RAD:
        raise CalibrationError(
            f"the tool was rolled by only {np.rad2deg(found.angle):.0f}°; its axis needs at least "
            f"{np.rad2deg(_MIN_ROLL_RAD):.0f}°, better a full turn"
        )
    if found.wobble > _MAX_WOBBLE_RAD:
        raise CalibrationError(
            f"the tool's axis wobbled by {np.rad2deg(found.wobble):.1f}° (rms) while it was rolled: put it into a bore "
            "that fits and turn it there"
        )


# --------------------------------------------------------------------------------------------------
# Least squares over the touched points: frame and tip by Gauss–Newton, and their unobservable directions.
#
# Frame and tip are updated as x ↦ exp(δ) x + τ and a ↦ a + α, with x = R (P + Q a) + t the tip in the stator frame, so
#
#     ∂x/∂δ = −[x]ₓ,    ∂x/∂τ = 1,    ∂x/∂α = R Q.
#
# The dome alone leaves δ undetermined, exactly: its normal is along x, and x · (δ × x) = 0. It determines the centre;
# the marks determine the rotation.


UNKNOWNS = ("turn about x", "turn about y", "turn about z", "shift along x", "shift along y", "shift along z",
            "tip along the body's x", "tip along the body's y", "tip along the body's z")  # fmt: skip

_STEPS = 20
_CONVERGENCE_M = 1e-9  #: convergence [m]
_FRAME_FIT_LEFT_OUT = 4.0  #: robust standard deviations above which a touch on the dome is rejected
_FIT_TOLERANCE_M = 0.3e-3  #: but none that is nearer than this [m]
_UNOBSERVABLE_SHARE = 1e-2  #: unobservable: singular values below this share of the largest; noise alone gives some


@final
class FrameFit:
    """Least squares over dome and marks together: known (k, 3) [m] marks, from R (3, 3), t (3,) and tip (3,) [m]."""

    def __init__(
        self, touched: TouchSession, names: tuple[str, ...], known: Array, radius: float, R: Array, t: Array, tip: Array
    ) -> None:
        stands = [touched.marks[name] for name in names]
        self.dome = len(touched.dome)
        self.p = np.concatenate([touched.dome.p, *(one.p for one in stands)])
        self.Q = np.concatenate([touched.dome.R, *(one.R for one in stands)])
        self.known = np.repeat(known, [len(one) for one in stands], axis=0)
        self.radius, self.R, self.t, self.tip = radius, R, t, tip
        self.on = np.ones(self.dome, dtype=bool)

    @property
    def x(self) -> Array:
        """(n, 3) the tip in the stator frame [m], dome first."""
        placed: Array = (self.p + self.Q @ self.tip) @ self.R.T + self.t
        return placed

    def equations(self) -> tuple[Array, Array]:
        """(residuals (m,) [m], Jacobian (m, 9)); rotations are scaled by the dome's radius, so that all unknowns are
        lengths."""
        x = self.x
        J = np.zeros((len(x), 3, 9))
        J[:, 0, 1], J[:, 0, 2], J[:, 1, 2] = x[:, 2], -x[:, 1], x[:, 0]
        J[:, 1, 0], J[:, 2, 0], J[:, 2, 1] = -x[:, 2], x[:, 1], -x[:, 0]
        J[:, :, :3] /= self.radius
        J[:, :, 3:6] = np.eye(3)
        J[:, :, 6:] = self.R @ self.Q
        distance = np.linalg.norm(x[: self.dome], axis=1)
        normal = x[: self.dome] / distance[:, None]
        dome = np.einsum("ij,ijk->ik", normal, J[: self.dome])
        left = np.concatenate([(distance - self.radius)[self.on], (x[self.dome :] - self.known).ravel()])
        return left, np.concatenate([dome[self.on], J[self.dome :].reshape(-1, 9)])

    def settle(self) -> None:
        """Gauss–Newton to convergence, then once more without the touches at which the tip was off the dome.

        Raises CalibrationError if it does not converge.
        """
        for _ in range(3):
            for _ in range(_STEPS):
                left, J = self.equations()
                step, *_ = np.linalg.lstsq(J, -left, rcond=None)
                turn = _rotation(np.asarray(step[:3] / self.radius))
                self.R, self.t, self.tip = turn @ self.R, turn @ self.t + step[3:6], self.tip + step[6:]
                if np.abs(step).max() < _CONVERGENCE_M:
                    break
            else:
                raise CalibrationError("the fit of the frame does not converge: touch the dome and all marks again")
            off = np.linalg.norm(self.x[: self.dome], axis=1) - self.radius
            scale = 1.4826 * float(np.median(np.abs(off - np.median(off))))
            before, self.on = self.on, np.abs(off) <= max(_FRAME_FIT_LEFT_OUT * scale, _FIT_TOLERANCE_M)
            if (self.on == before).all():
                return


def find_unobservable(J: Array, names: tuple[str, ...] = UNKNOWNS) -> tuple[float, tuple[str, ...]]:
    """(condition, unobservable directions): null space of J (n, 9), described in words.

    >>> find_unobservable(np.eye(9)[:8])[1]
    ("tip along the body's z",)
    """
    _, s, Vt = np.linalg.svd(np.vstack([J, np.zeros((len(names), len(names)))]), full_matrices=False)
    free = Vt[s <= _UNOBSERVABLE_SHARE * s[0]]
    share = (free**2).sum(axis=0)
    unseen = tuple(name for name, part in zip(names, share, strict=True) if part > 0.3)
    return float(s[0] / s[-1]) if s[-1] > 0 else float("inf"), unseen


def _rotation(w: Array) -> Array:
    """(3, 3) rotation by the vector w [rad] (Rodrigues)."""
    angle = max(float(np.linalg.norm(w)), 1e-9)
    K = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    R: Array = np.eye(3) + np.sin(angle) / angle * K + (1 - np.cos(angle)) / angle**2 * K @ K
    return R


# --------------------------------------------------------------------------------------------------
# Pose of the device in a tracker's frame, and of the tool in its rigid body: from touched points, by Gauss–Newton.
#
# Unknown are the frame (R, t: 6) and the tip in the body (a: 3), x = R (P + Q a) + t. On the dome |x| = r, in mark k x
# = x_k (`FrameFit`). Closed forms give the starting point of each step (`pivot`, `sphere`, `fit_points`), and
# inconsistencies are reported (`check_…`). The tool's axis is estimated separately, from the rolled tool.


_FRAME_REGISTRATION_LOOSE = 1.5e-3  #: rms above which the rigid body is loose [m]
#: uncertainty of the tool's pose above which a frame is rejected [m], [rad]
_MAX_POSITION_ERROR_M, _MAX_DIRECTION_ERROR_RAD = 1e-3, np.deg2rad(2.0)


@final
@dataclass(frozen=True)
class FrameRegistration:
    """Result of a registration, with its uncertainty.

    R, t         (3, 3), (3,) [m] tracker into stator: x_S = R x_T + t
    tip          (3,) in the body [m]
    axis         (3,) unit vector in the body, from the tip towards the magnet
    residual     rms distance of the touches from dome and marks, per equation [m]
    condition    of the last step, rotations scaled by the dome's radius
    position     standard deviation of the magnet's place over the touches on the dome [m]
    direction    that of the tool's axis [rad]
    radius       of the independently fitted sphere [m], for comparison with the dome's
    wobble       of the axis while the tool was rolled, rms [rad]
    used         touches that were used; excluded: rejected touches on the dome
    """

    R: Array
    t: Array
    tip: Array
    axis: Array
    residual: float
    condition: float
    position: float
    direction: float
    radius: float
    wobble: float
    used: int
    excluded: int


def frame_registration(touched: TouchSession, device: SphericalElectromagnet) -> FrameRegistration:
    """Register the frame.

    Raises InputError for a device without marks, and CalibrationError with the cause for touches that do not determine
    a frame, or that are inconsistent with a right-handed tracker in metres and a rigid tool.
    """
    marks = device.marks
    if marks is None:
        raise InputError(
            f"device '{device.name}': its file has no [marks]; the dome alone leaves the frame's rotation free. "
            "Measure three points that can hold the tip, and add them"
        )
    check_enough(touched, marks.names)
    stands = [touched.marks[name] for name in marks.names]
    start = check_pivot(stands)
    check_scale(start.places, marks.positions)
    centre, radius, on = sphere(touched.dome.point(start.tip))
    check_marks(start.places, marks.positions, marks.names)
    R, t, _ = fit_points(start.places, marks.positions)
    check_spread(touched.dome.point(start.tip), -R.T @ t)
    check_sphere(radius, on, device.dome_radius)
    check_handedness(start.places, centre, marks.positions)
    check_centre(centre, -R.T @ t)
    roll = find_roll(touched.roll)
    check_roll(roll)
    fit = FrameFit(touched, marks.names, marks.positions, device.dome_radius, R, t, start.tip)
    fit.settle()
    outward = fit.x[: len(touched.dome)]
    along = np.einsum("ij,ij->i", touched.dome.R @ roll.axis, outward @ fit.R)
    axis = roll.axis if float(np.median(along)) > 0 else -roll.axis
    return _judge_fit(fit, axis, roll.wobble, radius, device.tool.tip_distance)


def _judge_fit(fit: FrameFit, axis: Array, wobble: float, radius: float, tip_distance: float) -> FrameRegistration:
    left, J = fit.equations()
    condition, unseen = find_unobservable(J)
    if unseen:
        raise CalibrationError(
            f"the touches do not determine {', '.join(unseen)}. Touch all marks, and more of the dome with more tilt"
        )
    residual = float(np.sqrt((left**2).mean()))
    if residual > _FRAME_REGISTRATION_LOOSE:
        raise CalibrationError(
            f"the residual at dome and marks is {1e3 * residual:.1f} mm (rms): check that the tool's body is not "
            "loose, that the tracker's calibration is valid here, and that all marks were touched in their centre"
        )
    covariance = float(left @ left) / max(len(left) - 9, 1) * np.linalg.inv(J.T @ J)
    # errors fixed to the tool do not average out over its poses: the wobble counts in full
    turn = float(np.trace(covariance[:3, :3])) / fit.radius**2
    direction = float(np.sqrt(2.0 / 3.0 * turn + wobble**2))
    x = fit.x[: fit.dome][fit.on]
    visible = np.zeros((len(x), 3, 9))
    out = x + tip_distance * ((fit.R @ fit.Q[: fit.dome][fit.on]) @ axis)
    for k, unit in enumerate(np.eye(3)):
        visible[:, :, k] = np.cross(unit, out) / fit.radius
    visible[:, :, 3:6] = np.eye(3)
    visible[:, :, 6:] = fit.R @ fit.Q[: fit.dome][fit.on]
    spread = np.einsum("nij,jk,nik->n", visible, covariance, visible).mean()
    position = float(np.sqrt(spread + (tip_distance * wobble) ** 2))
    if position > _MAX_POSITION_ERROR_M or direction > _MAX_DIRECTION_ERROR_RAD:
        raise CalibrationError(
            f"the expected accuracy is only {1e3 * position:.1f} mm and {np.rad2deg(direction):.1f}°; touch more "
            "points, tilt more, roll further, or reduce the tracker's noise"
        )
    return FrameRegistration(
        fit.R, fit.t, fit.tip, axis, residual, condition, position, direction, radius, wobble,
        int(fit.on.sum()) + len(fit.known), int((~fit.on).sum()),
    )  # fmt: skip
