"""From wanted currents to duty cycles, with the resistance that the coils have now: Zárate 2020 eqs. (3), (4), (6)."""

from __future__ import annotations

import numpy as np

from haptorb.devices.device import Device
from haptorb.physics.arrays import Array
from haptorb.physics.compiled import kernel

__all__ = ["Drive"]

_WINDOW = 0.05  #: time constant of the sliding window of eq. (6) [s]
_COLDEST, _HOTTEST = 233.15, 453.15  #: windings outside this are not resistances but faults [K]
_STEADY = 0.25  #: a current that changes by more than this share in a tick tells more of inductance than resistance
_TRUST = 0.025  #: rms current, as a share of the greatest that may flow, above which the ratio is believed


@kernel
def _left(resistance: float, inductance: float, dt: float) -> float:
    """The share of a change of the current that is left after a tick: e^(−R dt/L)."""
    return float(np.exp(-resistance * dt / inductance)) if inductance > 0.0 else 0.0


@kernel
def _learn(
    weight: float,
    voltage: float,
    dt: float,
    duties: Array,
    currents: Array,
    before: Array,
    emf: Array,
    trusted: Array,
    low: Array,
    high: Array,
    sums: Array,
    resistance: Array,
    inductance: Array,
) -> None:
    for j in range(duties.size):
        now, then = currents[j], before[j]
        if not np.isfinite(now):
            continue
        before[j] = now
        if abs(now - then) > _STEADY * abs(now):
            continue
        # What the voltage would have led to if it had lasted: it is this current that the resistance tells.
        left = _left(resistance[j], inductance[j], dt)
        i = (now - left * then) / (1.0 - left)
        # Eq. (6) is mean duty over mean current; weighting both with the current is the same for steady currents, and
        # has no pole when a current changes sign.
        sums[0, j] += weight * ((voltage * duties[j] - emf[j]) * i - sums[0, j])
        sums[1, j] += weight * (i * i - sums[1, j])
        if sums[1, j] > trusted[j] * trusted[j]:
            resistance[j] = min(max(sums[0, j] / sums[1, j], low[j]), high[j])


@kernel
def _duties(
    weight: float, voltage: float, dt: float, wanted: Array, measured: Array, applied: Array, emf: Array,
    emf_before: Array, trusted: Array, low: Array, high: Array, sums: Array, resistance: Array, inductance: Array,
    last: Array, before: Array, out: Array,
) -> None:  # fmt: skip
    _learn(weight, voltage, dt, applied, measured, before, emf_before, trusted, low, high, sums, resistance, inductance)
    largest = 0.0
    for j in range(wanted.size):
        # Eq. (4) for the current at which this tick's exponential must aim to be at `wanted` when the tick ends, and
        # the voltage that the moving mover takes.
        left = _left(resistance[j], inductance[j], dt)
        out[j] = (resistance[j] * (last[j] + (wanted[j] - last[j]) / (1.0 - left)) + emf[j]) / voltage
        largest = max(largest, abs(out[j]))
    for j in range(wanted.size):
        emf_before[j] = emf[j]
        if largest > 1.0:
            out[j] /= largest
            left = _left(resistance[j], inductance[j], dt)
            aim = (out[j] * voltage - emf[j]) / resistance[j]
            last[j] = aim + (last[j] - aim) * left  # as far as the supply can bring it
        else:
            last[j] = wanted[j]


class Drive:
    """Duties for currents; learns each coil's resistance from what flowed. Cold start, zero current and saturation
    leave the last believed resistance in place; it can never leave what copper can have."""

    def __init__(self, device: Device, dt: float) -> None:
        coils = device.coils
        channels = device.channels
        self._voltage = device.supply.voltage
        self._inductance = coils.inductance
        self._dt = dt
        self._weight = min(1.0, dt / _WINDOW)
        self._low = coils.resistance_at(np.full(channels, _COLDEST))
        self._high = coils.resistance_at(np.full(channels, _HOTTEST))
        self.resistance = coils.resistance_at(np.full(channels, coils.heat.ambient))
        self._sums = np.zeros((2, channels))
        self._last = np.zeros(channels)  # where the currents should be now
        self._before = np.zeros(channels)  # where they were measured a tick ago
        self._trusted = _TRUST * coils.current_limit
        self._emf = np.zeros(channels)  # under which the last duties were applied
        self._still = np.zeros(channels)
        self._out = np.zeros(channels)

    @property
    def lag(self) -> float:
        """By how much the currents' rise within a tick is late, on average over it and at worst over the coils [s]."""
        x = self.resistance * self._dt / np.maximum(self._inductance, 1e-12)
        return float(self._dt * np.max(1 + 1 / x + 1 / np.expm1(-x)))

    def duties(self, wanted: Array, measured: Array, applied: Array, emf: Array | None = None) -> Array:
        """(m,) duties in −1…1 for `wanted` currents, after learning from `measured` currents under `applied` duties.

        emf (m,) [V] is what the moving mover induces against the currents now; None: nothing.
        """
        induced = self._still if emf is None else emf
        _duties(
            self._weight, self._voltage, self._dt, wanted, measured, applied, induced, self._emf, self._trusted,
            self._low, self._high, self._sums, self.resistance, self._inductance, self._last,
            self._before, self._out,
        )  # fmt: skip
        return self._out

    def rest(self) -> Array:
        """(m,) zeros: the coils are off, and the next wanted current starts from nothing. In duties from −1 to 1."""
        self._last[:] = 0.0
        self._emf[:] = 0.0
        self._out[:] = 0.0
        return self._out
