"""Energy that a loop makes out of nothing, watched as it runs, and bounded damping against it.

A passive world gives back at most what it was given. Rendered by a loop it gives more: the force of a place is held
while the hand moves on, and is late. That excess is seen as it arises. Between two poses the device gave
a·Δp, with a the mean of what was asked in that very time; the world would have given ½(f₁ + f₂)·Δp, with f at the two
poses. The difference was made by sampling and delay. What even a loose hand takes out, b|Δp|²/Δt, is set against it.

    balance += b |Δp|²/Δt − (a − ½(f₁ + f₂))·Δp,  at most CREDIT;  below zero: damp

For a spring K under a steady movement this is b > K (T/2 + t_d), the condition of `stability`, tick by tick: a world
inside its loop's bound is never touched, however much energy it stores, and one outside is touched within milliseconds.
A world with memory may store energy. Where its memory says how much, E, what its own time step has made is counted too:
½(f₁ + f₂)·Δp + E₂ − E₁, summed up and never below zero: what it has dissipated it may not give back. A surplus that
comes and goes, as of a symplectic integrator, comes and goes in the balance.

After Hannaford and Ryu 2002, who count all the energy from the start; see decision 07 for why not here.
"""

from __future__ import annotations

import numpy as np

from haptorb.arrays import Array, Record, Records
from haptorb.compiled import kernel
from haptorb.control.guard import CREDIT, TICKS

__all__ = ["OWN_DAMPING", "damp_wrench", "restart_passivity"]

OWN_DAMPING = 1.0  #: that the loosest hand is assumed to have [N·s/m]
_DEBT = 1e-2  #: more is not remembered [J]
_MOST = 10.0  #: damping that is ever injected [N·s/m]
_LIGHTEST = 0.1  #: mass of the lightest hand [kg]: late damping beyond a quarter of m/delay would itself oscillate
_PAUSE = 0.1  #: after a longer pause without a pose the count continues from there [s]
_SOON = 1e-9  #: poses nearer to each other are one [s]
_MOVED = 1e-9  #: [m]; less is no movement


@kernel
def _average(q: Record, start: float, end: float) -> None:
    """q.mean becomes the mean of what was asked from `start` to `end` [s]; each wrench acts until the next."""
    q.mean[:] = 0.0
    until = np.inf
    for back in range(min(q.count, TICKS)):
        at = (q.count - 1 - back) % TICKS
        since = q.times[at]
        share = (min(until, end) - max(since, start)) / (end - start)
        if share > 0.0:
            for i in range(6):
                q.mean[i] += share * q.wrenches[at, i]
        if since <= start:
            break
        until = since


@kernel
def _count_energy(q: Record, e: Record, wrench: Array, stamp: float, passed: float, late: float, gain: float) -> None:
    """Count the energy between the last pose and this one, `passed` [s] later, and choose the damping."""
    _average(q, q.stamp - q.lag, stamp - q.lag)  # safety: late-poses-meet-their-forces
    step = q.motion
    for i in range(3):
        step[i] = e.position[i] - q.position[i]
        step[3 + i] = 0.0
    if q.arm > 0.0:  # the small turn R₂R₁ᵀ as a vector
        before, now = q.rotation, e.rotation
        for k in range(3):
            step[3] += 0.5 * (before[1, k] * now[2, k] - before[2, k] * now[1, k])
            step[4] += 0.5 * (before[2, k] * now[0, k] - before[0, k] * now[2, k])
            step[5] += 0.5 * (before[0, k] * now[1, k] - before[1, k] * now[0, k])
    given, due, square = 0.0, 0.0, 0.0
    # where a part is not rendered, nothing moves or turns the tool but what the magnets do of themselves
    for i in range(0 if q.pushes else 3, 6 if q.arm > 0.0 else 3):
        given += q.mean[i] * step[i]
        due += 0.5 * (q.wrench[i] + gain * wrench[i]) * step[i]
        square += step[i] * step[i] if i < 3 else q.arm * q.arm * step[i] * step[i]
    for i in range(6):
        step[i] /= passed
    q.energy += given
    balance = q.balance + OWN_DAMPING * square / passed - (given - due) - _count_surplus(q, wrench, passed)
    q.balance = min(max(balance, -_DEBT), CREDIT)
    q.damping = 0.0
    if q.passive and balance < 0.0 and square > _MOVED * _MOVED:  # safety: active-worlds-are-left-alone
        most = min(_MOST, 0.25 * _LIGHTEST / (q.dt + passed + late + q.lag))
        q.damping = min(most, -balance * passed / square)  # safety: damping-is-bounded


@kernel
def _count_surplus(q: Record, wrench: Array, passed: float) -> float:
    """By how much the energy that the world's time step has made grew since the last pose, `passed` [s] ago [J]."""
    made = q.stored - q.counted
    if not np.isfinite(made):
        return 0.0
    for i in range(6 if q.arm > 0.0 else 3):
        made += 0.5 * (q.world_wrench[i] + wrench[i]) * q.motion[i] * passed
    before = q.surplus
    q.surplus = max(before + made, 0.0)  # safety: memory-energy-counted
    return float(q.surplus - before)


@kernel
def damp_wrench(q: Record, e: Record, wrench: Array, now: float, gain: float, out: Array) -> None:
    """Bring the balance up to this tick's pose; out (6,) becomes `wrench` (6,) and the damping that it needs.

    q is a PASSIVITY, e an ESTIMATE, now the time [s]; gain 0 to 1 is what the guard lets through. In [N, N·m].
    """
    total = now + e.age
    moved = 0.0
    for i in range(6):
        total += wrench[i]
        out[i] = wrench[i]
    for i in range(3):
        total += e.position[i]
        moved += abs(e.position[i] - q.position[i])
        if q.arm > 0.0:
            total += e.rotation[i, 0] + e.rotation[i, 1] + e.rotation[i, 2]
    if not np.isfinite(total):  # the guard handles it; nothing is counted, and all sums restart
        q.stamp, q.damping = -np.inf, 0.0
        return
    stamp = now - max(e.age, 0.0)
    if moved > _MOVED and stamp <= q.newest:  # its stamp stands while it moves: it is of now, as predicted
        if q.predicted <= 0:
            q.stamp = -np.inf
        q.predicted = TICKS
    q.newest = max(stamp, q.newest)
    if q.predicted > 0:
        q.predicted -= 1
        stamp = now
    passed = stamp - q.stamp
    if passed > _PAUSE or passed < 0.0:
        q.motion[:] = 0.0
        q.damping = 0.0
    elif passed > _SOON:
        _count_energy(q, e, wrench, stamp, passed, now - stamp, gain)
    if passed > _SOON or passed < 0.0:
        q.stamp = stamp
        for i in range(3):
            q.position[i] = e.position[i]
            for j in range(3):
                q.rotation[i, j] = e.rotation[i, j]
        q.counted = q.stored
        for i in range(6):
            q.wrench[i], q.world_wrench[i] = gain * wrench[i], wrench[i]
    if q.damping > 0.0:
        for i in range(3):
            if q.pushes:
                out[i] -= q.damping * q.motion[i]  # safety: damping-brakes
            out[3 + i] -= q.damping * q.arm * q.arm * q.motion[3 + i]  # safety: damping-brakes-turns
    at = q.count % TICKS
    q.times[at] = now
    for i in range(6):
        q.wrenches[at, i] = gain * out[i]
    q.count += 1


def restart_passivity(passivity: Records, passive: bool) -> None:
    """Another world, `passive` or not: what is asked from now on has nothing to do with what was; (1,) PASSIVITY."""
    for name in ("energy", "damping", "predicted", "count", "motion", "surplus"):
        passivity[name] = 0
    passivity["stored"] = passivity["counted"] = np.nan
    passivity["balance"] = CREDIT
    passivity["stamp"] = passivity["newest"] = -np.inf
    passivity["passive"] = passive
