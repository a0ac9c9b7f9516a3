"""From wanted currents to duty cycles, with the resistance that the coils have now: Zárate 2020 eqs. (3), (4), (6).

Each coil's resistance is learned from what flowed. Cold start, zero current and saturation keep the last estimated
resistance in place; it can never leave what copper can have.
"""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Array, Record, Records
from haptorb.numerics.compiled import kernel

__all__ = ["choose_duties", "lag_of", "rest_coils"]

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
