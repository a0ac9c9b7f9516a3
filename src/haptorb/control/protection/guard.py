"""The guard's rules: what may be asked, what may flow, and when to switch off until a person engages.

Off is the default state and the end of every path. A trip latches with its reason; only a person who engages leaves it,
and only when the reason is gone. The guard trusts nothing above it, least of all the world.

Lines that keep a rule are marked with `safety:` and its name; `scripts/prove_safety.py` breaks each and sees a test
go red.
"""

from __future__ import annotations

import numpy as np

from haptorb.control.protection.tick_time import advance_clock
from haptorb.control.protection.trip import GuardState, Trip
from haptorb.numerics.arrays import Array, Record, Records
from haptorb.numerics.compiled import kernel

__all__ = ["begin_tick", "check_estimate", "check_readings", "limit_currents", "limit_wrench", "pass_over", "trip"]

_RAMP_UP = 0.3  #: from nothing to the full wrench after engaging [s]
_RAMP_DOWN = 0.05  #: to nothing after a pose went stale [s]; the other reasons switch off at once
_CHANGE_OVER = 0.05  #: from the greatest force or torque to nothing, and back, where worlds change [s]
_ABSENCE = 0.5  #: of ticks, after which only a person switches on again: a process that was stopped [s]
_COOLER = 1.0  #: below the derating temperature before the full current may flow again [K]

_OFF, _RAMPING, _RUNNING = int(GuardState.OFF), int(GuardState.RAMPING), int(GuardState.RUNNING)
_DERATED, _TRIPPED = int(GuardState.DERATED), int(GuardState.TRIPPED)
_EXPIRED, _LOST, _REVERSED = int(Trip.POSE_EXPIRED), int(Trip.POSE_LOST), int(Trip.MAGNET_REVERSED)
_WORLD, _CURRENTS = int(Trip.WORLD_NOT_FINITE), int(Trip.CURRENTS_NOT_FINITE)
_OVERHEATED, _OVERRUN = int(Trip.OVERHEATED), int(Trip.OVERRUN)
_NONE, _SAMPLE, _OVERCURRENT = int(Trip.NONE), int(Trip.SAMPLE_NOT_FINITE), int(Trip.OVERCURRENT)


@kernel
def trip(g: Record, reason: int) -> None:
    """Coils off, latched. The first `reason` remains until a person engages; a later one does not hide it."""
    if reason != _EXPIRED:  # that one fades; any other reason meanwhile, such as a Stop, ends the fade at once
        g.gain = 0.0
    if g.state == _TRIPPED:
        return
    g.state = _TRIPPED  # safety: trips-latch
    g.reason = reason
    g.trips += 1


@kernel
def begin_tick(clock: Record, g: Record, now: float) -> None:
    """A tick begins at `now` [s]: what ramps, slews, heats and expires goes by the time that really passed.

    After a silence in which the device has switched off by itself the ramp begins again at zero; too many missed
    deadlines trip, and so does a silence so long that a person no longer expects a force. clock is a CLOCK, g a GUARD.
    """
    g.dt = advance_clock(clock, now)
    if clock.restart:
        g.dt = clock.period  # nothing ramps and nothing slews by a silence
    if g.state == _OFF or g.state == _TRIPPED:
        clock.missed[:] = 0.0
        return
    absent = clock.elapsed > _ABSENCE  # safety: absence-trips
    if absent or clock.overrun:  # safety: missed-deadlines-trip
        trip(g, _OVERRUN)
    elif clock.restart:  # safety: ramp-after-silence
        g.state = _RAMPING
        g.gain = 0.0
        g.restarted = True


@kernel
def check_estimate(g: Record, valid: bool, age: float, reversed: bool) -> None:
    """Trip unless the pose is `valid`, its `age` [s] below the expiry, and the magnet the right way round."""
    g.fresh = valid and age <= g.expiry  # safety: stale-poses-trip, lost-poses-trip
    if reversed:  # safety: reversed-magnet-trips
        trip(g, _REVERSED)
    elif not g.fresh and g.state != _OFF and g.state != _TRIPPED:
        trip(g, _EXPIRED if valid else _LOST)


@kernel
def _fade(g: Record) -> None:
    if g.state == _TRIPPED:
        g.gain = max(0.0, g.gain - g.dt / _RAMP_DOWN)
    elif g.state == _RAMPING:
        g.gain = min(1.0, g.gain + g.dt / _RAMP_UP)
        if g.gain == 1.0:
            g.state = _RUNNING


@kernel
def _approach(now: Array, goal: Array, limit: float, step: float) -> bool:
    """Move `now` (3,) by at most `step` towards `goal` (3,), both clamped to the size `limit`; whether it is there."""
    size, before, way = 0.0, 0.0, 0.0
    for i in range(3):
        size += goal[i] * goal[i]
        before += now[i] * now[i]
    share = 1.0 if size <= limit * limit else limit / np.sqrt(size)
    if before > limit * limit:
        for i in range(3):
            now[i] *= limit / np.sqrt(before)
    for i in range(3):
        way += (share * goal[i] - now[i]) ** 2
    way = np.sqrt(way)
    if way <= step:
        for i in range(3):
            now[i] = share * goal[i]
        return True
    for i in range(3):
        now[i] += (share * goal[i] - now[i]) * step / way
    return False


@kernel
def _steps(g: Record, now: Array) -> tuple[float, float]:
    """By how much force [N] and torque [N·m] of `now` (6,) may change in this tick; the ramp's own change counts."""
    force, torque = g.force_rate * g.dt, g.torque_rate * g.dt
    if g.state == _RAMPING:
        ramped = g.dt / _RAMP_UP
        force -= ramped * np.sqrt(now[0] ** 2 + now[1] ** 2 + now[2] ** 2)
        torque -= ramped * np.sqrt(now[3] ** 2 + now[4] ** 2 + now[5] ** 2)
    return max(force, 0.0), max(torque, 0.0)


@kernel
def pass_over(g: Record, wrench: Array, session: float, mapping: float) -> None:
    """g.wanted (6,) becomes `wrench` (6,) [N, N·m], where who commands, and which way, changes only through zero.

    Of it, g.commanded is what the client `session` commands through its `mapping`: that part changes at the rate limits
    at most. Another client, and another mapping, are rendered when the force of before has become zero. So is another
    world; once its wrench has been reached, it may change as fast as it likes. What is off begins at zero.
    """
    total = 0.0
    for i in range(6):
        total += wrench[i] + g.commanded[i]
        g.wanted[i] = wrench[i]
    if not np.isfinite(total):  # the wrench's limits handle it
        return
    if g.gain == 0.0 and (g.state == _OFF or g.state == _TRIPPED):
        g.client[:] = 0.0
        g.world[:] = 0.0
        g.leaving = g.arriving = False
        return
    force, torque = _steps(g, g.client)
    silent = True
    for i in range(6):
        silent = silent and g.client[i] == 0.0
    if silent:
        g.session, g.mapping = session, mapping
    share = 1.0 if g.session == session and g.mapping == mapping else 0.0  # safety: clients-pass-zero
    goal = g.wanted  # used as room for it
    for i in range(6):
        goal[i] = share * g.commanded[i]
    _approach(g.client[:3], goal[:3], g.force, force)  # safety: client-force-rate
    _approach(g.client[3:], goal[3:], g.torque, torque)  # safety: client-torque-rate
    force, torque = _steps(g, g.world)
    share = g.dt / _CHANGE_OVER  # slower than a client may push: a person who holds the device does not expect it
    force, torque = min(force, share * g.force), min(torque, share * g.torque)
    if g.leaving:
        goal[:] = 0.0
        there = _approach(g.world[:3], goal[:3], g.force, force)
        there = _approach(g.world[3:], goal[3:], g.torque, torque) and there
        if there:
            g.leaving, g.arriving = False, True
    elif g.arriving:
        for i in range(6):
            goal[i] = wrench[i] - g.commanded[i]
        there = _approach(g.world[:3], goal[:3], g.force, force)
        there = _approach(g.world[3:], goal[3:], g.torque, torque) and there
        g.arriving = not there
    whole = not (g.leaving or g.arriving)
    if whole:  # safety: contacts-are-free
        for i in range(6):
            g.world[i] = wrench[i] - g.commanded[i]
    for i in range(6):
        whole = whole and g.client[i] == g.commanded[i]
    for i in range(6):
        g.wanted[i] = wrench[i] if whole else g.world[i] + g.client[i]


@kernel
def limit_wrench(g: Record) -> None:
    """g.asked, a wrench (6,) [N, N·m], becomes its part that may be asked now: clamped, faded; zero when it is off."""
    _fade(g)
    wrench = g.asked
    force, torque = 0.0, 0.0
    for i in range(3):
        force += wrench[i] * wrench[i]
        torque += wrench[3 + i] * wrench[3 + i]
    force, torque = np.sqrt(force), np.sqrt(torque)
    if not np.isfinite(force + torque):  # safety: nan-wrench-trips
        if g.state != _OFF:
            trip(g, _WORLD)
        wrench[:] = 0.0
        return
    f = g.gain if force <= g.force else g.gain * g.force / force  # safety: force-is-clamped
    t = g.gain if torque <= g.torque else g.gain * g.torque / torque  # safety: torque-is-clamped
    for i in range(3):
        wrench[i] *= f
        wrench[3 + i] *= t


@kernel
def check_readings(coils: Records) -> int:
    """The reason to trip that measured currents and temperatures give by themselves, 0 for none."""
    total = 0.0
    beyond = False
    for j in range(coils.size):
        c = coils[j]
        total += c.current + c.boundary
        beyond = beyond or abs(c.current) > c.broken
    if not np.isfinite(total):  # safety: nan-readings-trip
        return _SAMPLE
    return _OVERCURRENT if beyond else _NONE  # safety: overcurrent-trips


@kernel
def limit_currents(g: Record, heat: Record, coils: Records, wanted: Array) -> None:
    """`held` of `coils` (m,) becomes what may flow of `wanted` (m,) [A]: within limits and slew, derated when warm,
    zero when it is off."""
    if g.restarted:
        _clear_currents(coils)
        g.restarted = False
    hottest = heat.hottest
    if not hottest < heat.stop:  # safety: hot-coils-trip
        trip(g, _OVERHEATED)
    if g.state == _OFF or (g.state == _TRIPPED and g.gain == 0.0):
        _clear_currents(coils)
        return
    share = 1.0
    if hottest > heat.derate:
        share = (heat.stop - hottest) / (heat.stop - heat.derate)
        if g.state == _RUNNING:
            g.state = _DERATED
    elif g.state == _DERATED and hottest < heat.derate - _COOLER:
        g.state = _RUNNING
    for j in range(wanted.size):
        if not np.isfinite(wanted[j]):  # safety: nan-currents-trip
            trip(g, _CURRENTS)
            _clear_currents(coils)
            return
    _hold(g, coils, wanted, share)  # safety: warm-coils-are-derated


@kernel
def _clear_currents(coils: Records) -> None:
    for j in range(coils.size):
        coils[j].held = 0.0


@kernel
def _hold(g: Record, coils: Records, wanted: Array, share: float) -> None:
    """Scale `share` of `wanted` (m,) [A] into the limits of coils and supply, then its change into the slew's.

    Directions are kept. What is held is then within the supply's power too: it lies between two currents that are.
    """
    scale, step = share, g.slew * g.dt
    for j in range(wanted.size):
        if abs(wanted[j]) * scale > coils[j].limit:  # safety: current-is-clamped
            scale = coils[j].limit / abs(wanted[j])
    power = 0.0
    for j in range(wanted.size):
        power += coils[j].hot * (scale * wanted[j]) ** 2
    if power > g.power:  # safety: supply-power-is-kept
        scale *= np.sqrt(g.power / power)
    largest = 0.0
    for j in range(wanted.size):
        largest = max(largest, abs(scale * wanted[j] - coils[j].held))
    slewed = 1.0 if largest <= step else step / largest  # safety: current-slews
    for j in range(wanted.size):
        coils[j].held += slewed * (scale * wanted[j] - coils[j].held)
