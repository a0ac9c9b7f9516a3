"""One tick of the Hall tracker in one compiled pass: subtract the coils, fit, doubt, filter.

The parts stand in files of their own; they are strung together here because a call into compiled code costs as much as
the parts do. Everywhere, tracker is (1,) TRACKER, t its record, sensors (k,) SENSOR, and model what `pack_model` made.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from haptorb.numerics.arrays import Array, Record, Records
from haptorb.numerics.compiled import kernel
from haptorb.sensing.tool.place_filter import correct_pose, extrapolate_pose, predict
from haptorb.sensing.tool.tool_field import unpack_model
from haptorb.sensing.tool.tool_fit import fit_tool, weigh_moment

__all__ = [
    "LOCATED",
    "LOST",
    "REVERSED",
    "UNEXPLAINED",
    "UNREAD",
    "VAGUE",
    "filter_fit",
    "fit_anew",
    "follow_tool",
    "is_explained",
    "subtract_coils",
]  # fmt: skip

#: what came of a tick
LOCATED: Final = 0
UNEXPLAINED: Final = 1  #: no tool near the predicted place leaves such readings
LOST: Final = 2
REVERSED: Final = 3
UNREAD: Final = 4  #: a current is not a number, or a sensor has gone
VAGUE: Final = 5  #: what was read contradicts nothing and says too little, as while the currents jump

#: a last step below this leaves its square over 70 mm, 0.1 mm and 0.2°; typical noise makes half such steps
_NEAR, _TURN = 3e-3, 0.08
_MOST = 4  #: evaluations
_EXACT, _COLD = 1e-6, 40  #: last step of a fit from nothing [m, rad], and its evaluations at most
_MANY = 5.0  #: residuals so many times the sensors' noise are no noise
_SHARE = 0.01  #: of the coils' own field that calibration may leave unexplained
CALIBRATED = 1e-3  #: standard deviation of the moment map's entries after a calibration, of their column
_PAUSED = 0.05  #: without currents for so long the core's lag is over [s]
_OLD = 0.05  #: an older reading is useless: a sensor is missing [s]
_FRESH = 0.05  #: weight of a tick in the share of readings that are new
_VAGUE = 3e-3  #: standard deviation of the place above which it is not known [m]
_OUTWARD = -0.2  #: a tool whose axis points inwards by more than this cosine has its magnet the wrong way round


@kernel
def _pass_lag(t: Record, currents: Array, lagged: Array, taken: float) -> None:
    """lagged (m,) [A] advances by `currents` (m,) [A] at `taken` [s] through the core's lag."""
    passed = taken - t.lagged_at
    known = passed <= _PAUSED
    keep = np.exp(-passed / t.eddy_time) if passed > 0.0 and known else 1.0
    for j in range(currents.shape[0]):
        if not known or not np.isfinite(lagged[j]):
            lagged[j] = currents[j]
        else:
            lagged[j] = currents[j] + keep * (lagged[j] - currents[j])
    if passed > 0.0:
        t.lagged_at = taken


@kernel
def subtract_coils(
    tracker: Records, sensors: Records, model: Array, read: Array, currents: Array, lagged: Array, taken: float,
    now: float,
) -> bool:  # fmt: skip
    """The sensors' field = gain (read (k, 3) [T] − offsets − coils), where something was read, at `taken` [s]; their
    ages `now` [s], limit and weight for such currents (m,) [A]; False if a current is not a number or a reading too
    old. lagged (m,) [A]: the currents through the core's lag, as the last call left them."""
    t, known = tracker[0], unpack_model(model)
    total, oldest, new = 0.0, 0.0, 0
    _pass_lag(t, currents, lagged, taken)
    for k in range(sensors.size):
        sensor = sensors[k]
        if not sensor.used:
            continue
        for i in range(3):
            coils = 0.0
            for j in range(currents.shape[0]):
                coils += known.per_ampere[3 * k + i, j] * (currents[j] - t.eddy_share * (currents[j] - lagged[j]))
            total += coils * coils
            left = read[k, i] - sensor.offset[i] - coils
            if left - left == 0.0:  # a number
                sensor.left[i] = left
                sensor.taken[i] = taken
                new += 1
            age = now - sensor.taken[i]
            sensor.age[i] = age
            if not age <= oldest:
                oldest = age
        for i in range(3):
            sensor.field[i] = (
                sensor.gain[i, 0] * sensor.left[0]
                + sensor.gain[i, 1] * sensor.left[1]
                + sensor.gain[i, 2] * sensor.left[2]
            )
    t.share += _FRESH * (new / t.readings - t.share)
    if not (np.isfinite(total) and oldest <= _OLD):
        return False
    square = _MANY * _MANY * (t.noise * t.noise + t.swing * t.swing + t.lasting * t.lasting)
    share = max(_SHARE, 3.0 * t.coil_error)
    t.limit = np.sqrt(square + share * share * total / t.readings)
    weigh_moment(t, known.columns, currents, lagged, CALIBRATED)
    return True


@kernel
def _fill_rates(t: Record, R: Array) -> None:
    """The rates of t, from its filter: of the place, and of the turns about R's x and y."""
    f = t.filter
    n, r = f.axis, f.axis_rate
    wx, wy, wz = n[1] * r[2] - n[2] * r[1], n[2] * r[0] - n[0] * r[2], n[0] * r[1] - n[1] * r[0]
    for i in range(3):
        t.rates[i] = f.velocity[i]
    for j in range(2):
        t.rates[3 + j] = wx * R[0, j] + wy * R[1, j] + wz * R[2, j]


@kernel
def is_explained(misfit: float, readings: int, limit: float) -> bool:
    """Whether a misfit [T²] over so many readings may be noise and errors of the calibration."""
    return misfit <= (readings - 5) * limit * limit


@kernel
def _variance_share(t: Record) -> float:
    """Share of one set of readings' variance that the filter keeps; a reading that is used twice is no second."""
    return float(min(t.filter.variance / t.share, 1.0))


@kernel
def _find_doubt(t: Record, share: float, p: Array, R: Array) -> int:
    covariance = t.covariance
    if not share * (covariance[0, 0] + covariance[1, 1] + covariance[2, 2]) <= 3.0 * _VAGUE * _VAGUE:
        return VAGUE
    distance = np.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
    if not t.nearest < distance < t.furthest:
        return LOST
    if p[2] < distance * t.lowest:
        return LOST
    # A reversed magnet looks like one that is held upside down; a pen is not held by its tip.
    along = p[0] * R[0, 2] + p[1] * R[1, 2] + p[2] * R[2, 2]
    return REVERSED if along < _OUTWARD * distance else LOCATED


@kernel
def filter_fit(tracker: Records, misfit: float, readings: int, dt: float, pose: Array) -> int:
    """What the fit found, doubted and filtered: pose (6, 3) is R, p [m], and what becomes v [m/s] and w [rad/s].

    The covariance, per T² of the readings' variance, becomes that of the filtered pose; dt < 0: the filter restarts.
    """
    t, p, R = tracker[0], pose[3], pose[:3]
    restart, covariance = dt < 0.0, t.covariance
    square = misfit / max(readings - 5, 1)
    t.residual = np.sqrt(square)
    if not np.isfinite(square):
        return LOST
    t.misfit += (1.0 if restart else t.share) * (square - t.misfit)
    covariance *= max(t.noise * t.noise, t.misfit)
    why = _find_doubt(t, 1.0 if restart else _variance_share(t), p, R)
    if why == LOCATED:
        correct_pose(t.filter, dt, t.bandwidth, p, R, pose[4], pose[5])
        covariance *= _variance_share(t)
    return why


@kernel
def fit_anew(tracker: Records, sensors: Records, model: Array, p: Array, R: Array) -> tuple[bool, float]:
    """`fit_tool` from p (3,) [m] and R (3, 3), where nothing is known of a motion, to the last digit."""
    t = tracker[0]
    for i in range(5):
        t.rates[i] = 0.0
    return fit_tool(t, sensors, unpack_model(model).tool, _EXACT, _EXACT, _COLD, p, R)


@kernel
def follow_tool(
    tracker: Records, sensors: Records, model: Array, read: Array, currents: Array, lagged: Array, taken: float,
    now: float, dt: float, pose: Array,
) -> int:  # fmt: skip
    """From what was read (k, 3) [T] to the pose (6, 3) as in `filter_fit`, starting where the tool should be after `dt`
    [s]; for VAGUE it is what the filter alone expects.

    Arguments as in `subtract_coils`.
    """
    if not subtract_coils(tracker, sensors, model, read, currents, lagged, taken, now):
        return UNREAD
    t, R, p, readings = tracker[0], pose[:3], pose[3], tracker[0].readings
    predict(t.filter, dt, p, R)
    _fill_rates(t, R)
    found, misfit = fit_tool(t, sensors, unpack_model(model).tool, _NEAR, _TURN, _MOST, p, R)
    if not found or not is_explained(misfit, readings, t.limit):
        return UNEXPLAINED
    why = filter_fit(tracker, misfit, readings, dt, pose)
    if why == VAGUE:
        extrapolate_pose(t.filter, dt, p, R, pose[4], pose[5])
    return why
