"""The tool as a cursor: the newest tick in plain numbers, the last ones that were finite."""

from __future__ import annotations

from math import isfinite
from typing import final

from haptorb.apps.serve.haply.transform import Quaternion, Vector
from haptorb.apps.serve.served_device import ServedDevice
from haptorb.control.protection.trip import GuardState

__all__ = ["Cursor"]


@final
class Cursor:
    """What the newest row of `served` says; `look` at it before reading.

    place, velocity, force   of the tool, or of a motor's target, in the stator's frame [m, m/s, N]
    turn                     orientation of the tool or the handle, quaternion (x, y, z, w)
    tick                     rows published when it looked: the same number is the same cursor
    known                    whether a pose was ever valid
    ready, tripped           whether forces are rendered now; whether the guard has switched off
    derated, damped          whether less is rendered for warm coils; whether the passivity control adds damping
    trip                     code of the last trip's reason
    """

    def __init__(self, served: ServedDevice) -> None:
        self._served, layout = served, served.layout
        self._direct = not served.facts.get("modes")
        self._p = layout["p" if self._direct else "object"]
        self._v, self._q = layout["v"], layout["q"]
        self._force = layout["asked" if self._direct else "object_wrench"].start
        self._t = layout["t"].start
        self._guard, self._trip, self._valid = layout["guard"].start, layout["trip"].start, layout["valid"].start
        self._injected = layout["injected"].start
        self.place: Vector = self._rest(served)
        self.velocity: Vector = (0.0, 0.0, 0.0)
        self.force: Vector = (0.0, 0.0, 0.0)
        self.turn: Quaternion = (0.0, 0.0, 0.0, 1.0)
        self.tick, self.t, self.trip = -1, 0.0, 0
        self.known = self.ready = self.tripped = self.derated = self.damped = False

    def _rest(self, served: ServedDevice) -> Vector:
        shell = served.device.shell
        return (0.0, 0.0, 0.0 if shell is None else shell.contact_distance)

    def look(self) -> None:
        """Read the newest row, if there is a newer one."""
        served = self._served
        tick = served.tick_count
        if tick == self.tick or (row := served.latest()) is None:
            return
        self.tick = tick
        n = row.tolist()
        guard, trip = n[self._guard], n[self._trip]
        self.tripped = guard == GuardState.TRIPPED
        self.ready = guard in (GuardState.RAMPING, GuardState.RUNNING, GuardState.DERATED)
        self.derated, self.damped = guard == GuardState.DERATED, n[self._injected] > 0.0
        self.trip = int(trip) if isfinite(trip) else 0
        if n[self._valid] != 1.0:
            self.velocity = self.force = (0.0, 0.0, 0.0)
            return
        x, y, z = n[self._p]
        if isfinite(x + y + z):
            if self._direct:
                self.velocity = self._check_vector(n[self._v])
            elif self.known and n[self._t] > self.t:  # of a target the rows have places only
                dt = n[self._t] - self.t
                a, b, c = self.place
                self.velocity = ((x - a) / dt, (y - b) / dt, (z - c) / dt)
            self.place, self.t, self.known = (x, y, z), n[self._t], True
        a, b, c, d = n[self._q]
        if isfinite(a + b + c + d):
            self.turn = (a, b, c, d)
        self.force = self._check_vector(n[self._force : self._force + 3])

    @staticmethod
    def _check_vector(numbers: list[float]) -> Vector:
        a, b, c = numbers
        return (a, b, c) if isfinite(a + b + c) else (0.0, 0.0, 0.0)
