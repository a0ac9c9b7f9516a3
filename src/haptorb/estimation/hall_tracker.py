"""Pose tracking by the field sensors alone, while the coils are driven: `--tracker hall`.

The field of coils and core follows from the measured currents and the calibration, and is subtracted; the remainder is
the field of the tool's magnet and the core's response to it. The estimate is the position and axis that fit it best;
the rotation about the axis is not observable with an axisymmetric magnet and is taken as zero.

The measured pose is filtered by an α–β filter: 100 Hz (−3 dB) at any loop rate, no lag of the position at constant
velocity, 7 ms lag of the velocity.

If a driver reads the sensors in turn, those not read in a tick are NaN. The last reading of each is used instead, minus
the coils' field at its time of measurement (`CurrentHistory`), and compared with the tool's pose at that time, by its
velocity.

A tick whose readings are consistent but not informative enough is skipped: for up to 10 ms the tool's pose is
extrapolated, and the estimate's age grows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from haptorb.arrays import (
    Array,
    Record,
    Records,
    StateArray,
    Stateful,
    check_finite,
    choose,
    fields,
    make_block,
    make_numbers,
    state_zeros,
)
from haptorb.compiled import kernel
from haptorb.devices.base import State, WrenchMap, rotation_to_axis
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.electromagnet_wrench_map import axis_frame
from haptorb.errors import GeometryError, InputError
from haptorb.estimation.controller_model import ControllerModel
from haptorb.estimation.hall_pose_fit import (
    ToolModel,
    coil_field,
    fit_tool,
    moment_field,
    pack_model,
    tool_field,
    unpack_model,
    weigh_moment,
)
from haptorb.estimation.types import (
    Estimate,
    Estimator,
    KeptEstimate,
    Sample,
)

__all__ = [
    "FILTER",
    "IN_TURNS",
    "LOCATED",
    "LOST",
    "REVERSED",
    "SENSOR",
    "TRACKER",
    "UNEXPLAINED",
    "UNREAD",
    "VAGUE",
    "CurrentHistory",
    "HallTracker",
    "coil_error",
    "correct_pose",
    "extrapolate_pose",
    "filter_fit",
    "fit_anew",
    "follow_tool",
    "is_explained",
    "make_sensors",
    "make_tracker",
    "memory",
    "noise_share",
    "predict",
    "subtract_coils",
]


# --------------------------------------------------------------------------------------------------
# α–β filter of a position and an axis: specified bandwidth at any sampling rate, without lag at constant velocity.
#
# Position and axis are predicted with their rates and corrected by α = 1 − θ², the rates by β/dt, β = (1 − θ)²:
# critically damped, one pole θ for both. The measured pose becomes the reported one through
#
#     H(z) = (1 − θ) z ((1 + θ) z − 2θ)/(z − θ)²,     |H|² = (1 − θ)² ((1 + θ)² + 4θ² − 4θ(1 + θ) c)/(1 + θ² − 2θ c)²
#
# with c = cos(2π f dt), and θ is chosen in every tick so that |H|² = 1/2 at the bandwidth, whatever dt is. H is 1 at
# DC and its group delay there is zero: a position in steady motion has no lag. The cost: below the bandwidth |H| rises
# to 1.11, so that a step response overshoots by 14 %, and white noise retains 0.55 of its standard deviation at 100 Hz
# and 1 kHz, where an ideal filter of 100 Hz, with infinite delay, would retain 0.45. The rates lag by twice the
# filter's time constant, 2 dt θ/(1 − θ), and half a tick. A loop slower than twice the bandwidth is not filtered: θ is
# 0.


#: State of the filter, and its response to white noise of variance 1 in the readings.
FILTER = fields(
    ("place", "f8", (3,)),  # [m]
    ("axis", "f8", (3,)),  # of the tool, a unit vector
    ("velocity", "f8", (3,)),  # of the place [m/s]
    ("axis_rate", "f8", (3,)),  # at which the axis changes [1/s]
    ("variance", "f8"),  # of the place
    ("covariance", "f8"),  # of place and rate [1/s]
    ("rate_variance", "f8"),  # of the rate [1/s²]
)


@kernel
def memory(turn: float) -> float:
    """Pole θ of the filter with a gain of −3 dB at the frequency at which a signal turns by `turn` [rad] per tick.

    0 (no filter) above half a turn: such a signal is above the Nyquist frequency.

    >>> round(memory(2 * math.pi * 0.1), 3), memory(math.pi), round(memory(1e-3) / math.exp(-1e-3 / 2.482), 6)
    (0.764, 0.0, 1.0)
    """
    if not turn < math.pi:
        return 0.0
    c = math.cos(turn)
    low, high = 0.0, 1.0
    for _ in range(26):
        t = 0.5 * (low + high)
        above = (1.0 - t) * (1.0 - t) * ((1.0 + t) * (1.0 + t) + 4.0 * t * t - 4.0 * t * (1.0 + t) * c)
        below = 1.0 + t * t - 2.0 * t * c
        if 2.0 * above > below * below:
            low = t
        else:
            high = t
    return low


def noise_share(bandwidth: float = 100.0, rate: float = 1000.0) -> float:
    """Ratio of output to input standard deviation for white noise [1], at `bandwidth` and `rate` [Hz].

    From the variance of an α–β filter: (2α² + 2β − 3αβ)/(α (4 − 2α − β)).

    >>> round(noise_share(), 3), noise_share(100.0, 150.0)
    (0.547, 1.0)
    """
    theta = memory(2 * math.pi * bandwidth / rate)
    alpha, beta = 1 - theta**2, (1 - theta) ** 2
    return math.sqrt((2 * alpha**2 + 2 * beta - 3 * alpha * beta) / (alpha * (4 - 2 * alpha - beta)))


@kernel
def predict(f: Record, dt: float, p: Array, R: Array) -> None:
    """Predict position p (3,) [m] and axis, R's third column, `dt` [s] after the state of filter f."""
    axis = np.empty(3)
    size = 0.0
    for i in range(3):
        p[i] = f.place[i] + dt * f.velocity[i]
        axis[i] = f.axis[i] + dt * f.axis_rate[i]
        size += axis[i] * axis[i]
    for i in range(3):
        axis[i] /= np.sqrt(size)
    axis_frame(axis, R)


@kernel
def _fill_angular_velocity(n: Array, rate: Array, w: Array) -> None:
    """w (3,) [rad/s] of an axis n with the time derivative `rate` [1/s]."""
    w[0], w[1], w[2] = n[1] * rate[2] - n[2] * rate[1], n[2] * rate[0] - n[0] * rate[2], n[0] * rate[1] - n[1] * rate[0]


@kernel
def extrapolate_pose(f: Record, dt: float, p: Array, R: Array, v: Array, w: Array) -> None:
    """Output `dt` [s] after f without a measurement: p [m], R, v [m/s] and w [rad/s]."""
    predict(f, dt, p, R)
    for i in range(3):
        v[i] = f.velocity[i]
    _fill_angular_velocity(f.axis, f.axis_rate, w)


@kernel
def correct_pose(f: Record, dt: float, bandwidth: float, p: Array, R: Array, v: Array, w: Array) -> None:
    """One filter step; p [m] and R are measured on input and filtered on output, v [m/s] and w [rad/s] are outputs.

    dt ≤ 0: restart.
    """
    alpha, slope = 1.0, 0.0
    if dt > 0.0:
        theta = memory(2.0 * math.pi * bandwidth * dt)
        alpha, slope = 1.0 - theta * theta, (1.0 - theta) * (1.0 - theta) / dt
    else:
        for i in range(3):
            f.velocity[i], f.axis_rate[i] = 0.0, 0.0
            f.place[i], f.axis[i] = p[i], R[i, 2]
        f.variance, f.covariance, f.rate_variance = 0.0, 0.0, 0.0
        dt = 0.0
    both = f.covariance + dt * f.rate_variance
    place = f.variance + dt * (f.covariance + both)
    f.variance = (1.0 - alpha) * (1.0 - alpha) * place + alpha * alpha
    f.covariance = (1.0 - alpha) * (both - slope * place) + alpha * slope
    f.rate_variance += slope * (slope * (place + 1.0) - 2.0 * both)
    size, along = 0.0, 0.0
    for i in range(3):
        ahead = f.place[i] + dt * f.velocity[i]
        error = p[i] - ahead
        f.place[i] = ahead + alpha * error
        f.velocity[i] += slope * error
        ahead = f.axis[i] + dt * f.axis_rate[i]
        error = R[i, 2] - ahead
        f.axis[i] = ahead + alpha * error
        f.axis_rate[i] += slope * error
        size += f.axis[i] * f.axis[i]
    for i in range(3):
        f.axis[i] /= np.sqrt(size)
        along += f.axis[i] * f.axis_rate[i]
    for i in range(3):
        f.axis_rate[i] -= along * f.axis[i]  # the rate of a unit vector is orthogonal to it
        p[i] = f.place[i]
        v[i] = f.velocity[i]
    _fill_angular_velocity(f.axis, f.axis_rate, w)
    axis_frame(f.axis, R)


# --------------------------------------------------------------------------------------------------
# One tick of the Hall tracker in one compiled pass: subtract the coils' field, fit, validate, filter.
#
# The steps are combined here because a call into compiled code costs as much as the steps themselves. Everywhere,
# tracker is (1,) TRACKER, t its record, sensors (k,) SENSOR, and model the result of `pack_model`.


#: status of a tick
LOCATED: Final = 0
UNEXPLAINED: Final = 1  #: no tool near the predicted position explains the readings
LOST: Final = 2
REVERSED: Final = 3
UNREAD: Final = 4  #: a current is not a number, or a sensor is missing
VAGUE: Final = 5  #: the readings are consistent but not informative enough, as while the currents change quickly

#: convergence: the remaining error is this squared over 70 mm, 0.1 mm and 0.2°; typical noise makes half such steps
_NEAR, _TURN = 3e-3, 0.08
_MAX_EVALUATIONS = 4  #: per tick
#: convergence of a cold start [m, rad], and its maximum number of evaluations
_COLD_START_TOLERANCE, _COLD_START_EVALUATIONS = 1e-6, 40
_OUTLIER_SIGMAS = 5.0  #: outlier threshold, in standard deviations of the sensors' noise
_COIL_CALIBRATION_ERROR = 0.01  #: calibration error of the coils' own field, as a share
CALIBRATED = 1e-3  #: relative standard deviation of the moment map's entries after a calibration
_LAG_DECAY_S = 0.05  #: time without currents after which the core's lag has decayed [s]
_MAX_READING_AGE_S = 0.05  #: age above which a reading is discarded: a sensor is missing [s]
_NEW_SHARE_WEIGHT = 0.05  #: weight of a tick in the average share of new readings
_MAX_POSITION_SIGMA_M = 3e-3  #: standard deviation of the position above which it is unknown [m]
_REVERSED_COSINE = -0.2  #: cosine between axis and radius below which the magnet counts as reversed


@kernel
def _pass_lag(t: Record, currents: Array, lagged: Array, taken: float) -> None:
    """Advance lagged (m,) [A], the currents filtered by the core's lag, to `currents` (m,) [A] at `taken` [s]."""
    passed = taken - t.lagged_at
    known = passed <= _LAG_DECAY_S
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
    """Sensor fields = gain (read (k, 3) [T] − offsets − coils), where there is a reading, at `taken` [s]; their
    ages `now` [s], limit and weight for such currents (m,) [A]; False if a current is not a number or a reading is too
    old. lagged (m,) [A]: the currents filtered by the core's lag, updated from the last call."""
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
            if left - left == 0.0:  # finite
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
    t.share += _NEW_SHARE_WEIGHT * (new / t.readings - t.share)
    if not (np.isfinite(total) and oldest <= _MAX_READING_AGE_S):
        return False
    square = _OUTLIER_SIGMAS * _OUTLIER_SIGMAS * (t.noise * t.noise + t.swing * t.swing + t.lasting * t.lasting)
    share = max(_COIL_CALIBRATION_ERROR, 3.0 * t.coil_error)
    t.limit = np.sqrt(square + share * share * total / t.readings)
    weigh_moment(t, known.columns, currents, lagged, CALIBRATED)
    return True


@kernel
def _fill_rates(t: Record, R: Array) -> None:
    """Fill the rates of t from its filter: of the position, and of the rotations about R's x and y."""
    f = t.filter
    n, r = f.axis, f.axis_rate
    wx, wy, wz = n[1] * r[2] - n[2] * r[1], n[2] * r[0] - n[0] * r[2], n[0] * r[1] - n[1] * r[0]
    for i in range(3):
        t.rates[i] = f.velocity[i]
    for j in range(2):
        t.rates[3 + j] = wx * R[0, j] + wy * R[1, j] + wz * R[2, j]


@kernel
def is_explained(misfit: float, readings: int, limit: float) -> bool:
    """Whether noise and calibration errors explain a misfit [T²] over so many readings."""
    return misfit <= (readings - 5) * limit * limit


@kernel
def _variance_share(t: Record) -> float:
    """Ratio of output to input variance of the filter for one set of readings; repeated readings count once."""
    return float(min(t.filter.variance / t.share, 1.0))


@kernel
def _classify_fit(t: Record, share: float, p: Array, R: Array) -> int:
    covariance = t.covariance
    if (
        not share * (covariance[0, 0] + covariance[1, 1] + covariance[2, 2])
        <= 3.0 * _MAX_POSITION_SIGMA_M * _MAX_POSITION_SIGMA_M
    ):
        return VAGUE
    distance = np.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
    if not t.nearest < distance < t.furthest:
        return LOST
    if p[2] < distance * t.lowest:
        return LOST
    # A reversed magnet is indistinguishable from an inverted pen; a pen is not held by its tip.
    along = p[0] * R[0, 2] + p[1] * R[1, 2] + p[2] * R[2, 2]
    return REVERSED if along < _REVERSED_COSINE * distance else LOCATED


@kernel
def filter_fit(tracker: Records, misfit: float, readings: int, dt: float, pose: Array) -> int:
    """Validate and filter the result of a fit: pose (6, 3) is R, p [m], and receives v [m/s] and w [rad/s].

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
    why = _classify_fit(t, 1.0 if restart else _variance_share(t), p, R)
    if why == LOCATED:
        correct_pose(t.filter, dt, t.bandwidth, p, R, pose[4], pose[5])
        covariance *= _variance_share(t)
    return why


@kernel
def fit_anew(tracker: Records, sensors: Records, model: Array, p: Array, R: Array) -> tuple[bool, float]:
    """`fit_tool` from p (3,) [m] and R (3, 3) without prior motion, to full convergence."""
    t = tracker[0]
    for i in range(5):
        t.rates[i] = 0.0
    return fit_tool(
        t,
        sensors,
        unpack_model(model).tool,
        _COLD_START_TOLERANCE,
        _COLD_START_TOLERANCE,
        _COLD_START_EVALUATIONS,
        p,
        R,
    )


@kernel
def follow_tool(
    tracker: Records, sensors: Records, model: Array, read: Array, currents: Array, lagged: Array, taken: float,
    now: float, dt: float, pose: Array,
) -> int:  # fmt: skip
    """Pose (6, 3) as in `filter_fit` from the readings (k, 3) [T], starting at the prediction after `dt` [s];
    for VAGUE it is the filter's prediction alone.

    Arguments as in `subtract_coils`.
    """
    if not subtract_coils(tracker, sensors, model, read, currents, lagged, taken, now):
        return UNREAD
    t, R, p, readings = tracker[0], pose[:3], pose[3], tracker[0].readings
    predict(t.filter, dt, p, R)
    _fill_rates(t, R)
    found, misfit = fit_tool(t, sensors, unpack_model(model).tool, _NEAR, _TURN, _MAX_EVALUATIONS, p, R)
    if not found or not is_explained(misfit, readings, t.limit):
        return UNEXPLAINED
    why = filter_fit(tracker, misfit, readings, dt, pose)
    if why == VAGUE:
        extrapolate_pose(t.filter, dt, p, R, pose[4], pose[5])
    return why


# --------------------------------------------------------------------------------------------------
# State of the Hall tracker between two ticks, with its settings: two structured arrays.
#
# `TRACKER` has the state that exists once, in an array of one record; `SENSOR` has one record per field sensor (k).


_SHELL_MARGIN_M = 15e-3  #: margin outside the shell within which a tool's position is valid [m]

#: One record.
TRACKER = fields(
    # settings
    ("noise", "f8"),  # of one reading [T]
    ("bandwidth", "f8"),  # of place and axis [Hz]
    ("nearest", "f8"),  # distance from the centre below which a tool's position is invalid [m]
    ("furthest", "f8"),  # distance from the centre above which a tool's position is invalid [m]
    ("lowest", "f8"),  # cosine of the largest polar angle
    ("readings", "i8"),  # number of axes of the sensors in use
    ("lasting", "f8"),  # standard deviation of the constant error in a reading of the tool [T]
    ("coil_error", "f8"),  # calibration error of the coils' own field, as a share
    ("eddy_share", "f8"),  # lagging share of the currents' moment
    ("eddy_time", "f8"),  # time constant of the lag [s]
    ("eddy_doubt", "f8"),  # standard deviation of that share
    ("remanent", "f8"),  # remanent moment of the core, standard deviation per axis [A·m²]
    ("coupling", "f8", (3, 3)),  # UᵀU, U the field of unit moments at all sensors [T²/(A²·m⁴)]
    # this tick
    ("moment_noise", "f8", (3, 3)),  # covariance of the moment from the currents' noise [A²·m⁴]
    ("swing", "f8"),  # error of the field from quickly changing currents [T]
    ("limit", "f8"),  # limit on the residual [T]
    ("weight", "f8", (3, 3)),  # G of `hall_pose_fit.fit_tool`: covariance of the moment [A²·m⁴/T²]
    ("rates", "f8", (5,)),  # of the position [m/s] and of the rotations about the mover's x and y [rad/s]
    # state
    ("lagged_at", "f8"),  # time of the last currents filtered by the lag [s]
    ("share", "f8"),  # average share of new readings in a tick
    ("residual", "f8"),  # rms residual of the last fit [T]
    ("misfit", "f8"),  # its square, averaged [T²]
    ("covariance", "f8", (5, 5)),  # of the last fit: position [m²], rotations about two axes across the tool's [rad²]
    ("filter", FILTER),
)

#: One record per field sensor: its last reading of the tool alone, and its calibration.
SENSOR = fields(
    ("used", "?"),  # False: it has failed and is excluded
    ("offset", "f8", (3,)),  # at zero current without a tool [T]
    ("gain", "f8", (3, 3)),  # field per reading
    ("per_moment", "f8", (3, 3)),  # field per moment along x, y, z of the electromagnet [T/(A·m²)]
    ("left", "f8", (3,)),  # reading minus offset and coils, in the sensor's axes [T]
    ("field", "f8", (3,)),  # of tool and core alone [T]
    ("taken", "f8", (3,)),  # time of that reading, per axis [s]; -inf before the first reading
    ("age", "f8", (3,)),  # its age [s]
)


def make_tracker(device: SphericalElectromagnet, noise: float, bandwidth: float, lasting: float) -> Records:
    """(1,) TRACKER for `device`, whose readings have `noise` and `lasting` errors [T]: before the first fix."""
    made = state_zeros(1, TRACKER)
    made["noise"], made["bandwidth"], made["share"] = noise, bandwidth, 1.0
    made["nearest"] = device.contact_distance - _SHELL_MARGIN_M
    made["furthest"] = device.contact_distance + device.shell_thickness + _SHELL_MARGIN_M
    made["lowest"] = math.cos(min(device.workspace_half_angle + math.radians(30), math.pi))
    used = _find_used(device)
    made["readings"], made["lasting"] = 3 * int(used.sum()), lasting
    made["coil_error"] = 0.0 if device.hall.correction is not None else coil_error(device)
    core = device.core_dynamics
    made["eddy_share"], made["eddy_time"] = core.eddy_share, core.eddy_time
    made["eddy_doubt"], made["remanent"] = core.spread * core.eddy_share, core.remanent_moment
    made["lagged_at"] = -math.inf
    per_moment = moment_field(device) * used[:, None, None]
    made["coupling"] = np.einsum("kia,kib->ab", per_moment, per_moment)
    made["residual"] = math.inf
    made["covariance"] = math.inf
    return made


def make_sensors(device: SphericalElectromagnet, offsets: Array) -> Records:
    """(k,) SENSOR for `device` with `offsets` (k, 3) [T]: before the first reading."""
    made = state_zeros(device.sensors, SENSOR)
    correction = device.hall.correction
    made["used"], made["per_moment"] = _find_used(device), moment_field(device)
    made["offset"], made["gain"] = offsets, np.eye(3) if correction is None else correction.gain
    made["left"] = made["field"] = made["taken"] = made["age"] = -math.inf
    made["field"][~made["used"]] = 0.0
    return made


def coil_error(device: SphericalElectromagnet) -> float:
    """Residual of the coils' field in a reading of uncalibrated sensors, standard deviation as a share.

    >>> from haptorb.devices.loader import load
    >>> 0.01 < coil_error(load("omni")) < 0.03
    True
    """
    errors, at = device.hall.errors, np.linalg.norm(device.hall.positions.reshape(-1, 3), axis=1)
    # a dipole's field falls with the cube of the distance
    far = 3 * errors.placement / float(at.mean()) if len(at) else 0.0
    return math.sqrt(errors.gain**2 + 2 * errors.cross**2 + 2 * errors.angle**2 + far**2)


def _find_used(device: SphericalElectromagnet) -> NDArray[np.bool_]:
    """(k,) sensors that have not failed."""
    correction = device.hall.correction
    return np.ones(device.sensors, dtype=np.bool_) if correction is None else correction.used


# --------------------------------------------------------------------------------------------------
# Interpolation of the currents to the time of a field reading, for boards that measure them at different times.
#
# The coils' own field is ten times the tool's, and an error of 0.1 A appears as a millimetre. Currents that change by
# an ampere in ten milliseconds must be known to a tenth of a millisecond, and a current sensor reports the mean over
# half a millisecond that ended at some time in the last half. Extrapolation from the last two of them doubles such
# errors; interpolation between the measurements before and after the field reading makes them smaller than those of
# either. So a field reading is delayed by a tick, until the next currents.


#: buffer length: a field waits on the board while newer ones of other sensors are reported, for 7 ms and more
_LENGTH = 16
_MIN_CURRENT_SPACING_S = 0.2e-3  #: minimum spacing of two current measurements [s]
_MAX_CURRENT_GAP_S = 0.05  #: gap between two of them, above which currents between are unknown [s]
_MAX_EXTRAPOLATION = 0.3  #: extrapolation limit, relative to the interval between two measurements
_CURRENT_TIME_SIGMA_S = 0.15e-3  #: standard deviation of the time of a current measurement [s]
_RECENT_CHANGE_S = 0.01  #: time after a change of the currents during which readings in use are affected [s]


@final
class CurrentHistory(Stateful):
    """Pairs each field with the currents (m,) [A] at its time of measurement.

    field     (k, 3) [T] emitted by the last `take`; NaN where there is none
    taken     when that was read [s]
    currents  (m,) [A] at that time
    doubt     (m,) [A] uncertainty of these, and of those of the readings of the last 10 ms
    """

    def __init__(self, channels: int, sensors: int) -> None:
        self._times, self._values = state_zeros(_LENGTH), state_zeros((_LENGTH, channels))
        self._times[:] = -math.inf
        self._nothing: Array = np.full((sensors, 3), np.nan)
        self._waiting, self._waiting_since = self._nothing, -math.inf
        self.field, self.taken = self._nothing, -math.inf
        self.currents: Array = np.zeros(channels)
        self.doubt: Array = np.zeros(channels)
        self._kept, self._cells = make_block(
            {"waiting": (sensors, 3), "field": (sensors, 3), "currents": (channels,), "doubt": (channels,)},
            moments=("waiting_since", "taken"),
        )

    def state_arrays(self) -> Mapping[str, StateArray]:
        """Measured currents [A] with their times [s]; pending and last emitted fields [T], with their times [s]."""
        return {"times": self._times, "values": self._values, **self._kept}

    def gather_state(self) -> None:
        """Copy currents, fields and times into the state arrays."""
        kept, cells = self._kept, self._cells
        kept["waiting"][:], kept["field"][:] = self._waiting, self.field
        kept["currents"][:], kept["doubt"][:] = self.currents, self.doubt
        cells[0], cells[1] = self._waiting_since, self.taken

    def apply_state(self) -> None:
        """Restore currents, fields and times from the state arrays."""
        kept = self._kept
        self._waiting, self.field = kept["waiting"].copy(), kept["field"].copy()
        self.currents, self.doubt = kept["currents"].copy(), kept["doubt"].copy()
        self._waiting_since, self.taken = self._cells

    def append(self, sample: Sample) -> None:
        """Add a sample. Its field is emitted with the next sample that has newer currents, or discarded."""
        at = sample.t - sample.currents_age
        newer = at - self._times[-1]
        self.field = self._nothing
        if -_MAX_CURRENT_GAP_S <= newer < _MIN_CURRENT_SPACING_S:  # repeated measurement, as after a lost reply
            return
        if not 0.0 <= newer <= _MAX_CURRENT_GAP_S:
            self._times[:] = -math.inf
        self._times[:-1], self._values[:-1] = self._times[1:], self._values[1:]
        self._times[-1], self._values[-1] = at, sample.currents
        if np.isfinite(self._times[-2]):
            self._release(self._times[-1] - self._times[-2])
        self._waiting, self._waiting_since = sample.field, sample.t - sample.field_age

    def _release(self, newer: float) -> None:
        """Emit the pending field if its time is near enough to a measured current."""
        when, times, values = self._waiting_since, self._times, self._values
        first = -2
        while when < times[first] and first > -_LENGTH and math.isfinite(times[first - 1]):
            first -= 1
        step, change = float(times[first + 1] - times[first]), values[first + 1] - values[first]
        share = (when - float(times[first])) / step
        self.doubt = np.maximum(
            _CURRENT_TIME_SIGMA_S / step * np.abs(change), math.exp(-newer / _RECENT_CHANGE_S) * self.doubt
        )
        if -_MAX_EXTRAPOLATION <= share <= 1.0 + _MAX_EXTRAPOLATION:
            self.field, self.taken = self._waiting, when
            self.currents = values[first] + share * change


#: bandwidth [Hz] for drivers that read the sensors in turn, six ticks for all: a larger one passes only more noise
IN_TURNS = 30.0

_MAX_SAMPLE_GAP_S = 0.05  #: gap without a sample after which the velocity is stale [s]
#: maximum extrapolation of the tool's motion while the readings are not informative enough [s]
_MAX_EXTRAPOLATION_S = 0.01
_VERDICTS = ("", "lost", "reversed")
_SEARCH_INTERVAL_S = 0.02  #: interval between two cold starts [s]: one takes longer than a tick


class HallTracker(Estimator):
    """Pose from the field sensors; the sample's `pose` is ignored.

    device     a spherical electromagnet with at least two field sensors
    model      of the device, for the wrench map; None: its first
    offsets    (k, 3) [T] of the sensors at zero current without a tool, as calibration found them
    bandwidth  of place and axis [Hz]

    `verdict` states why an estimate is not valid: "lost", "reversed" (the tool's magnet is reversed: forces would
    invert), or "" if it is valid.

    Raises InputError for a device without such sensors, and for an invalid bandwidth or offsets.

    >>> from haptorb.devices.loader import load
    >>> HallTracker(load("omni")).verdict
    'lost'
    """

    state_kind = "hall"
    LOST: Final = "lost"
    REVERSED: Final = "reversed"

    def __init__(
        self,
        device: SphericalElectromagnet,
        model: str | None = None,
        *,
        offsets: ArrayLike | None = None,
        bandwidth: float = 100.0,
    ) -> None:
        if device.shell is None or device.sensors < 2:
            raise InputError(
                f"device '{device.name}': locating a tool needs at least two field sensors of a spherical "
                "electromagnet; "
                "use another tracker"
            )
        if not 1.0 <= bandwidth <= 1000.0:
            raise InputError(f"bandwidth must be between 1 and 1000 Hz; got {bandwidth!r}")
        correction = device.hall.correction
        if correction is not None:
            offsets = correction.offset
            if int(correction.used.sum()) < 2:
                raise InputError(
                    f"device '{device.name}': fewer than two field sensors work; repair them and calibrate again, or "
                    "use another tracker"
                )
        zero = np.zeros((device.sensors, 3)) if offsets is None else check_finite(offsets, "offsets")
        if zero.shape != (device.sensors, 3):
            raise InputError(f"offsets must have shape ({device.sensors}, 3); got {zero.shape}")
        self._device = device
        self._controller_model = ControllerModel(device, model)
        self._shape, tool = (device.sensors, 3), ToolModel.of(device)
        self._model, self._grid = pack_model(device, tool), _grid(device)
        self._fields = _fields_at(tool, self._grid)
        self.bandwidth: Final = float(bandwidth)
        hall, supply = device.hall, device.supply
        self._moments = np.array(device.moment_per_current, dtype=np.float64)
        self._per_ampere_rms = np.sqrt((coil_field(device) ** 2).mean(axis=(0, 1)))
        self._read = (supply.current_noise**2 + supply.current_step**2 / 12) * (self._moments @ self._moments.T)
        self._history = CurrentHistory(device.channels, device.sensors)
        self.noise = float(np.hypot(max(hall.noise, 1e-7), hall.step / np.sqrt(12)))  #: of one reading [T]
        if correction is None:
            lasting = 0.0 if offsets is not None else device.hall.errors.offset
        else:
            lasting = correction.uncertainty
        self._tracker = make_tracker(device, self.noise, self.bandwidth, lasting)
        self._sensors = make_sensors(device, zero)
        self._lagged = state_zeros(device.channels)  # currents filtered by the core's lag
        self._lagged[:] = np.nan
        self._fields *= np.repeat(self._sensors["used"], 3)
        self._filter = self._tracker["filter"]
        self._moment_noise: Array = self._tracker["moment_noise"][0]
        self._moment_noise[:] = self._read
        #: (5, 5) of the last fit, noise only: position [m²], rotations about two axes across the tool's [rad²]
        self.covariance: Array = self._tracker["covariance"][0]
        self.verdict: str = self.LOST
        self._found, self._t, self._searched = False, -math.inf, -math.inf
        nowhere = State(0.0, np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3))
        self._last = Estimate(nowhere, WrenchMap(np.zeros((6, device.channels)), np.zeros(6)), False, math.inf)
        self._kept = KeptEstimate(device.channels)
        self._numbers = make_numbers("verdict", "found", "t", "searched")

    def state_arrays(self) -> Mapping[str, StateArray]:
        """Filter, sensors, lagged currents [A], the last estimate, and the state of the search."""
        own = {"tracker": self._tracker, "sensors": self._sensors, "lagged": self._lagged, "search": self._numbers[0]}
        return {**own, **self._kept.arrays}

    def state_parts(self) -> Mapping[str, Stateful]:
        """Current history and controller model."""
        return {"history": self._history, "model": self._controller_model}

    def gather_state(self) -> None:
        """Copy the last estimate."""
        self._kept.store(self._last)
        cells = self._numbers[1]
        cells[0], cells[1], cells[2], cells[3] = (
            _VERDICTS.index(self.verdict), self._found, self._t, self._searched
        )  # fmt: skip

    def apply_state(self) -> None:
        """Restore the last estimate."""
        self._last = self._kept.load()
        verdict, found, self._t, self._searched = self._numbers[1]
        self.verdict, self._found = _VERDICTS[choose(verdict, len(_VERDICTS))], bool(found)

    @property
    def residual(self) -> float:
        """rms residual of the last estimate [T]."""
        return float(self._tracker["residual"][0])

    def update(self, sample: Sample) -> Estimate:
        """Return the estimate after `sample`. Raises InputError if the number of sensors is not the device's."""
        read = np.ascontiguousarray(sample.field)
        if read.shape != self._shape:
            raise InputError(
                f"device '{self._device.name}' has {self._device.sensors} field sensors; the sample has {read.shape[0]}"
            )
        currents, taken = sample.currents, sample.t - sample.field_age
        if sample.currents_age != sample.field_age:  # of a board; a simulated device measures both at the same time
            read, currents, taken = self._match_currents(sample)
        tracker, sensors, model, pose = self._tracker, self._sensors, self._model, np.empty((6, 3))
        if self._found:
            dt = sample.t - self._t
            if not 0.0 <= dt <= _MAX_SAMPLE_GAP_S:
                self._filter["velocity"] = self._filter["axis_rate"] = 0.0
                dt = 0.0
            code = follow_tool(tracker, sensors, model, read, currents, self._lagged, taken, sample.t, dt, pose)
        else:  # readings without the coils' field; the position is not known yet
            whole = subtract_coils(tracker, sensors, model, read, currents, self._lagged, taken, sample.t)
            code = UNEXPLAINED if whole else UNREAD
        if code == UNEXPLAINED:
            self._found = False
            if sample.t - self._searched < _SEARCH_INTERVAL_S:
                return self._unknown(sample.t, self.verdict or self.LOST)
            self._searched = sample.t
            code = self._search(pose)
        unsure = code == VAGUE and self._found and sample.t - self._t <= _MAX_EXTRAPOLATION_S  # safety: tool-carried
        if not (code == LOCATED or unsure):
            self._found = self._found and code == UNREAD
            return self._unknown(sample.t, self.REVERSED if code == REVERSED else self.LOST)
        state = State(sample.t, pose[:3], pose[3], pose[5], pose[4])
        try:
            wrench_map = self._controller_model.wrench_map(state)
        except GeometryError:
            self._found = False
            return self._unknown(sample.t, self.LOST)
        if not unsure:
            self._t = sample.t
        self._found, self.verdict = True, ""
        self._last = Estimate(state, wrench_map, True, sample.t - self._t)
        return self._last

    @property
    def remark(self) -> str:
        """Warning about sensors with errors and without calibration."""
        errors, name = self._device.hall.errors, self._device.name
        if self._device.hall.correction is not None or not (errors.offset or errors.gain or errors.placement):
            return ""
        return (
            f"the field sensors of {name} are not calibrated: the tool's position is some millimetres off, or lost; "
            "run "
            f"`haptorb calibrate {name}` and load its file with --calibration FILE, or calibration=FILE in Python"
        )

    @property
    def model(self) -> str:
        """The controller model."""
        return self._controller_model.name

    def change_model(self, name: str) -> None:
        """Change to the device's model `name` in the wrench map, without a step."""
        self._controller_model.change(name)

    def _match_currents(self, sample: Sample) -> tuple[Array, Array, float]:
        """Emitted field (k, 3) [T], the currents (m,) [A] at its time, and that time [s];
        the tracker receives the uncertainty of the currents."""
        history = self._history
        history.append(sample)
        moments = self._moments * history.doubt
        self._moment_noise[:] = self._read + moments @ moments.T
        self._tracker["swing"] = self._per_ampere_rms @ history.doubt
        return history.field, history.currents, history.taken

    def _unknown(self, t: float, why: str) -> Estimate:
        self.verdict = why
        last = self._last
        return Estimate(last.state, last.wrench_map, False, t - self._t, reversed=why == self.REVERSED)

    def _search(self, pose: Array) -> int:
        """Cold start: fits from the grid points whose fields match the readings best, in both orientations."""
        tracker, sensors = self._tracker, self._sensors
        cross = self._fields @ sensors["field"].ravel()
        misfits = (self._fields**2).sum(axis=1) - 2 * np.abs(cross)
        best, limit, covariance = math.inf, float(tracker["limit"][0]), self.covariance.copy()
        readings = int(tracker["readings"][0])
        for at in _choose_starts(self._grid, np.argsort(misfits).tolist(), 4):
            p, R = self._grid[at].copy(), rotation_to_axis(math.copysign(1.0, cross[at]) * self._grid[at])
            good, misfit = fit_anew(tracker, sensors, self._model, p, R)
            if good and misfit < best:
                best, covariance = misfit, self.covariance.copy()
                pose[:3], pose[3] = R, p
            if is_explained(best, readings, 0.5 * limit):
                break
        self.covariance[:] = covariance
        if not is_explained(best, readings, limit):
            tracker["residual"] = math.sqrt(best / max(readings - 5, 1))
            return LOST
        return filter_fit(tracker, best, readings, -1.0, pose)


def _grid(device: SphericalElectromagnet) -> Array:
    """(n, 3) [m] grid over the shell and a margin; 15 mm spacing, within the fit's region of convergence."""
    half = min(device.workspace_half_angle + math.radians(15), math.pi)
    count = 60
    z = 1 - (np.arange(count) + 0.5) / count * (1 - math.cos(half))
    turn = math.pi * (1 + math.sqrt(5)) * np.arange(count)
    s = np.sqrt(1 - z * z)
    directions = np.column_stack([s * np.cos(turn), s * np.sin(turn), z])
    distances = device.contact_distance + device.shell_thickness * np.array([0.1, 0.5, 0.9])
    places: Array = np.ascontiguousarray((distances[:, None, None] * directions).reshape(-1, 3))
    return places


def _fields_at(model: ToolModel, places: Array) -> Array:
    """(n, 3 k) [T] of radial tools at the positions `places`."""
    k = len(model.sensors)
    B, J = np.empty((k, 3)), np.empty((k, 3, 5))
    rows = np.empty((len(places), 3 * k))
    for row, p in zip(rows, places, strict=True):
        tool_field(model, p, rotation_to_axis(p), B, J)
        row[:] = B.ravel()
    return rows


def _choose_starts(places: Array, order: list[int], count: int) -> list[int]:
    """The first `count` of `order` that are at least 12 mm from each other: distinct starting points."""
    chosen: list[int] = []
    for at in order:
        if all(float(((places[at] - places[other]) ** 2).sum()) > 12e-3**2 for other in chosen):
            chosen.append(at)
            if len(chosen) == count:
                break
    return chosen
