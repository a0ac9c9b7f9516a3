"""Where the device is in a tracker's frame, and the tool in its rigid body: from touches, by Gauss–Newton.

Unknown are the frame (R, t: 6) and the tip in the body (a: 3), x = R (P + Q a) + t. On the dome |x| = r, in mark k
x = x_k. Frame and tip are stepped as x ↦ exp(δ) x + τ and a ↦ a + α, so that

    ∂x/∂δ = −[x]ₓ,    ∂x/∂τ = 1,    ∂x/∂α = R Q.

The dome alone leaves δ free, exactly: its normal is along x, and x · (δ × x) = 0. It holds the centre; the marks hold
the turn. The tool's axis comes from the rolled tool by itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.errors import CalibrationError, InputError
from haptorb.physics.arrays import Array
from haptorb.sensing import frame_doubts as doubts
from haptorb.sensing.frame_start import laid_onto, rolled, sphere
from haptorb.sensing.touches import Touched

__all__ = ["FrameRegistration", "frame_registration", "observable"]

UNKNOWNS = ("turn about x", "turn about y", "turn about z", "shift along x", "shift along y", "shift along z",
            "tip along the body's x", "tip along the body's y", "tip along the body's z")  # fmt: skip

_STEPS = 20
_SETTLED = 1e-9  #: [m]
_LEFT_OUT = 4.0  #: robust standard deviations from which a touch on the dome is left out
_LEAST = 0.3e-3  #: but none that is nearer than this [m]
_FREE = 1e-2  #: share of the greatest singular value below which a direction is not observable: noise alone makes some
_LOOSE = 1.5e-3  #: rms from which something is loose [m]
_POSITION, _DIRECTION = 1e-3, np.deg2rad(2.0)  #: of the tool, from which a frame is of no use [m], [rad]


@final
@dataclass(frozen=True)
class FrameRegistration:
    """What was found, and how far it may be trusted.

    R, t         (3, 3), (3,) [m] tracker into stator: x_S = R x_T + t
    tip          (3,) in the body [m]
    axis         (3,) unit vector in the body, from the tip towards the magnet
    residual     rms distance of the touches from dome and marks, per equation [m]
    condition    of the last step, turns measured at the dome's radius
    position     standard deviation of the magnet's place over the touches on the dome [m]
    direction    that of the tool's axis [rad]
    radius       of the sphere by itself [m], to be held against the dome's
    wobble       of the axis while the tool was rolled, rms [rad]
    used         touches that were used; excluded: those on the dome that were not
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


def frame_registration(touched: Touched, device: SphericalElectromagnet) -> FrameRegistration:
    """Registers the frame.

    Raises InputError for a device without marks, and CalibrationError for touches that do not determine a frame, or
    that no right-handed tracker in metres with a rigid tool can have sent: what is wrong is named.
    """
    marks = device.marks
    if marks is None:
        raise InputError(
            f"device '{device.name}': its file has no [marks]; the dome alone leaves the frame's rotation free. "
            "Measure three places that the tip can stand in and add them"
        )
    doubts.enough(touched, marks.names)
    stands = [touched.marks[name] for name in marks.names]
    start = doubts.known_pivot(stands)
    doubts.known_scale(start.places, marks.positions)
    centre, radius, on = sphere(touched.dome.point(start.tip))
    doubts.known_marks(start.places, marks.positions, marks.names)
    R, t, _ = laid_onto(start.places, marks.positions)
    doubts.known_spread(touched.dome.point(start.tip), -R.T @ t)
    doubts.known_sphere(radius, on, device.dome_radius)
    doubts.known_hand(start.places, centre, marks.positions)
    doubts.known_centre(centre, -R.T @ t)
    roll = rolled(touched.roll)
    doubts.known_roll(roll)
    fit = _Fit(touched, marks.names, marks.positions, device.dome_radius, R, t, start.tip)
    fit.settle()
    outward = fit.x[: len(touched.dome)]
    along = np.einsum("ij,ij->i", touched.dome.R @ roll.axis, outward @ fit.R)
    axis = roll.axis if float(np.median(along)) > 0 else -roll.axis
    return _judged(fit, axis, roll.wobble, radius, device.tool.tip_distance)


@final
class _Fit:
    """Least squares over dome and marks together."""

    def __init__(
        self, touched: Touched, names: tuple[str, ...], known: Array, radius: float, R: Array, t: Array, tip: Array
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
        """(residuals [m], Jacobian) with turns times the dome's radius, so that all nine unknowns are lengths."""
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
        """Gauss–Newton to the end, then once more without the touches at which the tip was off the dome."""
        for _ in range(3):
            for _ in range(_STEPS):
                left, J = self.equations()
                step, *_ = np.linalg.lstsq(J, -left, rcond=None)
                turn = _turned(np.asarray(step[:3] / self.radius))
                self.R, self.t, self.tip = turn @ self.R, turn @ self.t + step[3:6], self.tip + step[6:]
                if np.abs(step).max() < _SETTLED:
                    break
            else:
                raise CalibrationError("the frame does not settle: touch dome and marks again, all of them")
            off = np.linalg.norm(self.x[: self.dome], axis=1) - self.radius
            scale = 1.4826 * float(np.median(np.abs(off - np.median(off))))
            before, self.on = self.on, np.abs(off) <= max(_LEFT_OUT * scale, _LEAST)
            if (self.on == before).all():
                return


def observable(J: Array, names: tuple[str, ...] = UNKNOWNS) -> tuple[float, tuple[str, ...]]:
    """(condition, what is not observable): directions of the unknowns that no equation of J (n, 9) sees, in words.

    >>> observable(np.eye(9)[:8])[1]
    ("tip along the body's z",)
    """
    _, s, Vt = np.linalg.svd(np.vstack([J, np.zeros((len(names), len(names)))]), full_matrices=False)
    free = Vt[s <= _FREE * s[0]]
    share = (free**2).sum(axis=0)
    unseen = tuple(name for name, part in zip(names, share, strict=True) if part > 0.3)
    return float(s[0] / s[-1]) if s[-1] > 0 else float("inf"), unseen


def _judged(fit: _Fit, axis: Array, wobble: float, radius: float, tip_distance: float) -> FrameRegistration:
    left, J = fit.equations()
    condition, unseen = observable(J)
    if unseen:
        raise CalibrationError(
            f"the touches leave open: {', '.join(unseen)}. Touch all marks, and the dome at more places with more tilt"
        )
    residual = float(np.sqrt((left**2).mean()))
    if residual > _LOOSE:
        raise CalibrationError(
            f"dome and marks are missed by {1e3 * residual:.1f} mm (rms): is the tool's body loose, does the tracker's "
            "own calibration hold here, were all marks touched in their middle?"
        )
    covariance = float(left @ left) / max(len(left) - 9, 1) * np.linalg.inv(J.T @ J)
    # what turns with the tool does not average out over its poses: the wobble counts whole
    turn = float(np.trace(covariance[:3, :3])) / fit.radius**2
    direction = float(np.sqrt(2.0 / 3.0 * turn + wobble**2))
    x = fit.x[: fit.dome][fit.on]
    seen = np.zeros((len(x), 3, 9))
    out = x + tip_distance * ((fit.R @ fit.Q[: fit.dome][fit.on]) @ axis)
    for k, unit in enumerate(np.eye(3)):
        seen[:, :, k] = np.cross(unit, out) / fit.radius
    seen[:, :, 3:6] = np.eye(3)
    seen[:, :, 6:] = fit.R @ fit.Q[: fit.dome][fit.on]
    spread = np.einsum("nij,jk,nik->n", seen, covariance, seen).mean()
    position = float(np.sqrt(spread + (tip_distance * wobble) ** 2))
    if position > _POSITION or direction > _DIRECTION:
        raise CalibrationError(
            f"the tool would be known to {1e3 * position:.1f} mm and {np.rad2deg(direction):.1f}° only; touch more "
            "places, tilt more, roll further, or still the tracker's noise"
        )
    return FrameRegistration(
        fit.R, fit.t, fit.tip, axis, residual, condition, position, direction, radius, wobble,
        int(fit.on.sum()) + len(fit.known), int((~fit.on).sum()),
    )  # fmt: skip


def _turned(w: Array) -> Array:
    """(3, 3) the rotation by the vector w [rad] (Rodrigues)."""
    angle = max(float(np.linalg.norm(w)), 1e-9)
    K = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    R: Array = np.eye(3) + np.sin(angle) / angle * K + (1 - np.cos(angle)) / angle**2 * K @ K
    return R
