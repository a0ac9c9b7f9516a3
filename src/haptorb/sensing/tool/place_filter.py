"""The α–β filter of a place and an axis: a stated bandwidth at any rate, and never late behind a steady motion.

Place and axis are predicted with their rates and corrected by α = 1 − θ², the rates by β/dt, β = (1 − θ)²: critically
damped, one memory θ for both. The measured pose becomes the reported one through

    H(z) = (1 − θ) z ((1 + θ) z − 2θ)/(z − θ)²,     |H|² = (1 − θ)² ((1 + θ)² + 4θ² − 4θ(1 + θ) c)/(1 + θ² − 2θ c)²

with c = cos(2π f dt), and θ is chosen in every tick so that |H|² = 1/2 at the bandwidth, whatever dt is. H is 1 at rest
and its group delay there is none: a position in steady motion has no lag. The price: below the bandwidth |H|
rises to 1.11, so that a step is overshot by 14 %, and white noise keeps 0.55 of its standard deviation at 100 Hz and
1 kHz, where an ideal filter of 100 Hz, infinitely late, would leave 0.45. The rates are late by twice the filter's
memory, 2 dt θ/(1 − θ) and half a tick. A loop slower than twice the bandwidth is not filtered: θ is 0.
"""

from __future__ import annotations

import math

import numpy as np

from haptorb.devices.electromagnet.ring_tool import axis_frame
from haptorb.numerics.arrays import Array, Record, fields
from haptorb.numerics.compiled import kernel

__all__ = ["FILTER", "correct_pose", "extrapolate_pose", "memory", "noise_share", "predict"]

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
