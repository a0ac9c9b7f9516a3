"""The last word before the coils: nothing passes that is not finite, bounded, slewed, fresh and cool enough.

Off is the default state and the end of every path. A trip latches with its reason; only `engage` leaves it, and only
when the reason is gone. The guard trusts nobody above it, least of all the world.
"""

from __future__ import annotations

from math import isfinite, sqrt
from typing import TYPE_CHECKING

import numpy as np

from haptorb.control.heat_observer import HeatObserver
from haptorb.control.trip import GuardState, Trip
from haptorb.devices.device import Device
from haptorb.physics.arrays import Array
from haptorb.physics.compiled import kernel

if TYPE_CHECKING:
    from haptorb.sensing.sample import Estimate, Sample

__all__ = ["Guard"]

_RAMP_UP = 0.3  #: from nothing to the full wrench after engaging [s]
_RAMP_DOWN = 0.05  #: to nothing after a pose went stale [s]; the other reasons switch off at once
_OVERCURRENT = 1.25  #: measured over allowed current at which wiring or driver must be broken


@kernel
def _look(currents: Array, temperatures: Array, limit: Array) -> int:
    """0: readings are sane; 1: one is not a number; 2: a current is beyond what may flow."""
    total = 0.0
    beyond = False
    for j in range(currents.size):
        total += currents[j] + temperatures[j]
        beyond = beyond or abs(currents[j]) > limit[j]
    if not np.isfinite(total):
        return 1
    return 2 if beyond else 0


@kernel
def _hold(wanted: Array, last: Array, limit: Array, step: float, out: Array) -> bool:
    """Scale `wanted` into the limits, then its change into `step`, keeping directions; False if not finite."""
    for j in range(wanted.size):
        if not np.isfinite(wanted[j]):
            return False
    scale = 1.0
    for j in range(wanted.size):
        if abs(wanted[j]) * scale > limit[j]:
            scale = limit[j] / abs(wanted[j])
    largest = 0.0
    for j in range(wanted.size):
        largest = max(largest, abs(scale * wanted[j] - last[j]))
    share = 1.0 if largest <= step else step / largest
    for j in range(wanted.size):
        out[j] = last[j] + share * (scale * wanted[j] - last[j])
    return True


class Guard:
    """Clamp, slew, derate, expire, trip: one `admit` and one `limit` per tick.

    It looks at the estimate's age, at measured currents and at temperatures; what it lets through is in `currents`.
    """

    def __init__(self, device: Device, dt: float) -> None:
        self._limits = device.limits
        self._current_limit = device.coils.current_limit
        self._broken = _OVERCURRENT * device.coils.current_limit
        self._tiers = device.coils.heat
        self._dt = dt
        self._step = device.limits.slew * dt
        self.heat = HeatObserver(device.coils, dt)
        self.state = GuardState.OFF
        self.reason = Trip.NONE
        self.trips = 0
        self.gain = 0.0
        self._fresh = False  # whether the last estimate could be believed
        self._last = np.zeros(device.channels)
        self._currents = np.zeros(device.channels)
        self._zeros = np.zeros(device.channels)
        self._wrench = np.zeros(6)

    @property
    def tripped(self) -> bool:
        """Whether the coils are off for a reason, until somebody engages."""
        return self.state is GuardState.TRIPPED

    def trip(self, reason: Trip) -> None:
        """Coils off, latched. The first reason stands until `engage`; a later one does not hide it."""
        if self.state is GuardState.TRIPPED:
            return
        self.state = GuardState.TRIPPED
        self.reason = reason
        self.trips += 1
        if reason is not Trip.POSE_EXPIRED:
            self.gain = 0.0

    def engage(self) -> bool:
        """Leave OFF or TRIPPED and ramp up from zero; False if the reason is still there."""
        if self.state not in (GuardState.OFF, GuardState.TRIPPED):
            return True
        if not self._fresh or float(self.heat.winding.max()) >= self._tiers.derate:
            return False
        self.state = GuardState.RAMPING
        self.reason = Trip.NONE
        self.gain = 0.0
        return True

    def admit(self, wrench: Array, estimate: Estimate) -> Array:
        """The part of the world's `wrench` (6,) that may be asked now: clamped, faded; zero when anything is wrong.

        In [N, N·m].
        """
        self._fresh = estimate.valid and estimate.age <= self._limits.expiry
        if estimate.reversed:  # said even while off: nobody could engage, and would not know why
            self.trip(Trip.MAGNET_REVERSED)
        elif not self._fresh and self.state not in (GuardState.OFF, GuardState.TRIPPED):
            self.trip(Trip.POSE_EXPIRED if estimate.valid else Trip.POSE_LOST)
        self._fade()
        fx, fy, fz, tx, ty, tz = wrench.tolist()
        force, torque = sqrt(fx * fx + fy * fy + fz * fz), sqrt(tx * tx + ty * ty + tz * tz)
        out = self._wrench
        if not isfinite(force + torque):
            if self.state is not GuardState.OFF:
                self.trip(Trip.WORLD_NOT_FINITE)
            out[:] = 0.0
            return out
        f = self.gain if force <= self._limits.force else self.gain * self._limits.force / force
        t = self.gain if torque <= self._limits.torque else self.gain * self._limits.torque / torque
        out[0], out[1], out[2] = f * fx, f * fy, f * fz
        out[3], out[4], out[5] = t * tx, t * ty, t * tz
        return out

    def limit(self, currents: Array, sample: Sample) -> Array:
        """(m,) the currents that may flow: within limits and slew, derated when warm, zero when off or tripped.

        In [A].
        """
        seen = _look(sample.currents, sample.temperatures, self._broken)
        if seen == 1:
            self.trip(Trip.SAMPLE_NOT_FINITE)
        else:
            self.heat.update(sample.currents, sample.temperatures)
            if seen == 2:
                self.trip(Trip.OVERCURRENT)
        hottest = self.heat.hottest
        if not hottest < self._tiers.stop:  # written so that NaN trips too
            self.trip(Trip.OVERHEATED)
        if self.state is GuardState.OFF or (self.state is GuardState.TRIPPED and self.gain == 0.0):
            self._last[:] = 0.0
            return self._zeros
        if hottest > self._tiers.derate:
            share = (self._tiers.stop - hottest) / (self._tiers.stop - self._tiers.derate)
            currents = currents * share
            if self.state is GuardState.RUNNING:
                self.state = GuardState.DERATED
        elif self.state is GuardState.DERATED and hottest < self._tiers.derate - 1.0:
            self.state = GuardState.RUNNING
        if not _hold(currents, self._last, self._current_limit, self._step, self._currents):
            self.trip(Trip.CURRENTS_NOT_FINITE)
            self._last[:] = 0.0
            return self._zeros
        self._last[:] = self._currents
        return self._currents

    def _fade(self) -> None:
        if self.state is GuardState.TRIPPED:
            self.gain = max(0.0, self.gain - self._dt / _RAMP_DOWN)
        elif self.state is GuardState.RAMPING:
            self.gain = min(1.0, self.gain + self._dt / _RAMP_UP)
            if self.gain == 1.0:
                self.state = GuardState.RUNNING
