"""What is wrong with a tracker whose poses do not fit: found by trying what people mix up, and said by name.

Every check raises CalibrationError with what was found, where, and what to do.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, permutations

import numpy as np

from haptorb.errors import CalibrationError
from haptorb.numerics.arrays import Array
from haptorb.sensing.frame.frame_start import Pivot, Roll, fit_points, pivot
from haptorb.sensing.frame.touches import Touches, TouchSession

__all__ = [
    "check_centre",
    "check_enough",
    "check_handedness",
    "check_marks",
    "check_pivot",
    "check_roll",
    "check_scale",
    "check_sphere",
    "check_spread",
]  # fmt: skip

LEAST_DOME, LEAST_MARK, LEAST_ROLL = 30, 8, 12  #: poses that differ, for a step to tell anything

_LOOSE = 2e-3  #: rms from which the poses are no tip's in marks; as a share of the marks' distances further on [m]
_TILT = np.sin(np.deg2rad(5.0))  #: rms tilt in the marks below which the tip is not determined
_SCALE = 0.02  #: metres are metres to this
_UNITS = {1e3: "millimetres", 1e2: "centimetres", 1 / 0.0254: "inches", 1 / 0.3048: "feet"}
_RADIUS = 1e-3  #: the dome's radius is that of the file, to this [m]
_LIFTED = 0.25  #: share of the touches on the dome that may not be on it
_APART = 4e-3  #: the centre by the dome and the centre by the marks agree to this; so do the marks with each other [m]
_SPREAD = np.deg2rad(35.0)  #: half angle that the touches on the dome must reach at least [rad]
_WOBBLE, _ROLLED = np.deg2rad(1.5), np.deg2rad(90.0)  #: [rad]


def check_enough(touched: TouchSession, names: Sequence[str]) -> None:
    """There are poses to work with, for every mark of `names`."""
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
    """The tip by the marks alone, if the poses are those of a rigid body about a tip."""
    found = pivot(stands)
    size = max(float(np.linalg.norm(found.places - found.places.mean(axis=0), axis=1).mean()), 1e-9)
    loose = _LOOSE * max(1.0, size / 0.03)  # in millimetres everything is a thousand times larger
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
    if found.weakest < _TILT:
        raise CalibrationError(
            f"in the marks the tool was tilted by no more than {np.rad2deg(np.arcsin(found.weakest)):.1f}° (rms, about "
            "the least of three axes): the tip's place in the body is not observable. Tilt by 20° or more to all "
            "sides, and roll the tool"
        )
    return found


def _list_misreadings(stands: Sequence[Touches]) -> dict[str, list[Array]]:
    """The quaternions as they would be meant if their order were mixed up."""
    first = [one.q[:, [1, 2, 3, 0]] for one in stands]
    return {
        "the quaternion's w came first (w x y z)": first,
        "the quaternion turned the other way (tracker into body)": [one.q * [-1, -1, -1, 1] for one in stands],
        "the quaternion's w came first and it turned the other way": [q * [-1, -1, -1, 1] for q in first],
    }


def check_scale(places: Array, known: Array) -> None:
    """The tracker speaks metres: by the distances between places and known marks (k, 3) [m], whichever is which."""

    def size(points: Array) -> float:
        return sum(float(np.linalg.norm(a - b)) for a, b in combinations(points, 2))

    scale = size(places) / size(known)
    if abs(scale - 1.0) <= _SCALE:  # safety: frame-scale
        return
    unit = next((f" {name}" for factor, name in _UNITS.items() if abs(scale / factor - 1.0) < 0.05), "")
    what = f"reports{unit}: " if unit else "is out of scale: "
    raise CalibrationError(
        f"the tracker {what}the marks appear {scale:.4g} times as far apart as they are. Poses must be in metres"
        + ("" if unit else "; calibrate the tracker, or check that all marks were touched")
    )


def check_sphere(radius: float, on: Array, known: float) -> None:
    """The dome of `radius` [m] is the file's of `known` [m], and most touches, on (n,), are on it."""
    if (share := 1.0 - float(on.mean())) > _LIFTED:
        raise CalibrationError(
            f"{100 * share:.0f} % of the touches on the dome are not on it: keep the tip on the dome, keep the side "
            "of the tool off it, and lift it only occasionally"
        )
    if abs(radius - known) > _RADIUS:
        raise CalibrationError(
            f"the touches on the dome lie on a sphere of {1e3 * radius:.1f} mm; the device's dome has {1e3 * known:g} "
            "mm. Check that it is this device, and that the tip touched the dome itself"
        )


def check_spread(points: Array, centre: Array) -> None:
    """The dome was touched at points (n, 3) [m] far apart, as seen from its centre (3,) [m]."""
    directions = (points - centre) / np.linalg.norm(points - centre, axis=1)[:, None]
    middle = directions.mean(axis=0)
    middle /= np.linalg.norm(middle)
    half = float(np.percentile(np.arccos(np.clip(directions @ middle, -1.0, 1.0)), 90))
    if half < _SPREAD:
        raise CalibrationError(
            f"the touches on the dome are all within {np.rad2deg(half):.0f}° of one point: the dome's centre is not "
            f"observable from there. Touch the whole dome, {np.rad2deg(_SPREAD):.0f}° or more to every side"
        )


def check_handedness(places: Array, centre: Array, known: Array) -> None:
    """The frame is right-handed: places (k, 3) and centre (3,) [m] lie as known (k, 3) and 0 do, and not mirrored."""
    found, wanted = np.vstack([places, centre]), np.vstack([known, np.zeros(3)])
    right, left = fit_points(found, wanted)[2], fit_points(found, wanted, mirrored=True)[2]
    if right > _APART / 2 and left < 0.3 * right:  # safety: left-handed
        raise CalibrationError(
            f"the tracker's frame is left-handed: the marks and the dome fit mirrored (rms {1e3 * left:.1f} mm) and "
            f"not as they are ({1e3 * right:.1f} mm). Switch its axes, or send −x with the quaternion x −y −z w"
        )


def check_marks(places: Array, known: Array, names: Sequence[str]) -> None:
    """Each of the places (k, 3) is that of the known mark (k, 3) [m] that was asked for."""
    rms = fit_points(places, known)[2]
    if rms <= _APART / 2:
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
    """Dome and marks tell of the same centre (3,) [m]."""
    if (apart := float(np.linalg.norm(by_dome - by_marks))) > _APART:
        raise CalibrationError(
            f"the dome's centre is {1e3 * apart:.1f} mm from its place by the marks: check that device and cameras "
            "did not move between the steps, and that no mark was missed"
        )


def check_roll(found: Roll) -> None:
    """The tool was turned far enough, about a fixed axis."""
    if found.angle < _ROLLED:
        raise CalibrationError(
            f"the tool was rolled by only {np.rad2deg(found.angle):.0f}°; its axis needs at least "
            f"{np.rad2deg(_ROLLED):.0f}°, better a full turn"
        )
    if found.wobble > _WOBBLE:
        raise CalibrationError(
            f"the tool's axis wobbled by {np.rad2deg(found.wobble):.1f}° (rms) while it was rolled: put it into a bore "
            "that fits and turn it there"
        )
