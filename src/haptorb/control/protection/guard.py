"""The last word before the coils: nothing passes that is not finite, bounded, slewed, fresh and cool enough.

Off is the default state and the end of every path. A trip latches with its reason; only `engage` leaves it, and only
when the reason is gone. The guard trusts nobody above it, least of all the world.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from haptorb.control.protection import guard_rules as rules
from haptorb.control.protection.current_check import CurrentCheck
from haptorb.control.protection.heat_observer import ELAPSED, PENDING, HeatObserver
from haptorb.control.protection.tick_time import make_clock
from haptorb.control.protection.trip import GuardState, Trip
from haptorb.devices.device import Device
from haptorb.numerics.arrays import Array, Records

if TYPE_CHECKING:
    from haptorb.sensing.sample import Estimate, Sample

__all__ = ["Guard"]

_OVERCURRENT = 1.25  #: measured over allowed current at which wiring or driver must be broken


class Guard:
    """Clamp, slew, derate, expire, trip: one `admit` and one `limit` per tick.

    It looks at the estimate's age, at measured currents and at temperatures; what it lets through is in `currents`.

    numbers  (12,) and coils (4, m): all that it remembers, laid out as `guard_rules` says, for compiled code
    """

    def __init__(self, device: Device, dt: float) -> None:
        limits, heat, channels = device.limits, device.coils.heat, device.channels
        self.heat = HeatObserver(device.coils, dt)
        self.check = CurrentCheck(device)
        self.clock: Records = make_clock(dt)  #: (1,) `tick_time.CLOCK`: the time that really passes between two ticks
        self.coils: Array = np.zeros((4, channels))
        self.coils[rules.LIMIT] = device.coils.current_limit
        self.coils[rules.BROKEN] = _OVERCURRENT * device.coils.current_limit
        self.numbers: Array = np.zeros(12)
        self.numbers[rules.ELAPSED], self.numbers[rules.EXPIRY], self.numbers[rules.SLEW] = (
            dt,
            limits.expiry,
            limits.slew,
        )
        self.numbers[rules.FORCE], self.numbers[rules.TORQUE] = limits.force, limits.torque
        self.numbers[rules.DERATE], self.numbers[rules.STOP] = heat.derate, heat.stop
        self.numbers[rules.STATE] = GuardState.OFF
        self.currents: Array = self.coils[rules.HELD]  #: (m,) what may flow now [A]
        self._wrench = np.zeros(6)
        rules.trip(self.numbers.copy(), int(Trip.NONE))  # compiled now, and not when it is needed

    @property
    def state(self) -> GuardState:
        """What it is doing."""
        return GuardState(int(self.numbers[rules.STATE]))

    @property
    def reason(self) -> Trip:
        """Why the coils are off."""
        return Trip(int(self.numbers[rules.REASON]))

    @property
    def trips(self) -> int:
        """How often it has tripped."""
        return int(self.numbers[rules.TRIPS])

    @property
    def gain(self) -> float:
        """The share of the wrench that is let through now, 0 to 1."""
        return float(self.numbers[rules.GAIN])

    @property
    def tripped(self) -> bool:
        """Whether the coils are off for a reason, until somebody engages."""
        return self.state is GuardState.TRIPPED

    @property
    def engaged(self) -> bool:
        """Whether current may flow: neither off nor tripped."""
        return self.state not in (GuardState.OFF, GuardState.TRIPPED)

    def trip(self, reason: Trip) -> None:
        """Coils off, latched. The first reason stands until `engage`; a later one does not hide it."""
        rules.trip(self.numbers, int(reason))

    def engage(self) -> bool:
        """Leave OFF or TRIPPED and ramp up from zero; False if the reason is still there."""
        if self.engaged:
            return True
        if not self.numbers[rules.FRESH] or not self.heat.winding.max() < self.numbers[rules.DERATE]:
            return False
        self.numbers[rules.STATE] = GuardState.RAMPING
        self.numbers[rules.REASON] = Trip.NONE
        self.numbers[rules.GAIN] = 0.0
        self.check.restart()
        return True

    def pass_time(self, now: float) -> None:
        """A tick begins at `now` [s] on the loop's clock; before `admit`. Without it every tick takes `dt`."""
        rules.pass_time(self.numbers, self.coils, self.clock, now)

    def skip(self, now: float) -> None:
        """A tick at `now` [s] in which nothing could be read: time passes, and the windings are looked at later."""
        self.pass_time(now)
        self.heat.numbers[PENDING] += self.clock["elapsed"][0]

    def admit(self, wrench: Array, estimate: Estimate) -> Array:
        """The part of the world's `wrench` (6,) that may be asked now: clamped, faded; zero when anything is wrong.

        In [N, N·m].
        """
        rules.admit(self.numbers, wrench, estimate.valid, estimate.age, estimate.reversed, self._wrench)
        return self._wrench

    def limit(self, currents: Array, sample: Sample) -> Array:
        """(m,) the currents that may flow: within limits and slew, derated when warm, zero when off or tripped.

        In [A].
        """
        heat = self.heat
        heat.numbers[ELAPSED] = self.clock["elapsed"][0]
        rules.limit(
            self.numbers, self.coils, heat.numbers, heat.coils, currents, sample.currents, sample.temperatures,
            True,
        )  # fmt: skip
        return self.currents
