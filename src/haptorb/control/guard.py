"""The guard's rules: what may be asked, what may flow, and when to switch off until a person engages.

Off is the default state and the end of every path. A trip latches with its reason; only a person who engages leaves it,
and only when the reason is gone. The guard trusts nothing above it, least of all the world.

Lines that keep a rule are marked with `safety:` and its name; `scripts/prove_safety.py` breaks each and sees a test
go red.
"""

from __future__ import annotations

import numpy as np

from haptorb.arrays import Array, Record, Records, fields, state_zeros
from haptorb.compiled import kernel
from haptorb.control.trips import GuardState, Trip
from haptorb.devices.base import Device

__all__ = [
    "BUCKETS",
    "CLOCK",
    "COIL",
    "CREDIT",
    "PROTECTION",
    "SILENCE",
    "TICKS",
    "advance_clock",
    "begin_tick",
    "check_estimate",
    "check_readings",
    "limit_currents",
    "limit_wrench",
    "make_clock",
    "make_coils",
    "make_state",
    "pass_over",
    "silence_of",
    "trip",
]


# --------------------------------------------------------------------------------------------------
# How much time really passed between two ticks, and whether too many deadlines were missed: a tick is no unit of time.
#
# A loop that is held up must not think that less time passed: a winding heats, a pose ages and a hand moves meanwhile.


SILENCE = 0.020  #: of the loop, after which a device switches its coils off by itself [s]
_WINDOW = 0.2  #: over which deadlines are counted [s]
_SHARE = 0.8  #: of the deadlines must be met within the window
_GAP = 0.025  #: missed time that one gap counts at most [s]: one pause of the computer is no overrun
BUCKETS = 8  #: of the window

#: period and elapsed [s]; time of the last tick [s], NaN before the first; silence [s] that restarts the ramp; bucket:
#: number of the one that is filled now; overrun and restart: what the last tick found; excused: the next tick's
#: lateness does not count as missed time; missed: time in each bucket [s]
CLOCK = fields(
    ("period", "f8"), ("elapsed", "f8"), ("time", "f8"), ("silence", "f8"), ("bucket", "f8"), ("overrun", "?"),
    ("restart", "?"), ("excused", "?"), ("missed", "f8", (BUCKETS,)),
)  # fmt: skip


def silence_of(period: float) -> float:
    """How long a loop of `period` [s] may be silent before its coils are switched off [s].

    >>> silence_of(1e-3), silence_of(0.02)
    (0.02, 0.04)
    """
    return max(SILENCE, 2.0 * period)


def make_clock(period: float) -> Records:
    """(1,) CLOCK for a loop of `period` [s], before its first tick."""
    clock = np.zeros(1, dtype=CLOCK)
    clock["period"] = clock["elapsed"] = period
    clock["time"] = np.nan
    clock["silence"] = silence_of(period)
    return clock


@kernel
def advance_clock(c: Record, now: float) -> float:
    """A tick begins at `now` [s] on the loop's clock; returns the time since the last one [s].

    c is one CLOCK: `restart` means that the loop was silent for longer than a device's watchdog waits, `overrun` that
    within the last 0.2 s fewer than 80 % of the deadlines were met, those aside that are `excused`.
    """
    elapsed = now - c.time
    if not np.isfinite(elapsed):
        elapsed = c.period
    elapsed = max(elapsed, 0.0)
    width = _WINDOW / BUCKETS
    bucket = np.floor(now / width)
    if np.isfinite(bucket) and bucket != c.bucket:
        for i in range(min(max(int(bucket - c.bucket), 0), BUCKETS)):
            c.missed[int(bucket - i) % BUCKETS] = 0.0
        c.bucket = bucket
    late = elapsed - c.period
    if late > 0.5 * c.period and np.isfinite(bucket) and not c.excused:
        c.missed[int(bucket) % BUCKETS] += min(late, _GAP)
    total = 0.0
    for i in range(BUCKETS):
        total += c.missed[i]
    c.overrun = total > (1.0 - _SHARE) * _WINDOW + 0.5 * c.period
    c.excused = False
    c.restart = elapsed > c.silence
    c.elapsed = elapsed
    c.time = now
    return float(elapsed)


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
_NONE, _SAMPLE, _GUARD_OVERCURRENT = int(Trip.NONE), int(Trip.SAMPLE_NOT_FINITE), int(Trip.OVERCURRENT)


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
    _note_uncommanded(g)


@kernel
def _note_uncommanded(g: Record) -> None:
    """What no client commands may step: g.allowance (2,) grows by its change of force and torque."""
    for k in range(2):
        change = 0.0
        for i in range(3 * k, 3 * k + 3):
            own = g.asked[i] - g.gain * g.client[i]
            change += (own - g.uncommanded[i]) ** 2
            g.uncommanded[i] = own
            g.client_flows = g.client_flows or g.client[i] != 0.0
        g.allowance[k] += np.sqrt(change)


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
    return _GUARD_OVERCURRENT if beyond else _NONE  # safety: overcurrent-trips


@kernel
def limit_currents(g: Record, heat: Record, coils: Records, wanted: Array, pushes: bool, turns: bool) -> None:
    """`held` of `coils` (m,) becomes what may flow of `wanted` (m,) [A]: within limits and slew, derated when warm, at
    the rate of a client's force, zero when it is off. pushes, turns: whether force and torque are rendered."""
    if g.restarted:
        _clear_currents(g, coils)
        g.restarted = False
    hottest = heat.hottest
    if not hottest < heat.stop:  # safety: hot-coils-trip
        trip(g, _OVERHEATED)
    if g.state == _OFF or (g.state == _TRIPPED and g.gain == 0.0):
        _clear_currents(g, coils)
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
            _clear_currents(g, coils)
            return
    scale = _hold(g, coils, wanted, share)  # safety: warm-coils-are-derated
    if g.client_flows and g.state != _TRIPPED:  # safety: fades-are-free
        _limit_client_rate(g, coils, wanted, scale, pushes, turns)  # safety: clients-flow-at-their-rate


@kernel
def _clear_currents(g: Record, coils: Records) -> None:
    g.allowance[:] = 0.0
    g.client_flows = False
    for j in range(coils.size):
        coils[j].held = 0.0


@kernel
def _hold(g: Record, coils: Records, wanted: Array, share: float) -> float:
    """Scale `share` of `wanted` (m,) [A] into the limits of coils and supply, then its change into the slew's.

    Returns the scale. Directions are kept. What is held is then within the supply's power too: it lies between two
    currents that are.
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
    return scale


@kernel
def _find_steps(coils: Records, k: int, wanted: Array, scale: float) -> tuple[float, float]:
    """From the driven currents to `held`, and from `held` to `scale` of `wanted` (m,) [A]: both as force [N], k = 0, or
    torque [N·m], k = 1, at this pose."""
    step, behind = 0.0, 0.0
    for i in range(3 * k, 3 * k + 3):
        a, b = 0.0, 0.0
        for j in range(coils.size):
            c = coils[j]
            a += c.wrench[i] * (c.held - c.driven)
            b += c.wrench[i] * (scale * wanted[j] - c.held)
        step += a * a
        behind += b * b
    return np.sqrt(step), np.sqrt(behind)


@kernel
def _limit_client_rate(g: Record, coils: Records, wanted: Array, scale: float, pushes: bool, turns: bool) -> None:
    """Shorten the step from the driven currents to `held` until a client's force changes at its rate at most.

    The asked wrench keeps to that rate already; but where slew or limits held the currents back, they would catch up in
    one step. What no client commands is not limited: it may step as far as it has changed since the coils last gave
    what was wanted. A shorter step is within all limits, as both its ends are.
    """
    share = 1.0
    for k in range(2):
        if turns if k == 1 else pushes:
            allowed = (g.torque_rate if k == 1 else g.force_rate) * g.dt + g.allowance[k]
            step, _ = _find_steps(coils, k, wanted, scale)
            if step > allowed:
                share = min(share, allowed / step)
    if share < 1.0:
        for j in range(coils.size):
            c = coils[j]
            c.held = c.driven + share * (c.held - c.driven)
    silent = True
    for k in range(2):
        _, behind = _find_steps(coils, k, wanted, scale)
        if behind < g.allowance[k]:
            g.allowance[k] = behind
        if turns if k == 1 else pushes:
            silent = silent and behind <= (g.torque_rate if k == 1 else g.force_rate) * g.dt
    for i in range(6):
        silent = silent and g.client[i] == 0.0
    if silent:
        g.client_flows = False


# --------------------------------------------------------------------------------------------------
# What protection remembers between two ticks, and the settings that it goes by: two structured arrays.
#
# `PROTECTION` holds what is there once, in an array of one record; `COIL` what every coil has, in an array of m
# records.
# Both are made by `make_state` and `make_coils`, changed by the kernels of this package, and read by everybody.


CREDIT = 2e-4  #: energy that may be made before passivity control acts [J]: 0.1 kg at 6 cm/s
TICKS = 128  #: wrenches that passivity control remembers, from the last pose but one on
_STATE_OVERCURRENT = 1.25  #: measured over allowed current at which wiring or driver must be broken
_COLDEST, _HOTTEST = 233.15, 453.15  #: windings outside this are not resistances but faults [K]
_LEARN = 0.025  #: current, as a share of the greatest that may flow, above which its resistance is learned


#: The estimator's output in this tick: age of the pose and whether it is valid, pose and motion of the mover.
ESTIMATE = fields(
    ("age", "f8"),  # [s]
    ("position", "f8", (3,)),  # [m]
    ("rotation", "f8", (3, 3)),  # R_SR
    ("velocity", "f8", (3,)),  # [m/s]
    ("angular_velocity", "f8", (3,)),  # [rad/s]
    ("valid", "?"),
)

GUARD = fields(
    ("state", "i8"),  # GuardState
    ("reason", "i8"),  # Trip: why the coils are off
    ("trips", "i8"),  # how often it has tripped
    ("gain", "f8"),  # share of the wrench that is let through now, 0 to 1
    ("asked", "f8", (6,)),  # wrench that may be asked of the coils now [N, N·m]
    ("dt", "f8"),  # time by which ramps and slew advance in this tick [s]
    ("fresh", "?"),  # whether the last estimate was valid
    ("restarted", "?"),  # the device has switched off by itself: currents begin at zero
    ("expiry", "f8"),  # greatest age of a pose [s]
    ("force", "f8"),  # limit [N]
    ("torque", "f8"),  # limit [N·m]
    ("slew", "f8"),  # limit [A/s]
    ("power", "f8"),  # that the supply gives to all coils [W]
    ("force_rate", "f8"),  # limit of what passes over, and of a client's force [N/s]
    ("torque_rate", "f8"),  # the same [N·m/s]
    ("commanded", "f8", (6,)),  # part of the world's wrench that a client commands in this tick [N, N·m]
    ("session", "f8"),  # of the client whose force is rendered
    ("mapping", "f8"),  # number of that client's mapping
    ("client", "f8", (6,)),  # a client's wrench as rendered [N, N·m]
    ("world", "f8", (6,)),  # the wrench of the world without it, as rendered [N, N·m]
    ("leaving", "?"),  # another world takes over: the wrench goes to zero
    ("arriving", "?"),  # and then to what the world gives now
    ("wanted", "f8", (6,)),  # both together [N, N·m]
    ("uncommanded", "f8", (6,)),  # part of `asked` that no client commands [N, N·m]
    ("allowance", "f8", (2,)),  # step of force [N] and torque [N·m] that this part may still need
    ("client_flows", "?"),  # a client's wrench is in the currents: their change is limited to its rates
)

HEAT = fields(
    ("hottest", "f8"),  # winding [K]; NaN if any is
    ("remaining", "f8"),  # time until a winding reaches `derate` under the present load [s]; inf if never
    ("remaining_age", "f8"),  # time since `remaining` was computed [s]
    ("pending", "f8"),  # time of ticks in which nothing could be read [s]
    ("started", "?"),  # whether a first reading was seen
    ("derate", "f8"),  # winding temperature from which on current is taken away [K]
    ("stop", "f8"),  # winding temperature at which the coils are switched off [K]
    ("coefficient", "f8"),  # of the resistance [1/K]
    ("reference", "f8"),  # temperature of the resistances [K]
    ("ambient", "f8"),  # [K]
    ("winding_capacity", "f8"),  # [J/K]
    ("body_capacity", "f8"),  # [J/K]
    ("winding_to_body", "f8"),  # [W/K]
    ("body_to_air", "f8"),  # [W/K]
    ("tolerance", "f8"),  # relative, of capacities and conductances
    ("core", "f8"),  # temperature of what lies between coupled coils [K]
    ("core_capacity", "f8"),  # [J/K]; 0 where coils are not coupled
)

DRIVE = fields(
    ("supply", "f8"),  # voltage [V]
    ("dt", "f8"),  # time that the last tick took and the next may take [s]
)

PASSIVITY = fields(
    ("energy", "f8"),  # given to the hand since the world began [J]
    ("balance", "f8"),  # what the hand's least damping took less what sampling and delay made [J]
    ("damping", "f8"),  # injected now [N·s/m]
    ("softened", "f8"),  # share of the world's wrench that is taken away now, 0 to 1
    ("softer", "f8"),  # the same, as it is to become
    ("since", "f8"),  # beginning of the stretch that is summed up now [s]
    ("moved", "f8", (3,)),  # |v|² over this stretch and the two before [m²/s]
    ("made", "f8"),  # energy that sampling and delay made in this stretch [J]
    ("spread", "f8"),  # sum of the squares of what they made from pose to pose [J²]
    ("poses", "f8"),  # at which the world acted in this stretch
    ("taken", "f8"),  # and what the least damping took of it meanwhile, where the world acted [J]
    ("touched", "f8"),  # when the world last acted on the hand [s]
    ("smooth", "f8", (6,)),  # velocity without the noise of single poses [m/s, rad/s]
    ("stamp", "f8"),  # when the last counted pose was measured [s]; -inf before the first
    ("newest", "f8"),  # latest stamp so far [s]
    ("predicted", "i8"),  # ticks for which poses are still taken for predictions of the present
    ("count", "i8"),  # wrenches remembered since the start
    ("spacing", "f8"),  # between them, where poses are so late that there is no room for every tick [s]
    ("passive", "?"),  # whether the world is; another one is watched and left alone
    ("arm", "f8"),  # at which a hand holds a mover that turns [m]; 0 where no torque is rendered
    ("pushes", "?"),  # whether force is rendered, not torque alone
    ("dt", "f8"),  # nominal tick [s]
    ("lag", "f8"),  # by which a wrench comes late through the coils [s]
    ("position", "f8", (3,)),  # of the last counted pose [m]
    ("rotation", "f8", (3, 3)),  # of the last counted pose
    ("wrench", "f8", (6,)),  # of the world at the last counted pose [N, N·m]
    ("stored", "f8"),  # energy in the world's memory now [J]; NaN if it does not say
    ("counted", "f8"),  # the same at the last counted pose [J]
    ("world_wrench", "f8", (6,)),  # wrench of the world at the last counted pose, before the guard [N, N·m]
    ("surplus", "f8"),  # made by the world's time step: given and held now, less what it held and was given [J]
    ("motion", "f8", (6,)),  # velocity [m/s] and angular velocity [rad/s] since the pose before
    ("mean", "f8", (6,)),  # wrench asked on average between the last two poses [N, N·m]
    ("times", "f8", (TICKS,)),  # ring: from when on a wrench was asked [s]
    ("wrenches", "f8", (TICKS, 6)),  # ring: which [N, N·m]
)

#: There is one of each.
PROTECTION = fields(
    ("clock", CLOCK),
    ("estimate", ESTIMATE),
    ("guard", GUARD),
    ("heat", HEAT),
    ("drive", DRIVE),
    ("passivity", PASSIVITY),
)

#: Of each coil.
COIL = fields(
    # settings, as the device file says
    ("limit", "f8"),  # current [A]
    ("broken", "f8"),  # current at which wiring or driver must be broken [A]
    ("voltage", "f8"),  # of the supply [V]
    ("cold", "f8"),  # resistance at the reference temperature [Ω]
    ("reference", "f8"),  # temperature [K]
    ("coefficient", "f8"),  # [1/K]
    ("inductance", "f8"),  # [H]
    ("least", "f8"),  # resistance that the winding can have [Ω]
    ("greatest", "f8"),  # resistance that the winding can have [Ω]
    ("to_core", "f8"),  # heat conductance from winding to core [W/K]; 0 where coils are not coupled
    ("hot", "f8"),  # resistance at the stop temperature [Ω]
    ("learnable", "f8"),  # current above which the resistance is learned [A]
    # this tick
    ("current", "f8"),  # measured [A]
    ("boundary", "f8"),  # temperature measured [K]
    ("applied", "f8"),  # duty since the last tick
    ("wrench", "f8", (6,)),  # on the mover per ampere [N/A, N·m/A]
    ("emf", "f8"),  # voltage that the moving mover induces [V]
    # guard
    ("held", "f8"),  # current that may flow [A]
    # heat
    ("winding", "f8"),  # temperature [K]
    ("body", "f8"),  # temperature [K]
    ("heating", "f8"),  # i²R at the reference temperature, mean of this tick [W]
    ("load", "f8"),  # i²R at the reference temperature, averaged [W]
    ("heat_current", "f8"),  # measured when the heat was last observed [A]
    ("ahead_winding", "f8"),  # temperature in the future, while the time that is left is computed [K]
    ("ahead_body", "f8"),  # [K]
    ("free", "f8"),  # that winding if the core were at zero [K]
    ("share", "f8"),  # of the core's temperature in that winding's
    ("body_free", "f8"),  # that body if its winding were at zero [K]
    ("body_share", "f8"),  # of the winding's temperature in that body's
    # drive
    ("resistance", "f8"),  # as learned [Ω]
    ("duty", "f8"),  # chosen in this tick, −1 to 1
    ("driven", "f8"),  # current that should flow at the end of the tick [A]
    ("drive_current", "f8"),  # measured when the resistance was last learned [A]
    ("drive_emf", "f8"),  # emf when the last duties were chosen [V]
    ("volts", "f8"),  # sliding mean of voltage times current [V·A]
    ("squares", "f8"),  # sliding mean of current squared [A²]
    # check of the measured currents
    ("ratio", "f8"),  # learned over expected resistance
    ("model", "f8"),  # current at the last tick [A]
    ("model_before", "f8"),  # where the interval before the last tick began [A]
    ("model_end", "f8"),  # where the interval before the last tick aimed at [A]
    ("model_time", "f8"),  # length of that interval [s]
    ("model_emf", "f8"),  # emf at the last tick [V]
    ("residual", "f8"),  # smoothed difference of measured and model [A]
    ("level", "f8"),  # smoothed magnitude of the current [A]
    ("change", "f8"),  # smoothed change of the current per tick [A]
    ("square", "f8"),  # smoothed square of the model's current when it was measured [A²]
    ("product", "f8"),  # smoothed product of that current and the measured one [A²]
)


def make_state(device: Device, dt: float, arm: float = 0.0, lag: float = 0.0) -> Records:
    """(1,) PROTECTION for `device` and ticks `dt` [s] apart: off, nothing seen yet.

    arm: at which a hand holds a mover that turns [m]; lag: by which a wrench comes late through the coils [s].
    """
    limits, coils = device.limits, device.coils
    thermal = coils.heat
    state = state_zeros(1, PROTECTION)
    state["clock"] = make_clock(dt)
    guard, heat, passivity = state["guard"], state["heat"], state["passivity"]
    guard["state"] = GuardState.OFF  # safety: off-by-default
    guard["dt"] = dt
    for name in ("expiry", "force", "torque", "slew", "force_rate", "torque_rate"):
        guard[name] = getattr(limits, name)
    guard["power"] = device.supply.power
    heat["hottest"] = heat["core"] = heat["ambient"] = thermal.ambient
    heat["remaining"] = np.inf
    heat["derate"], heat["stop"] = thermal.derate, thermal.stop
    heat["coefficient"], heat["reference"] = coils.temperature_coefficient, coils.reference_temperature
    for name in ("winding_capacity", "body_capacity", "winding_to_body", "body_to_air"):
        heat[name] = getattr(thermal, name)
    heat["tolerance"] = thermal.tolerance
    heat["core_capacity"] = 0.0 if thermal.coupling is None else thermal.coupling.core_capacity
    state["drive"]["supply"], state["drive"]["dt"] = device.supply.voltage, dt
    passivity["arm"], passivity["dt"], passivity["lag"] = arm, dt, lag
    passivity["balance"], passivity["passive"], passivity["pushes"] = CREDIT, True, True
    passivity["stamp"] = passivity["newest"] = -np.inf
    return state


def make_coils(device: Device) -> Records:
    """(m,) COIL for `device`: at ambient temperature and without current."""
    coils = device.coils
    ambient = np.full(device.channels, coils.heat.ambient)
    made = state_zeros(device.channels, COIL)
    made["limit"], made["broken"] = coils.current_limit, _STATE_OVERCURRENT * coils.current_limit
    made["learnable"] = _LEARN * coils.current_limit
    made["voltage"] = device.supply.voltage
    made["cold"], made["inductance"] = coils.resistance, coils.inductance
    made["reference"], made["coefficient"] = coils.reference_temperature, coils.temperature_coefficient
    made["hot"] = device.greatest_resistance
    made["least"] = coils.resistance_at(np.full(device.channels, _COLDEST))
    made["greatest"] = coils.resistance_at(np.full(device.channels, _HOTTEST))
    made["to_core"] = 0.0 if coils.heat.coupling is None else coils.heat.coupling.winding_to_core
    made["resistance"] = coils.resistance_at(ambient)
    made["winding"] = made["body"] = ambient
    made["ratio"] = 1.0
    return made
