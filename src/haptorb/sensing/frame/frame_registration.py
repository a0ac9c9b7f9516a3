"""Where the device is in a tracker's frame, and the tool in its rigid body: from touches, by Gauss–Newton.

Unknown are the frame (R, t: 6) and the tip in the body (a: 3), x = R (P + Q a) + t. On the dome |x| = r, in mark k
x = x_k (`frame_fit`). Closed forms begin it, one for each step (`frame_start`), and what does not fit together is named
(`frame_doubts`). The tool's axis comes from the rolled tool by itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.errors import CalibrationError, InputError
from haptorb.numerics.arrays import Array
from haptorb.sensing.frame import frame_checks as doubts
from haptorb.sensing.frame.frame_fit import FrameFit, find_unobservable
from haptorb.sensing.frame.frame_start import find_roll, fit_points, sphere
from haptorb.sensing.frame.touches import TouchSession

__all__ = ["FrameRegistration", "frame_registration"]

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


def frame_registration(touched: TouchSession, device: SphericalElectromagnet) -> FrameRegistration:
    """Registers the frame.

    Raises InputError for a device without marks, and CalibrationError for touches that do not determine a frame, or
    that no right-handed tracker in metres with a rigid tool can have sent: what is wrong is named.
    """
    marks = device.marks
    if marks is None:
        raise InputError(
            f"device '{device.name}': its file has no [marks]; the dome alone leaves the frame's rotation free. "
            "Measure three points that can hold the tip, and add them"
        )
    doubts.check_enough(touched, marks.names)
    stands = [touched.marks[name] for name in marks.names]
    start = doubts.check_pivot(stands)
    doubts.check_scale(start.places, marks.positions)
    centre, radius, on = sphere(touched.dome.point(start.tip))
    doubts.check_marks(start.places, marks.positions, marks.names)
    R, t, _ = fit_points(start.places, marks.positions)
    doubts.check_spread(touched.dome.point(start.tip), -R.T @ t)
    doubts.check_sphere(radius, on, device.dome_radius)
    doubts.check_handedness(start.places, centre, marks.positions)
    doubts.check_centre(centre, -R.T @ t)
    roll = find_roll(touched.roll)
    doubts.check_roll(roll)
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
    if residual > _LOOSE:
        raise CalibrationError(
            f"the residual at dome and marks is {1e3 * residual:.1f} mm (rms): check that the tool's body is not "
            "loose, that the tracker's calibration is valid here, and that all marks were touched in their centre"
        )
    covariance = float(left @ left) / max(len(left) - 9, 1) * np.linalg.inv(J.T @ J)
    # what turns with the tool does not average out over its poses: the wobble counts whole
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
    if position > _POSITION or direction > _DIRECTION:
        raise CalibrationError(
            f"the expected accuracy is only {1e3 * position:.1f} mm and {np.rad2deg(direction):.1f}°; touch more "
            "points, tilt more, roll further, or reduce the tracker's noise"
        )
    return FrameRegistration(
        fit.R, fit.t, fit.tip, axis, residual, condition, position, direction, radius, wobble,
        int(fit.on.sum()) + len(fit.known), int((~fit.on).sum()),
    )  # fmt: skip
