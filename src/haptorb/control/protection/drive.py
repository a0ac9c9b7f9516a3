"""From wanted currents to duty cycles, with the resistance that the coils have now: Zárate 2020 eqs. (3), (4), (6)."""

from __future__ import annotations

from typing import final

import numpy as np

from haptorb.devices.device import Device
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel

__all__ = ["EMF", "Drive", "drive", "pass_time", "rest"]

_WINDOW = 0.05  #: time constant of the sliding window of eq. (6) [s]
_COLDEST, _HOTTEST = 233.15, 453.15  #: windings outside this are not resistances but faults [K]
_STEADY = 0.25  #: a current that changes by more than this share in a tick tells more of inductance than resistance
_TRUST = 0.025  #: rms current, as a share of the greatest that may flow, above which the ratio is believed


@kernel
def _left(resistance: float, inductance: float, dt: float) -> float:
    """The share of a change of the current that is left after a tick: e^(−R dt/L)."""
    return float(np.exp(-resistance * dt / inductance)) if inductance > 0.0 else 0.0


#: rows of the coils: resistance now [Ω], inductance [H], bounds of the resistance [Ω], the current from which on it is
#: learned [A], where the currents should be and where they were measured a tick ago [A], the voltage that is induced,
#: and that was when the last duties were applied [V], two sliding sums, and the duties
RESISTANCE, _INDUCTANCE, _LOW, _HIGH, _TRUSTED, _LAST, _BEFORE, EMF, _EMF_BEFORE, _VOLTS, _SQUARES, DUTY = range(12)
#: the numbers: the nominal tick [s], the supply's voltage [V], the time that the last tick took and the next may [s]
_PERIOD, _SUPPLY, _DT = range(3)


@kernel
def pass_time(numbers: Array, elapsed: float) -> None:
    """The last tick was `elapsed` [s] ago, the next may be as far: a voltage for a shorter time would overshoot."""
    numbers[_DT] = max(elapsed, numbers[_PERIOD])


@kernel
def _learn(numbers: Array, coils: Array, duties: Array, currents: Array) -> None:
    weight = min(1.0, numbers[_DT] / _WINDOW)
    for j in range(duties.size):
        now, then = currents[j], coils[_BEFORE, j]
        if not np.isfinite(now):
            continue
        coils[_BEFORE, j] = now
        if abs(now - then) > _STEADY * abs(now):
            continue
        # What the voltage would have led to if it had lasted: it is this current that the resistance tells.
        left = _left(coils[RESISTANCE, j], coils[_INDUCTANCE, j], numbers[_DT])
        i = (now - left * then) / (1.0 - left)
        # Eq. (6) is mean duty over mean current; weighting both with the current is the same for steady currents, and
        # has no pole when a current changes sign.
        volts = numbers[_SUPPLY] * duties[j] - coils[_EMF_BEFORE, j]
        coils[_VOLTS, j] += weight * (volts * i - coils[_VOLTS, j])
        coils[_SQUARES, j] += weight * (i * i - coils[_SQUARES, j])
        if coils[_SQUARES, j] > coils[_TRUSTED, j] * coils[_TRUSTED, j]:
            coils[RESISTANCE, j] = min(max(coils[_VOLTS, j] / coils[_SQUARES, j], coils[_LOW, j]), coils[_HIGH, j])


@kernel
def drive(numbers: Array, coils: Array, wanted: Array, measured: Array, applied: Array) -> None:
    """coils[DUTY] becomes the duties for `wanted` currents (m,) [A] with coils[EMF] induced, after learning from
    `measured` currents (m,) [A] under `applied` duties (m,); numbers (3,) and coils (12, m) are a `Drive`'s memory."""
    _learn(numbers, coils, applied, measured)
    supply, dt = numbers[_SUPPLY], numbers[_DT]
    largest = 0.0
    for j in range(wanted.size):
        # Eq. (4) for the current at which this tick's exponential must aim to be at `wanted` when the tick ends, and
        # the voltage that the moving mover takes.
        left = _left(coils[RESISTANCE, j], coils[_INDUCTANCE, j], dt)
        last = coils[_LAST, j]
        aim = coils[RESISTANCE, j] * (last + (wanted[j] - last) / (1.0 - left))
        coils[DUTY, j] = (aim + coils[EMF, j]) / supply
        largest = max(largest, abs(coils[DUTY, j]))
    for j in range(wanted.size):
        coils[_EMF_BEFORE, j] = coils[EMF, j]
        if largest > 1.0:
            coils[DUTY, j] /= largest
            left = _left(coils[RESISTANCE, j], coils[_INDUCTANCE, j], dt)
            reached = (coils[DUTY, j] * supply - coils[EMF, j]) / coils[RESISTANCE, j]
            coils[_LAST, j] = reached + (coils[_LAST, j] - reached) * left  # as far as the supply can bring it
        else:
            coils[_LAST, j] = wanted[j]


@kernel
def rest(coils: Array) -> None:
    """coils[DUTY] becomes zero, and the next wanted current starts from nothing; coils (12, m) as in `drive`."""
    for j in range(coils.shape[1]):
        coils[_LAST, j] = coils[_EMF_BEFORE, j] = coils[DUTY, j] = 0.0


@final
class Drive:
    """Duties for currents; learns each coil's resistance from what flowed. Cold start, zero current and saturation
    leave the last believed resistance in place; it can never leave what copper can have.

    numbers  (3,) and coils (12, m): all that it remembers, for compiled code
    """

    def __init__(self, device: Device, dt: float) -> None:
        coils = device.coils
        channels = device.channels
        self.numbers: Array = np.array([dt, device.supply.voltage, dt])
        self.coils: Array = np.zeros((12, channels))
        self.coils[_INDUCTANCE] = coils.inductance
        self.coils[_LOW] = coils.resistance_at(np.full(channels, _COLDEST))
        self.coils[_HIGH] = coils.resistance_at(np.full(channels, _HOTTEST))
        self.coils[_TRUSTED] = _TRUST * coils.current_limit
        self.resistance: Array = self.coils[RESISTANCE]  #: (m,) as believed now [Ω]
        self.resistance[:] = coils.resistance_at(np.full(channels, coils.heat.ambient))
        self.chosen: Array = self.coils[DUTY]  #: (m,) the duties of this tick

    @property
    def lag(self) -> float:
        """By how much the currents' rise within a tick is late, on average over it and at worst over the coils [s]."""
        dt = float(self.numbers[_PERIOD])
        x = self.resistance * dt / np.maximum(self.coils[_INDUCTANCE], 1e-12)
        return float(dt * np.max(1 + 1 / x + 1 / np.expm1(-x)))

    def duties(self, wanted: Array, measured: Array, applied: Array, emf: Array | None = None) -> Array:
        """(m,) duties in −1…1 for `wanted` currents, after learning from `measured` currents under `applied` duties.

        emf (m,) [V] is what the moving mover induces against the currents now; None: nothing.
        """
        self.coils[EMF] = 0.0 if emf is None else emf
        drive(self.numbers, self.coils, wanted, measured, applied)
        return self.chosen

    def rest(self) -> Array:
        """(m,) zeros: the coils are off, and the next wanted current starts from nothing. In duties from −1 to 1."""
        rest(self.coils)
        return self.chosen
