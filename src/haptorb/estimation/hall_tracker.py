"""Where the tool is, from the field sensors alone, while the coils are driven: `--tracker hall`.

What coils and core do per ampere is known (calibrated), the measured currents give it, and it is subtracted; what is
left is the tool's magnet and the core's answer to it. Place and axis that explain it best are the estimate; the turn
about the axis leaves no trace in the field of a round magnet and is taken as zero.

What is measured in every tick goes through the filter of `sensing.place_filter`: 100 Hz (−3 dB) at any rate of the
loop, the place not late at steady velocity, the velocity 7 ms late.

Where a driver reads the sensors in turns, what it did not read in a tick is NaN. The last reading of each stands in,
less the coils' field at the time when it was taken (`sensing.current_history`), and is held against where the tool was
then, by its velocity.

A tick whose readings are consistent but contain too little is skipped: for 10 ms the tool's pose is extrapolated to
where it should be by then, and the estimate says how old what was seen of it is.
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
from haptorb.devices.electromagnet_model import axis_frame
from haptorb.errors import GeometryError, InputError
from haptorb.estimation.controller_model import ControllerModel
from haptorb.estimation.hall_fit import (
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
# The α–β filter of a place and an axis: a stated bandwidth at any rate, and never late behind a steady motion.
#
# Place and axis are predicted with their rates and corrected by α = 1 − θ², the rates by β/dt, β = (1 − θ)²: critically
# damped, one memory θ for both. The measured pose becomes the reported one through
#
#     H(z) = (1 − θ) z ((1 + θ) z − 2θ)/(z − θ)²,     |H|² = (1 − θ)² ((1 + θ)² + 4θ² − 4θ(1 + θ) c)/(1 + θ² − 2θ c)²
#
# with c = cos(2π f dt), and θ is chosen in every tick so that |H|² = 1/2 at the bandwidth, whatever dt is. H is 1 at
# rest and its group delay there is none: a position in steady motion has no lag. The price: below the bandwidth |H|
# rises to 1.11, so that a step is overshot by 14 %, and white noise keeps 0.55 of its standard deviation at 100 Hz and
# 1 kHz, where an ideal filter of 100 Hz, infinitely late, would leave 0.45. The rates are late by twice the filter's
# memory, 2 dt θ/(1 − θ) and half a tick. A loop slower than twice the bandwidth is not filtered: θ is 0.


#: The filter's state, and its response to white noise of variance 1 in the readings.
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
    """θ of the filter whose gain is 3 dB down where the signal turns by `turn` [rad] from one tick to the next.

    0, no filter at all, from half a turn on: such a signal is faster than the ticks can tell.

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
    """Standard deviation that white noise of the readings keeps in the output [1], at `bandwidth` and `rate` [Hz].

    From the variance of an α–β filter: (2α² + 2β − 3αβ)/(α (4 − 2α − β)).

    >>> round(noise_share(), 3), noise_share(100.0, 150.0)
    (0.547, 1.0)
    """
    theta = memory(2 * math.pi * bandwidth / rate)
    alpha, beta = 1 - theta**2, (1 - theta) ** 2
    return math.sqrt((2 * alpha**2 + 2 * beta - 3 * alpha * beta) / (alpha * (4 - 2 * alpha - beta)))


@kernel
def predict(f: Record, dt: float, p: Array, R: Array) -> None:
    """Where place p (3,) [m] and axis, R's third column, should be `dt` [s] after what the filter f has."""
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
    """w (3,) [rad/s] of an axis n that changes at `rate` [1/s]."""
    w[0], w[1], w[2] = n[1] * rate[2] - n[2] * rate[1], n[2] * rate[0] - n[0] * rate[2], n[0] * rate[1] - n[1] * rate[0]


@kernel
def extrapolate_pose(f: Record, dt: float, p: Array, R: Array, v: Array, w: Array) -> None:
    """The output `dt` [s] after f without a measurement: p [m], R, v [m/s] and w [rad/s]."""
    predict(f, dt, p, R)
    for i in range(3):
        v[i] = f.velocity[i]
    _fill_angular_velocity(f.axis, f.axis_rate, w)


@kernel
def correct_pose(f: Record, dt: float, bandwidth: float, p: Array, R: Array, v: Array, w: Array) -> None:
    """One step of the filter; p [m] and R go in as measured and come out filtered, v [m/s] and w [rad/s] come out.

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
        f.axis_rate[i] -= along * f.axis[i]  # a unit vector moves across itself only
        p[i] = f.place[i]
        v[i] = f.velocity[i]
    _fill_angular_velocity(f.axis, f.axis_rate, w)
    axis_frame(f.axis, R)


# --------------------------------------------------------------------------------------------------
# One tick of the Hall tracker in one compiled pass: subtract the coils, fit, doubt, filter.
#
# The parts stand in files of their own; they are strung together here because a call into compiled code costs as much
# as the parts do. Everywhere, tracker is (1,) TRACKER, t its record, sensors (k,) SENSOR, and model what `pack_model`
# made.


#: what came of a tick
LOCATED: Final = 0
UNEXPLAINED: Final = 1  #: no tool near the predicted place leaves such readings
LOST: Final = 2
REVERSED: Final = 3
UNREAD: Final = 4  #: a current is not a number, or a sensor has gone
VAGUE: Final = 5  #: what was read contradicts nothing and says too little, as while the currents jump

#: a last step below this leaves its square over 70 mm, 0.1 mm and 0.2°; typical noise makes half such steps
_NEAR, _TURN = 3e-3, 0.08
_MAX_EVALUATIONS = 4  #: evaluations
_EXACT, _COLD = 1e-6, 40  #: last step of a fit from nothing [m, rad], and its evaluations at most
_OUTLIER_SIGMAS = 5.0  #: residuals so many times the sensors' noise are no noise
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
    square = _OUTLIER_SIGMAS * _OUTLIER_SIGMAS * (t.noise * t.noise + t.swing * t.swing + t.lasting * t.lasting)
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
    found, misfit = fit_tool(t, sensors, unpack_model(model).tool, _NEAR, _TURN, _MAX_EVALUATIONS, p, R)
    if not found or not is_explained(misfit, readings, t.limit):
        return UNEXPLAINED
    why = filter_fit(tracker, misfit, readings, dt, pose)
    if why == VAGUE:
        extrapolate_pose(t.filter, dt, p, R, pose[4], pose[5])
    return why


# --------------------------------------------------------------------------------------------------
# What the Hall tracker remembers between two ticks, and the settings that it goes by: two structured arrays.
#
# `TRACKER` holds what is there once, in an array of one record; `SENSOR` what every field sensor has, in k records.


_REACH = 15e-3  #: how far outside the shell a tool's position is still valid [m]

#: There is one.
TRACKER = fields(
    # settings
    ("noise", "f8"),  # of one reading [T]
    ("bandwidth", "f8"),  # of place and axis [Hz]
    ("nearest", "f8"),  # distance from the centre below which a tool's position is invalid [m]
    ("furthest", "f8"),  # distance from the centre above which a tool's position is invalid [m]
    ("lowest", "f8"),  # cosine of the steepest place
    ("readings", "i8"),  # of all axes of the sensors that are used
    ("lasting", "f8"),  # standard deviation of the error that stays in a reading of the tool [T]
    ("coil_error", "f8"),  # share of the coils' own field that may be left in a reading
    ("eddy_share", "f8"),  # of the currents' moment that lags
    ("eddy_time", "f8"),  # constant of the lag [s]
    ("eddy_doubt", "f8"),  # standard deviation of that share
    ("remanent", "f8"),  # moment that may stay in the core, standard deviation of each axis [A·m²]
    ("coupling", "f8", (3, 3)),  # UᵀU, U the field of unit moments at all sensors [T²/(A²·m⁴)]
    # this tick
    ("moment_noise", "f8", (3, 3)),  # covariance of the moment from the currents' noise [A²·m⁴]
    ("swing", "f8"),  # field that the currents may be wrong by, where they change quickly [T]
    ("limit", "f8"),  # what may be left unexplained [T]
    ("weight", "f8", (3, 3)),  # G of `tool_fit`: what is known about the moment [A²·m⁴/T²]
    ("rates", "f8", (5,)),  # of the place [m/s] and of the turns about the mover's x and y [rad/s]
    # remembered
    ("lagged_at", "f8"),  # time of the currents that went through the lag last [s]
    ("share", "f8"),  # of the readings that are new in a tick, averaged
    ("residual", "f8"),  # rms of what the last fit left unexplained [T]
    ("misfit", "f8"),  # its square, averaged [T²]
    ("covariance", "f8", (5, 5)),  # of what was seen last: place [m²], turns about two axes across the tool's [rad²]
    ("filter", FILTER),
)

#: Of each field sensor: what it said last of the tool alone, and what is known about it.
SENSOR = fields(
    ("used", "?"),  # False: it has failed and is left out
    ("offset", "f8", (3,)),  # at zero current without a tool [T]
    ("gain", "f8", (3, 3)),  # field per reading
    ("per_moment", "f8", (3, 3)),  # field per moment along x, y, z of the electromagnet [T/(A·m²)]
    ("left", "f8", (3,)),  # of the reading without offset and coils, in the sensor's axes [T]
    ("field", "f8", (3,)),  # of tool and core alone [T]
    ("taken", "f8", (3,)),  # when that was read, per axis [s]; -inf before the first reading
    ("age", "f8", (3,)),  # how long ago that is [s]
)


def make_tracker(device: SphericalElectromagnet, noise: float, bandwidth: float, lasting: float) -> Records:
    """(1,) TRACKER for `device`, whose readings have `noise` and `lasting` errors [T]: no tool was seen yet."""
    made = state_zeros(1, TRACKER)
    made["noise"], made["bandwidth"], made["share"] = noise, bandwidth, 1.0
    made["nearest"] = device.contact_distance - _REACH
    made["furthest"] = device.contact_distance + device.shell_thickness + _REACH
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
    """(k,) SENSOR for `device` with `offsets` (k, 3) [T]: nothing was read yet."""
    made = state_zeros(device.sensors, SENSOR)
    correction = device.hall.correction
    made["used"], made["per_moment"] = _find_used(device), moment_field(device)
    made["offset"], made["gain"] = offsets, np.eye(3) if correction is None else correction.gain
    made["left"] = made["field"] = made["taken"] = made["age"] = -math.inf
    made["field"][~made["used"]] = 0.0
    return made


def coil_error(device: SphericalElectromagnet) -> float:
    """Standard deviation of the coils' field that remains in a reading of sensors without calibration, as a share.

    >>> from haptorb.devices.loader import load
    >>> 0.01 < coil_error(load("omni")) < 0.03
    True
    """
    errors, at = device.hall.errors, np.linalg.norm(device.hall.positions.reshape(-1, 3), axis=1)
    far = 3 * errors.placement / float(at.mean()) if len(at) else 0.0  # a dipole's field falls with the cube
    return math.sqrt(errors.gain**2 + 2 * errors.cross**2 + 2 * errors.angle**2 + far**2)


def _find_used(device: SphericalElectromagnet) -> NDArray[np.bool_]:
    """(k,) sensors that have not failed."""
    correction = device.hall.correction
    return np.ones(device.sensors, dtype=np.bool_) if correction is None else correction.used


# --------------------------------------------------------------------------------------------------
# The currents when the field was read, where a board measures the two at different times: between two measurements.
#
# The coils' own field is ten times the tool's, and a tenth of an ampere is taken for a millimetre. Currents that change
# by an ampere in ten milliseconds have to be known to the tenth of a millisecond, and a current sensor reports the mean
# of half a millisecond that ended at some time in the last half. Carried on from the last two of them, such errors are
# doubled; between the measurement before the field and the one after it, they are less than those of either. So a field
# waits for the next currents, a tick long.


_LENGTH = (
    16  #: measurements: a field waits on the board while newer ones of other sensors are reported, for 7 ms and more
)
_SAME = 0.2e-3  #: currents that are newer by less than this are no second measurement [s]
_CURRENT_HISTORY_PAUSE = 0.05  #: between two of them, after which nothing is known of the time between [s]
_BEYOND = 0.3  #: of a step between two measurements, so far outside of them a field may lie
_SCATTER = 0.15e-3  #: standard deviation of when a current was so [s]
_RECENT_CHANGE_S = 0.01  #: for so long a change of the currents spoils readings that are still in use [s]


@final
class CurrentHistory(Stateful):
    """Fields, each with the currents (m,) [A] at its own time.

    field     (k, 3) [T] that the last `take` has ended the waiting of; NaN where there is none
    taken     when that was read [s]
    currents  (m,) [A] at that time
    doubt     (m,) [A] what these, and those of the readings of the last 10 ms, may be wrong by
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
        """Measured currents [A] with their times [s]; fields [T] that wait, and that was told; and their times [s]."""
        return {"times": self._times, "values": self._values, **self._kept}

    def gather_state(self) -> None:
        """Copy what the last samples brought."""
        kept, cells = self._kept, self._cells
        kept["waiting"][:], kept["field"][:] = self._waiting, self.field
        kept["currents"][:], kept["doubt"][:] = self.currents, self.doubt
        cells[0], cells[1] = self._waiting_since, self.taken

    def apply_state(self) -> None:
        """Take it over."""
        kept = self._kept
        self._waiting, self.field = kept["waiting"].copy(), kept["field"].copy()
        self.currents, self.doubt = kept["currents"].copy(), kept["doubt"].copy()
        self._waiting_since, self.taken = self._cells

    def take(self, sample: Sample) -> None:
        """The next sample. Its field waits for the next that has newer currents, and is reported then or never."""
        at = sample.t - sample.currents_age
        newer = at - self._times[-1]
        self.field = self._nothing
        if (
            -_CURRENT_HISTORY_PAUSE <= newer < _SAME
        ):  # the same measurement once more, as far as is known: an answer was lost
            return
        if not 0.0 <= newer <= _CURRENT_HISTORY_PAUSE:
            self._times[:] = -math.inf
        self._times[:-1], self._values[:-1] = self._times[1:], self._values[1:]
        self._times[-1], self._values[-1] = at, sample.currents
        if np.isfinite(self._times[-2]):
            self._release(self._times[-1] - self._times[-2])
        self._waiting, self._waiting_since = sample.field, sample.t - sample.field_age

    def _release(self, newer: float) -> None:
        """Tell the field that waits, unless its time is too far from all currents."""
        when, times, values = self._waiting_since, self._times, self._values
        first = -2
        while when < times[first] and first > -_LENGTH and math.isfinite(times[first - 1]):
            first -= 1
        step, change = float(times[first + 1] - times[first]), values[first + 1] - values[first]
        share = (when - float(times[first])) / step
        self.doubt = np.maximum(_SCATTER / step * np.abs(change), math.exp(-newer / _RECENT_CHANGE_S) * self.doubt)
        if -_BEYOND <= share <= 1.0 + _BEYOND:
            self.field, self.taken = self._waiting, when
            self.currents = values[first] + share * change


#: bandwidth [Hz] for drivers that read the sensors in turns, six ticks for all: more lets through noise only
IN_TURNS = 30.0

_TOOL_POSITION_PAUSE = 0.05  #: without a sample for so long the velocity says nothing any more [s]
_CARRIED = 0.01  #: for so long the tool's motion is extrapolated while the readings contain too little [s]
_VERDICTS = ("", "lost", "reversed")
_SEARCH_INTERVAL_S = 0.02  #: between two searches from nothing [s]: a search takes longer than a tick


class HallTracker(Estimator):
    """Uses the field sensors; the sample's `pose` is ignored.

    device     a spherical electromagnet with at least two field sensors
    model      of the device, for the wrench map; None: its first
    offsets    (k, 3) [T] of the sensors at zero current without a tool, as calibration found them
    bandwidth  of place and axis [Hz]

    `verdict` says why an estimate is not valid: "lost", "reversed" (the tool's magnet is the wrong way round: forces
    would invert), or "" where it is.

    Raises InputError for a device without such sensors, a bandwidth or offsets that cannot be.

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
        self._lagged = state_zeros(device.channels)  # currents through the core's lag
        self._lagged[:] = np.nan
        self._fields *= np.repeat(self._sensors["used"], 3)
        self._filter = self._tracker["filter"]
        self._moment_noise: Array = self._tracker["moment_noise"][0]
        self._moment_noise[:] = self._read
        #: (5, 5) of what was seen last, noise only: place [m²], turns about two axes across the tool's [rad²]
        self.covariance: Array = self._tracker["covariance"][0]
        self.verdict: str = self.LOST
        self._found, self._t, self._searched = False, -math.inf, -math.inf
        nowhere = State(0.0, np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3))
        self._last = Estimate(nowhere, WrenchMap(np.zeros((6, device.channels)), np.zeros(6)), False, math.inf)
        self._kept = KeptEstimate(device.channels)
        self._numbers = make_numbers("verdict", "found", "t", "searched")

    def state_arrays(self) -> Mapping[str, StateArray]:
        """Filter, sensors, lagged currents [A], the last estimate, and where the search is."""
        own = {"tracker": self._tracker, "sensors": self._sensors, "lagged": self._lagged, "search": self._numbers[0]}
        return {**own, **self._kept.arrays}

    def state_parts(self) -> Mapping[str, Stateful]:
        """Currents that wait for fields, and the controller model."""
        return {"history": self._history, "model": self._controller_model}

    def gather_state(self) -> None:
        """Copy the last estimate."""
        self._kept.store(self._last)
        cells = self._numbers[1]
        cells[0], cells[1], cells[2], cells[3] = (
            _VERDICTS.index(self.verdict), self._found, self._t, self._searched
        )  # fmt: skip

    def apply_state(self) -> None:
        """Take it over."""
        self._last = self._kept.load()
        verdict, found, self._t, self._searched = self._numbers[1]
        self.verdict, self._found = _VERDICTS[choose(verdict, len(_VERDICTS))], bool(found)

    @property
    def residual(self) -> float:
        """rms of what the last estimate leaves unexplained [T]."""
        return float(self._tracker["residual"][0])

    def update(self, sample: Sample) -> Estimate:
        """The estimate after `sample`. Raises InputError for readings of other sensors than the device's."""
        read = np.ascontiguousarray(sample.field)
        if read.shape != self._shape:
            raise InputError(
                f"device '{self._device.name}' has {self._device.sensors} field sensors; the sample has {read.shape[0]}"
            )
        currents, taken = sample.currents, sample.t - sample.field_age
        if sample.currents_age != sample.field_age:  # a board's; a simulated device's are of one moment
            read, currents, taken = self._match_currents(sample)
        tracker, sensors, model, pose = self._tracker, self._sensors, self._model, np.empty((6, 3))
        if self._found:
            dt = sample.t - self._t
            if not 0.0 <= dt <= _TOOL_POSITION_PAUSE:
                self._filter["velocity"] = self._filter["axis_rate"] = 0.0
                dt = 0.0
            code = follow_tool(tracker, sensors, model, read, currents, self._lagged, taken, sample.t, dt, pose)
        else:  # what is left of the readings without the coils; the place is still to be searched
            whole = subtract_coils(tracker, sensors, model, read, currents, self._lagged, taken, sample.t)
            code = UNEXPLAINED if whole else UNREAD
        if code == UNEXPLAINED:
            self._found = False
            if sample.t - self._searched < _SEARCH_INTERVAL_S:
                return self._unknown(sample.t, self.verdict or self.LOST)
            self._searched = sample.t
            code = self._search(pose)
        unsure = code == VAGUE and self._found and sample.t - self._t <= _CARRIED  # safety: tool-carried
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
        """Sensors that differ from ideal ones and are not calibrated."""
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
        """Go over to the device's model `name` in the wrench map, without a step."""
        self._controller_model.change(name)

    def _match_currents(self, sample: Sample) -> tuple[Array, Array, float]:
        """The field (k, 3) [T] that waited for these currents, the currents (m,) [A] at its time, and that time [s];
        the tracker learns by how much they may be wrong."""
        history = self._history
        history.take(sample)
        moments = self._moments * history.doubt
        self._moment_noise[:] = self._read + moments @ moments.T
        self._tracker["swing"] = self._per_ampere_rms @ history.doubt
        return history.field, history.currents, history.taken

    def _unknown(self, t: float, why: str) -> Estimate:
        self.verdict = why
        last = self._last
        return Estimate(last.state, last.wrench_map, False, t - self._t, reversed=why == self.REVERSED)

    def _search(self, pose: Array) -> int:
        """From nothing: the grid's fields most like what is read, either way round, and the fit from each."""
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
    """(n, 3) [m] places over the shell and a little more; 15 mm apart, from where the fit finds its way."""
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
    """(n, 3 k) [T] of radial tools at `places`."""
    k = len(model.sensors)
    B, J = np.empty((k, 3)), np.empty((k, 3, 5))
    rows = np.empty((len(places), 3 * k))
    for row, p in zip(rows, places, strict=True):
        tool_field(model, p, rotation_to_axis(p), B, J)
        row[:] = B.ravel()
    return rows


def _choose_starts(places: Array, order: list[int], count: int) -> list[int]:
    """The first `count` of `order` that are at least 12 mm from each other: starts that differ."""
    chosen: list[int] = []
    for at in order:
        if all(float(((places[at] - places[other]) ** 2).sum()) > 12e-3**2 for other in chosen):
            chosen.append(at)
            if len(chosen) == count:
                break
    return chosen


# --------------------------------------------------------------------------------------------------
# The ways of knowing where a spherical electromagnet's tool is, by name.
