"""One tick of the Hall tracker in one compiled pass: subtract the coils, fit, doubt, filter.

The parts stand in files of their own; they are strung together here because a call into compiled code with so many
arrays costs as much as the parts do.

numbers (9,)       noise of a reading [T], bandwidth [Hz], from where to where a tool is believed to be [m], the cosine
                   of the steepest place, the core's radius [m]; then found: what may be left unexplained, and what was
                   [T], and the share of the readings that are new in a tick
readings (3, k, 3) what the tool does at the sensors [T], when that was read, and how long ago [s]
"""

from __future__ import annotations

from typing import Final

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.sensing.tool.place_filter import correct_pose, extrapolate_pose, predict
from haptorb.sensing.tool.tool_field import ToolModel
from haptorb.sensing.tool.tool_fit import fit_tool, moment_weight

__all__ = [
    "AGES",
    "BANDWIDTH",
    "CORE",
    "FIELD",
    "FURTHEST",
    "LIMIT",
    "LOST",
    "LOWEST",
    "MISFIT",
    "NEAREST",
    "NOISE",
    "RESIDUAL",
    "REVERSED",
    "SEEN",
    "SHARE",
    "SWING",
    "UNEXPLAINED",
    "UNREAD",
    "VAGUE",
    "filter_fit",
    "follow_tool",
    "is_explained",
    "subtract_coils",
]  # fmt: skip

NOISE, BANDWIDTH, NEAREST, FURTHEST, LOWEST, CORE, SWING, LIMIT, RESIDUAL, MISFIT, SHARE = range(11)
FIELD, WHEN, AGES = range(3)

#: what came of a tick
SEEN: Final = 0
UNEXPLAINED: Final = 1  #: no tool near the predicted place leaves such readings
LOST: Final = 2
REVERSED: Final = 3
UNREAD: Final = 4  #: a current is not a number, or a sensor has gone
VAGUE: Final = 5  #: what was read contradicts nothing and says too little, as while the currents jump

#: a last step below this leaves its square over 70 mm, 0.1 mm and 0.2°; typical noise makes half such steps
_NEAR, _TURN = 3e-3, 0.08
_MOST = 4  #: evaluations
_MANY = 5.0  #: residuals so many times the sensors' noise are no noise
_SHARE = 0.01  #: of the coils' own field that calibration may leave unexplained
_CALIBRATED = 1e-3  #: standard deviation of the moment map's entries after a calibration, of their column
_OLD = 0.05  #: a reading that is older tells nothing any more: a sensor has gone [s]
_FRESH = 0.05  #: weight of a tick in the share of readings that are new
_VAGUE = 3e-3  #: standard deviation of the place above which it is not known [m]
_OUTWARD = -0.2  #: a tool whose axis points inwards by more than this cosine has its magnet the wrong way round


@kernel
def subtract_coils(
    read: Array, currents: Array, per_ampere: Array, offsets: Array, UU: Array, measured: Array, columns: Array,
    taken: float, t: float, numbers: Array, readings: Array, G: Array,
) -> bool:  # fmt: skip
    """readings = read (k, 3) [T] − offsets − field of the coils, where something was read, at `taken` [s]; their ages
    at `t` [s], numbers[LIMIT] and G (3, 3) for such currents (m,) [A]; False if a current is not a number or a reading
    too old.

    per_ampere (k, 3, m) [T/A]; UU, measured, columns as in `moment_weight`.
    """
    total, oldest, new = 0.0, 0.0, 0
    for k in range(read.shape[0]):
        for i in range(3):
            coils = 0.0
            for j in range(currents.shape[0]):
                coils += per_ampere[k, i, j] * currents[j]
            total += coils * coils
            left = read[k, i] - offsets[k, i] - coils
            if left - left == 0.0:  # a number
                readings[FIELD, k, i] = left
                readings[WHEN, k, i] = taken
                new += 1
            age = t - readings[WHEN, k, i]
            readings[AGES, k, i] = age
            if not age <= oldest:
                oldest = age
    numbers[SHARE] += _FRESH * (new / read.size - numbers[SHARE])
    if not (np.isfinite(total) and oldest <= _OLD):
        return False
    square = _MANY * _MANY * (numbers[NOISE] * numbers[NOISE] + numbers[SWING] * numbers[SWING])
    numbers[LIMIT] = np.sqrt(square + _SHARE * _SHARE * total / read.size)
    moment_weight(UU, measured, columns, currents, _CALIBRATED, numbers[NOISE], G)
    return True


@kernel
def _fill_rates(belief: Array, R: Array, rates: Array) -> None:
    """rates (5,) of the place [m/s] and of the turns about R's x and y [rad/s], from `belief` (4, 3)."""
    n, r = belief[1], belief[3]
    wx, wy, wz = n[1] * r[2] - n[2] * r[1], n[2] * r[0] - n[0] * r[2], n[0] * r[1] - n[1] * r[0]
    for i in range(3):
        rates[i] = belief[2, i]
    for j in range(2):
        rates[3 + j] = wx * R[0, j] + wy * R[1, j] + wz * R[2, j]


@kernel
def is_explained(misfit: float, readings: int, limit: float) -> bool:
    """Whether a misfit [T²] over so many readings may be noise and errors of the calibration."""
    return misfit <= (readings - 5) * limit * limit


@kernel
def _variance_share(numbers: Array, spread: Array) -> float:
    """Share of one set of readings' variance that the filter keeps; a reading that is used twice is no second."""
    return float(min(spread[0] / numbers[SHARE], 1.0))


@kernel
def _doubt(numbers: Array, covariance: Array, kept: float, p: Array, R: Array) -> int:
    if not kept * (covariance[0, 0] + covariance[1, 1] + covariance[2, 2]) <= 3.0 * _VAGUE * _VAGUE:
        return VAGUE
    distance = np.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
    if not numbers[NEAREST] < distance < numbers[FURTHEST]:
        return LOST
    if p[2] < distance * numbers[LOWEST]:
        return LOST
    # A reversed magnet looks like one that is held upside down; nobody holds a pen by its tip.
    along = p[0] * R[0, 2] + p[1] * R[1, 2] + p[2] * R[2, 2]
    return REVERSED if along < _OUTWARD * distance else SEEN


@kernel
def filter_fit(
    numbers: Array, belief: Array, spread: Array, covariance: Array, misfit: float, readings: int, dt: float, p: Array,
    R: Array, motion: Array,
) -> int:  # fmt: skip
    """What the fit found, doubted and filtered: p (3,) [m], R (3, 3), and motion (2, 3): v [m/s] and w [rad/s].

    covariance (5, 5) per T² of the readings' variance becomes that of what is told; dt < 0: the filter begins anew.
    """
    anew = dt < 0.0
    square = misfit / max(readings - 5, 1)
    numbers[RESIDUAL] = np.sqrt(square)
    if not np.isfinite(square):
        return LOST
    numbers[MISFIT] += (1.0 if anew else numbers[SHARE]) * (square - numbers[MISFIT])
    covariance *= max(numbers[NOISE] * numbers[NOISE], numbers[MISFIT])
    why = _doubt(numbers, covariance, 1.0 if anew else _variance_share(numbers, spread), p, R)
    if why == SEEN:
        correct_pose(belief, spread, dt, numbers[BANDWIDTH], p, R, motion[0], motion[1])
        covariance *= _variance_share(numbers, spread)
    return why


@kernel
def follow_tool(
    read: Array, currents: Array, per_ampere: Array, offsets: Array, UU: Array, measured: Array, columns: Array,
    rows: Array, sensors: Array, response: Array, U: Array, taken: float, t: float, dt: float, numbers: Array,
    readings: Array, belief: Array, spread: Array, G: Array, covariance: Array, p: Array, R: Array, motion: Array,
) -> int:  # fmt: skip
    """From what was read (k, 3) [T] to place, rotation and motion, starting where the tool should be after `dt` [s];
    for VAGUE they are what the filter alone expects.

    Arguments as in `subtract_coils`, `fit_tool` and `filter_fit`; rows, sensors and response are a `ToolModel`'s.
    """
    if not subtract_coils(
        read, currents, per_ampere, offsets, UU, measured, columns, taken, t, numbers, readings, G
    ):  # fmt: skip
        return UNREAD
    model, rates, field = ToolModel(rows, sensors, numbers[CORE], response), np.empty(5), readings[FIELD]
    predict(belief, dt, p, R)
    _fill_rates(belief, R, rates)
    found, misfit = fit_tool(model, field, readings[AGES], rates, U, G, _NEAR, _TURN, _MOST, p, R, covariance)
    if not found or not is_explained(misfit, field.size, numbers[LIMIT]):
        return UNEXPLAINED
    why = filter_fit(numbers, belief, spread, covariance, misfit, field.size, dt, p, R, motion)
    if why == VAGUE:
        extrapolate_pose(belief, dt, p, R, motion[0], motion[1])
    return why
