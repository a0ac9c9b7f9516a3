"""Coil drive: duty cycles for commanded currents, with the estimated resistance: Zárate 2020 eqs. (3), (4), (6).

Each coil's resistance is estimated from its measured current. At a cold start, zero current and saturation the last
estimate is kept; it is clipped to the plausible range of copper.
"""

from __future__ import annotations

import numpy as np

from haptorb.arrays import Array, Record, Records
from haptorb.compiled import kernel
from haptorb.thermal import warm_ratio

__all__ = ["check_currents", "choose_duties", "lag_of", "rest_coils"]


_WINDOW_S = 0.05  #: time constant of the sliding window of eq. (6) [s]
_STEADY_CHANGE_LIMIT = 0.25  #: relative change of current per tick above which inductance dominates resistance


@kernel
def _decay_share(c: Record, dt: float) -> float:
    """Remaining share of a change of current after `dt` [s]: e^(−R dt/L)."""
    return float(np.exp(-c.resistance * dt / c.inductance)) if c.inductance > 0.0 else 0.0


@kernel
def _learn_resistance(d: Record, coils: Records) -> None:
    """Estimate the resistance by eq. (6), from the currents measured under the duties applied since the last tick."""
    weight = min(1.0, d.dt / _WINDOW_S)
    for j in range(coils.size):
        c = coils[j]
        now, then = c.current, c.drive_current
        if not np.isfinite(now):
            continue
        c.drive_current = now
        if abs(now - then) > _STEADY_CHANGE_LIMIT * abs(now):
            continue
        # Steady-state current of the applied voltage: this current shows the resistance.
        left = _decay_share(c, d.dt)
        i = (now - left * then) / (1.0 - left)
        # Eq. (6) is mean duty over mean current; weighting both with the current is equivalent for steady currents, and
        # has no pole when a current changes sign.
        volts = d.supply * c.applied - c.drive_emf
        c.volts += weight * (volts * i - c.volts)
        c.squares += weight * (i * i - c.squares)
        if c.squares > c.learnable * c.learnable:
            c.resistance = min(max(c.volts / c.squares, c.least), c.greatest)  # safety: resistance-is-bounded


@kernel
def choose_duties(d: Record, coils: Records) -> None:
    """Fill `duty` of `coils` (m,): duties that bring the currents to the commanded ones at the end of the tick, against
    `emf`.

    d is a DRIVE. The resistances are estimated first. A voltage for less time than the last tick would overshoot.
    """
    _learn_resistance(d, coils)
    largest = 0.0
    for j in range(coils.size):
        c = coils[j]
        # Eq. (4) for the current that this tick's exponential must approach to be at `current_commanded` when the tick
        # ends, plus the back-EMF of the moving mover.
        change = (c.current_commanded - c.current_expected) / (1.0 - _decay_share(c, d.dt))
        aim = c.resistance * (c.current_expected + change)
        c.duty = (aim + c.emf) / d.supply
        largest = max(largest, abs(c.duty))
    for j in range(coils.size):
        c = coils[j]
        c.drive_emf = c.emf
        if largest > 1.0:  # safety: duties-are-bounded
            c.duty /= largest
            reached = (c.duty * d.supply - c.emf) / c.resistance
            # limited by the supply voltage
            c.current_expected = reached + (c.current_expected - reached) * _decay_share(c, d.dt)
        else:
            c.current_expected = c.current_commanded


@kernel
def rest_coils(coils: Records) -> None:
    """Set `duty` of `coils` (m,) to zero; the next commanded current starts from zero."""
    for j in range(coils.size):
        c = coils[j]
        c.current_expected = c.drive_emf = c.duty = 0.0


def lag_of(resistance: Array, inductance: Array, dt: float) -> float:
    """Delay of the current rise within a tick `dt` [s], on average over the tick and at worst over the coils
    [s]; of resistance (m,) [Ω] and inductance (m,) [H]."""
    x = resistance * dt / np.maximum(inductance, 1e-12)
    return float(dt * np.max(1 + 1 / x + 1 / np.expm1(-x)))


# --------------------------------------------------------------------------------------------------
# Plausibility check of the current sensors: measured currents against a model driven by the applied voltages.
#
# A current sensor with a gain error of 0, 0.1 or 10 corrupts everything that depends on it: observed heat, estimated
# resistance, current limit. So the readings are compared with an independent model of the coil: resistance at the
# observed winding temperature, inductance, applied voltage, induced voltage. The residual, smoothed over 10 ms, must
# stay small. Where the current changes its sign meanwhile, the residual averages out: so the gain of the readings over
# the model, by least squares over 5 ms, must be plausible too.
#
# A sagging supply and an unmodelled lead appear as a slightly higher resistance. It is estimated slowly, and trusted up
# to a quarter: beyond it the sensor, or the coil, does not match the device file.


_RESIDUAL_TIME_CONSTANT_S = 0.010  #: time constant of the residual [s]
_PRODUCT_TIME_CONSTANT_S = 0.005  #: time constant of the product of reading and model [s]
_RESISTANCE_TIME_CONSTANT_S = 2.0  #: time constant of the estimated resistance [s]
_SHARE_OF_LIMIT = 0.04  #: of the current limit: tolerance for a sensor's noise and offset
_SHARE_OF_CURRENT = 0.10  #: of the present current: tolerance for sensor gain and resistance together
_SHARE_OF_CHANGE = 0.3  #: of the change per tick: tolerance for an unknown delay of the reading
_MIN_LEARNING_CURRENT = 0.1  #: of the current limit, above which the resistance is estimated
_MIN_GAIN_CHECK_CURRENT = 0.1  #: of the current limit, rms, above which the gain of the readings is checked
_MIN_GAIN, _MAX_GAIN = 0.25, 4.0  #: readings over model; a delay of 0.3 ticks reduces a gain of 1 to 0.4 at worst
_MIN_RATIO, _MAX_RATIO = 0.75, 1.0 / 0.75  #: bounds of estimated over expected resistance


@kernel
def check_currents(clock: Record, coils: Records, age: float) -> bool:
    """Whether the currents measured in this tick, `age` [s] old, match the duties applied since the last one.

    clock is a CLOCK, after a restart of which the comparison restarts; of `coils` (m,) current, applied, emf (from
    now on) and winding are read.
    """
    elapsed, restart = clock.elapsed, clock.restart
    keep, slow, fast = (
        np.exp(-elapsed / _RESIDUAL_TIME_CONSTANT_S),
        np.exp(-elapsed / _RESISTANCE_TIME_CONSTANT_S),
        np.exp(-elapsed / _PRODUCT_TIME_CONSTANT_S),
    )
    plausible = True
    for j in range(coils.size):
        c = coils[j]
        i = c.current
        if not np.isfinite(i):
            continue
        expected = c.cold * warm_ratio(c.coefficient, c.reference, c.winding)
        resistance = expected * c.ratio
        rate = resistance / c.inductance if c.inductance > 0.0 else np.inf
        volts = c.applied * c.voltage - c.model_emf
        end = volts / resistance
        now = end + (c.model - end) * np.exp(-rate * elapsed)
        if age <= elapsed:
            then = end + (c.model - end) * np.exp(-rate * (elapsed - max(age, 0.0)))
        else:
            since = max(c.model_time - (age - elapsed), 0.0)
            then = c.model_end + (c.model_before - c.model_end) * np.exp(-rate * since)
        if restart or not np.isfinite(now + then):
            c.residual = c.level = c.change = c.square = c.product = 0.0
            now = end = then = i
        c.residual = keep * c.residual + (1.0 - keep) * (i - then)
        c.level = keep * c.level + (1.0 - keep) * abs(now)
        c.change = keep * c.change + (1.0 - keep) * abs(now - c.model)
        c.square = fast * c.square + (1.0 - fast) * then * then
        c.product = fast * c.product + (1.0 - fast) * i * then
        if (
            abs(i) > _MIN_LEARNING_CURRENT * c.limit
            and abs(now - end) < 0.05 * abs(end)
            and abs(then - end) < 0.05 * abs(end)
        ):
            ratio = min(max(volts / (i * expected), 0.0), 4.0)
            c.ratio = slow * c.ratio + (1.0 - slow) * ratio
        allowed = _SHARE_OF_LIMIT * c.limit + _SHARE_OF_CURRENT * c.level + _SHARE_OF_CHANGE * c.change
        if not (abs(c.residual) <= allowed and _MIN_RATIO <= c.ratio <= _MAX_RATIO):  # safety: low-sensor-is-found
            plausible = False
        small = c.square <= (_MIN_GAIN_CHECK_CURRENT * c.limit) ** 2
        # safety: alternating-currents-are-followed
        if not (small or _MIN_GAIN * c.square <= c.product <= _MAX_GAIN * c.square):
            plausible = False
        c.model_before, c.model_end, c.model_time = c.model, end, elapsed
        c.model = now
        c.model_emf = c.emf if np.isfinite(c.emf) else 0.0
    return plausible
