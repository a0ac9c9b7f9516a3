"""The guard's rules on bare numbers: what may be asked, what may flow, and when to switch off for good.

All that a guard remembers between two ticks lies in two arrays, so that one compiled pass can run the rules with what
comes before and after them. `Guard` is the door for people.

numbers (12,)  state, reason, trips, gain, whether the last estimate could be believed, time since
               the last tick, and the settings
coils (4, m)   currents let through now and in the tick before, the limit, and where wiring must be broken [A]
"""

from __future__ import annotations

import numpy as np

from haptorb.control.protection.heat_observer import HOTTEST, observe
from haptorb.control.protection.tick_time import advance_clock
from haptorb.control.protection.trip import GuardState, Trip
from haptorb.numerics.arrays import Array, Records
from haptorb.numerics.compiled import kernel

__all__ = [
    "BROKEN", "DERATE", "ELAPSED", "EXPIRY", "FORCE", "FRESH", "GAIN", "HELD", "LAST", "LIMIT", "REASON", "SLEW",
    "STATE", "STOP", "TORQUE", "TRIPS", "admit", "limit", "pass_time", "trip",
]  # fmt: skip

STATE, REASON, TRIPS, GAIN, FRESH, ELAPSED, EXPIRY, FORCE, TORQUE, SLEW, DERATE, STOP = range(12)
HELD, LAST, LIMIT, BROKEN = range(4)

_RAMP_UP = 0.3  #: from nothing to the full wrench after engaging [s]
_RAMP_DOWN = 0.05  #: to nothing after a pose went stale [s]; the other reasons switch off at once
_COOLER = 1.0  #: below the derating temperature before the full current may flow again [K]

_OFF, _RAMPING, _RUNNING = int(GuardState.OFF), int(GuardState.RAMPING), int(GuardState.RUNNING)
_DERATED, _TRIPPED = int(GuardState.DERATED), int(GuardState.TRIPPED)
_EXPIRED, _LOST, _REVERSED = int(Trip.POSE_EXPIRED), int(Trip.POSE_LOST), int(Trip.MAGNET_REVERSED)
_WORLD, _CURRENTS = int(Trip.WORLD_NOT_FINITE), int(Trip.CURRENTS_NOT_FINITE)
_SAMPLE, _OVERHEATED, _OVERCURRENT = int(Trip.SAMPLE_NOT_FINITE), int(Trip.OVERHEATED), int(Trip.OVERCURRENT)
_OVERRUN, _MISMATCH = int(Trip.OVERRUN), int(Trip.CURRENT_MISMATCH)


@kernel
def trip(numbers: Array, reason: int) -> None:
    """Coils off, latched. The first reason stands until somebody engages; a later one does not hide it."""
    if reason != _EXPIRED:  # that one fades; whatever comes while it does, a Stop first of all, ends it at once
        numbers[GAIN] = 0.0
    if numbers[STATE] == _TRIPPED:
        return
    numbers[STATE] = _TRIPPED
    numbers[REASON] = reason
    numbers[TRIPS] += 1.0


@kernel
def _fade(numbers: Array) -> None:
    if numbers[STATE] == _TRIPPED:
        numbers[GAIN] = max(0.0, numbers[GAIN] - numbers[ELAPSED] / _RAMP_DOWN)
    elif numbers[STATE] == _RAMPING:
        numbers[GAIN] = min(1.0, numbers[GAIN] + numbers[ELAPSED] / _RAMP_UP)
        if numbers[GAIN] == 1.0:
            numbers[STATE] = _RUNNING


@kernel
def pass_time(numbers: Array, coils: Array, clock: Records, now: float) -> None:
    """A tick begins at `now` [s]: what ramps, slews, heats and expires goes by the time that really passed.

    After a silence in which the device has switched off by itself the ramp begins again at zero; too many missed
    deadlines trip. clock (1,) is `tick_time.CLOCK`.
    """
    numbers[ELAPSED] = advance_clock(clock, now)
    if clock[0].restart:
        numbers[ELAPSED] = clock[0].period  # nothing ramps and nothing slews by a silence
    if numbers[STATE] == _OFF or numbers[STATE] == _TRIPPED:
        clock[0].missed[:] = 0.0
        return
    if clock[0].overrun:
        trip(numbers, _OVERRUN)
    elif clock[0].restart:
        numbers[STATE] = _RAMPING
        numbers[GAIN] = 0.0
        _nothing(coils)


@kernel
def admit(numbers: Array, wrench: Array, valid: bool, age: float, reversed: bool, out: Array) -> None:
    """out (6,) becomes the part of `wrench` (6,) that may be asked now, of an estimate that is `age` [s] old."""
    fresh = valid and age <= numbers[EXPIRY]
    numbers[FRESH] = 1.0 if fresh else 0.0
    if reversed:  # said even while off: nobody could engage, and would not know why
        trip(numbers, _REVERSED)
    elif not fresh and numbers[STATE] != _OFF and numbers[STATE] != _TRIPPED:
        trip(numbers, _EXPIRED if valid else _LOST)
    _fade(numbers)
    force, torque = 0.0, 0.0
    for i in range(3):
        force += wrench[i] * wrench[i]
        torque += wrench[3 + i] * wrench[3 + i]
    force, torque = np.sqrt(force), np.sqrt(torque)
    if not np.isfinite(force + torque):
        if numbers[STATE] != _OFF:
            trip(numbers, _WORLD)
        for i in range(6):
            out[i] = 0.0
        return
    f = numbers[GAIN] if force <= numbers[FORCE] else numbers[GAIN] * numbers[FORCE] / force
    t = numbers[GAIN] if torque <= numbers[TORQUE] else numbers[GAIN] * numbers[TORQUE] / torque
    for i in range(3):
        out[i] = f * wrench[i]
        out[3 + i] = t * wrench[3 + i]


@kernel
def limit(
    numbers: Array, coils: Array, heat: Array, windings: Array, wanted: Array, measured: Array, temperatures: Array,
    plausible: bool,
) -> None:  # fmt: skip
    """coils[HELD] becomes what may flow of `wanted` (m,) [A]: within limits and slew, derated when warm, else zero.

    measured (m,) [A] and temperatures (m,) [K] are readings; heat (14,) and windings (6, m) a `HeatObserver`'s memory;
    plausible: the readings of the currents match the duties (`current_check`).
    """
    seen = _look(coils[BROKEN], measured, temperatures)
    if seen == 1:
        trip(numbers, _SAMPLE)  # and nothing is learned from it
    else:
        observe(heat, windings, measured, temperatures)
        if seen == 2:
            trip(numbers, _OVERCURRENT)
        elif not plausible:
            trip(numbers, _MISMATCH)
    hottest = heat[HOTTEST]
    if not hottest < numbers[STOP]:  # written so that NaN trips too
        trip(numbers, _OVERHEATED)
    count = wanted.shape[0]
    if numbers[STATE] == _OFF or (numbers[STATE] == _TRIPPED and numbers[GAIN] == 0.0):
        _nothing(coils)
        return
    share = 1.0
    if hottest > numbers[DERATE]:
        share = (numbers[STOP] - hottest) / (numbers[STOP] - numbers[DERATE])
        if numbers[STATE] == _RUNNING:
            numbers[STATE] = _DERATED
    elif numbers[STATE] == _DERATED and hottest < numbers[DERATE] - _COOLER:
        numbers[STATE] = _RUNNING
    for j in range(count):
        if not np.isfinite(wanted[j]):
            trip(numbers, _CURRENTS)
            _nothing(coils)
            return
    _hold(coils, wanted, share, numbers[SLEW] * numbers[ELAPSED])


@kernel
def _look(broken: Array, measured: Array, temperatures: Array) -> int:
    """0: readings are sane; 1: one is not a number; 2: a current is beyond what may flow."""
    total = 0.0
    beyond = False
    for j in range(measured.size):
        total += measured[j] + temperatures[j]
        beyond = beyond or abs(measured[j]) > broken[j]
    if not np.isfinite(total):
        return 1
    return 2 if beyond else 0


@kernel
def _nothing(coils: Array) -> None:
    for j in range(coils.shape[1]):
        coils[HELD, j] = 0.0
        coils[LAST, j] = 0.0


@kernel
def _hold(coils: Array, wanted: Array, share: float, step: float) -> None:
    """Scale `share` of `wanted` into the limits, then its change into `step`, keeping directions."""
    scale = share
    for j in range(wanted.size):
        if abs(wanted[j]) * scale > coils[LIMIT, j]:
            scale = coils[LIMIT, j] / abs(wanted[j])
    largest = 0.0
    for j in range(wanted.size):
        largest = max(largest, abs(scale * wanted[j] - coils[LAST, j]))
    slewed = 1.0 if largest <= step else step / largest
    for j in range(wanted.size):
        coils[HELD, j] = coils[LAST, j] + slewed * (scale * wanted[j] - coils[LAST, j])
    for j in range(wanted.size):
        coils[LAST, j] = coils[HELD, j]
