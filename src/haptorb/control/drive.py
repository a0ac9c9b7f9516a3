"""From wanted currents to duty cycles, with the resistance that the coils have now: Zárate 2020 eqs. (3), (4), (6).

Each coil's resistance is learned from what flowed. Cold start, zero current and saturation keep the last estimated
resistance in place; it can never leave what copper can have.
"""

from __future__ import annotations

import numpy as np

from haptorb.arrays import Array, Record, Records
from haptorb.compiled import kernel

__all__ = ["check_currents", "choose_duties", "lag_of", "rest_coils"]


_WINDOW = 0.05  #: time constant of the sliding window of eq. (6) [s]
_STEADY = 0.25  #: a current that changes by more than this share in a tick shows inductance more than resistance


@kernel
def _decay_share(c: Record, dt: float) -> float:
    """The share of a change of the current that is left after `dt` [s]: e^(−R dt/L)."""
    return float(np.exp(-c.resistance * dt / c.inductance)) if c.inductance > 0.0 else 0.0


@kernel
def _learn_resistance(d: Record, coils: Records) -> None:
    """Eq. (6), with the currents that were measured under the duties applied since the last tick."""
    weight = min(1.0, d.dt / _WINDOW)
    for j in range(coils.size):
        c = coils[j]
        now, then = c.current, c.drive_current
        if not np.isfinite(now):
            continue
        c.drive_current = now
        if abs(now - then) > _STEADY * abs(now):
            continue
        # What the voltage would have led to if it had lasted: this current shows the resistance.
        left = _decay_share(c, d.dt)
        i = (now - left * then) / (1.0 - left)
        # Eq. (6) is mean duty over mean current; weighting both with the current is the same for steady currents, and
        # has no pole when a current changes sign.
        volts = d.supply * c.applied - c.drive_emf
        c.volts += weight * (volts * i - c.volts)
        c.squares += weight * (i * i - c.squares)
        if c.squares > c.learnable * c.learnable:
            c.resistance = min(max(c.volts / c.squares, c.least), c.greatest)  # safety: resistance-is-bounded


@kernel
def choose_duties(d: Record, coils: Records) -> None:
    """`duty` of `coils` (m,) becomes what gives the currents `held` at the end of the tick with `emf` induced.

    d is a DRIVE. The resistances are learned first. A voltage for a time shorter than the last tick would overshoot.
    """
    _learn_resistance(d, coils)
    largest = 0.0
    for j in range(coils.size):
        c = coils[j]
        # Eq. (4) for the current at which this tick's exponential must aim to be at `held` when the tick ends, and the
        # voltage that the moving mover takes.
        aim = c.resistance * (c.driven + (c.held - c.driven) / (1.0 - _decay_share(c, d.dt)))
        c.duty = (aim + c.emf) / d.supply
        largest = max(largest, abs(c.duty))
    for j in range(coils.size):
        c = coils[j]
        c.drive_emf = c.emf
        if largest > 1.0:  # safety: duties-are-bounded
            c.duty /= largest
            reached = (c.duty * d.supply - c.emf) / c.resistance
            c.driven = reached + (c.driven - reached) * _decay_share(c, d.dt)  # as far as the supply can bring it
        else:
            c.driven = c.held


@kernel
def rest_coils(coils: Records) -> None:
    """`duty` of `coils` (m,) becomes zero, and the next wanted current starts from nothing."""
    for j in range(coils.size):
        c = coils[j]
        c.driven = c.drive_emf = c.duty = 0.0


def lag_of(resistance: Array, inductance: Array, dt: float) -> float:
    """By how much the currents' rise within a tick `dt` [s] is late, on average over it and at worst over the coils
    [s]; of resistance (m,) [Ω] and inductance (m,) [H]."""
    x = resistance * dt / np.maximum(inductance, 1e-12)
    return float(dt * np.max(1 + 1 / x + 1 / np.expm1(-x)))


# --------------------------------------------------------------------------------------------------
# Does a coil carry its set current? Measured currents against those that the applied voltages must give.
#
# A current sensor that reads nothing, a tenth or ten times as much makes everything behind it wrong: the heat that is
# observed, the resistance that is learned, the limit that is kept. So the readings are compared with a model of the
# coil that does not come from them: resistance at the observed winding temperature, inductance, applied voltage,
# induced voltage. What remains of a difference after 10 ms of smoothing must stay small. Where the current changes its
# sign meanwhile, a difference cancels itself: so the gain of the readings over the model, by least squares over 5 ms,
# must be plausible too.
#
# A supply that sags and a wire that was forgotten look like a little more resistance. That is learned, slowly, and
# trusted up to a quarter: beyond it the sensor, or the coil, is not what the device file says.


_SMOOTH = 0.010  #: time constant of the residual [s]
_SMOOTH_PRODUCT = 0.005  #: and of the product of the reading and the model [s]
_LEARN = 2.0  #: time constant of the resistance that is learned [s]
_SHARE_OF_LIMIT = 0.04  #: of the greatest current: what noise and offset of a sensor may be
_SHARE_OF_CURRENT = 0.10  #: of the present current: what gain of a sensor and resistance may be off at once
_SHARE_OF_CHANGE = 0.3  #: of the change per tick: what an unknown delay of the reading may be off
_TRUSTED = 0.1  #: of the greatest current, from which on the resistance is learned
_JUDGED = 0.1  #: of the greatest current, rms, from which on the gain of the readings is judged
_LOWEST_GAIN, _HIGHEST_GAIN = 0.25, 4.0  #: of the readings over the model; a delay of 0.3 ticks makes at worst 0.4 of 1
_LOWEST, _HIGHEST = 0.75, 1.0 / 0.75  #: learned over expected resistance


@kernel
def check_currents(clock: Record, coils: Records, age: float) -> bool:
    """Whether the currents measured in this tick, `age` [s] old, match the duties applied since the last one.

    clock is a CLOCK, after a restart of which the comparison restarts; of `coils` (m,) current, applied, emf (from
    now on) and winding are read.
    """
    elapsed, restart = clock.elapsed, clock.restart
    keep, slow, fast = np.exp(-elapsed / _SMOOTH), np.exp(-elapsed / _LEARN), np.exp(-elapsed / _SMOOTH_PRODUCT)
    plausible = True
    for j in range(coils.size):
        c = coils[j]
        i = c.current
        if not np.isfinite(i):
            continue
        expected = c.cold * (1.0 + c.coefficient * (c.winding - c.reference))
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
        if abs(i) > _TRUSTED * c.limit and abs(now - end) < 0.05 * abs(end) and abs(then - end) < 0.05 * abs(end):
            ratio = min(max(volts / (i * expected), 0.0), 4.0)
            c.ratio = slow * c.ratio + (1.0 - slow) * ratio
        allowed = _SHARE_OF_LIMIT * c.limit + _SHARE_OF_CURRENT * c.level + _SHARE_OF_CHANGE * c.change
        if not (abs(c.residual) <= allowed and _LOWEST <= c.ratio <= _HIGHEST):  # safety: low-sensor-is-found
            plausible = False
        small = c.square <= (_JUDGED * c.limit) ** 2
        # safety: alternating-currents-are-followed
        if not (small or _LOWEST_GAIN * c.square <= c.product <= _HIGHEST_GAIN * c.square):
            plausible = False
        c.model_before, c.model_end, c.model_time = c.model, end, elapsed
        c.model = now
        c.model_emf = c.emf if np.isfinite(c.emf) else 0.0
    return plausible
