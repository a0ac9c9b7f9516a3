"""Passivity control: energy observer over sampling and delay, bounded damping injection, stiffness reduction.

A passive world gives back at most what it was given. Rendered by a loop it gives more: the force of a place is held
while the hand moves on, and is late. That excess is seen as it arises. Between two poses the device gave
a·Δp, with a the mean of what was asked in that very time; the world would have given ½(f₁ + f₂)·Δp, with f at the two
poses. The difference was made by sampling and delay. What even a loose hand takes out while the world acts,
b|Δp|²/Δt, is set against it.

    balance += b |Δp|²/Δt − (a − ½(f₁ + f₂))·Δp,  at most CREDIT;  below zero: damp

For a spring K under a steady movement this is b > K (T/2 + t_d), the condition of `stability`, tick by tick: a world
inside its loop's bound is never touched, however much energy it stores, and one outside is touched within milliseconds.
A world with memory may store energy. Where its memory says how much, E, what its own time step has made is counted too:
½(f₁ + f₂)·Δp + E₂ − E₁, summed up and never below zero: what it has dissipated it may not give back. A surplus that
comes and goes, as of a symplectic integrator, comes and goes in the balance.

Damping that is late can take only so much. A motion that goes on although it makes energy softens the world: its wrench
is multiplied by 0.65 for every quarter of a second, until the motion dies. The hand need not be known for that.

After Hannaford and Ryu 2002, who count all the energy from the start; see decision 07 for why not here.
"""

from __future__ import annotations

import numpy as np

from haptorb.arrays import Array, Record, Records
from haptorb.compiled import kernel
from haptorb.control.guard import CREDIT, TICKS

__all__ = ["OWN_DAMPING", "damp_wrench", "restart_passivity"]

OWN_DAMPING = 1.0  #: minimum damping of a hand, assumed [N·s/m]
_MAX_DEFICIT_J = 1e-2  #: limit on the accumulated energy deficit [J]
_MAX_DAMPING = 10.0  #: limit on the injected damping [N·s/m]
#: minimum effective mass of a hand [kg]: delayed damping beyond a quarter of m/delay would itself oscillate
_MIN_HAND_MASS_KG = 0.1
_MAX_POSE_GAP_S = 0.1  #: gap between poses after which the observer restarts [s]
_SAME_TIME_S = 1e-9  #: poses with a smaller difference in time are the same [s]
_MIN_MOTION_M = 1e-9  #: [m]; below is no movement
_INTERVAL_S = 0.25  #: summation interval of motion and energy: an oscillation or more [s]
#: ratio of motion to the interval before; above it, twice in a row, an oscillation is sustained
_SUSTAINED_RATIO = 0.55
_MIN_MEAN_SQUARE_VELOCITY = (20e-6) ** 2  #: mean square velocity below which there is no motion [m²/s²]
#: of the energy dissipated by the minimum hand damping; threshold for a wrench that is reduced already
_DISSIPATION_THRESHOLD = 0.75
_REDUCTION_FACTOR = 0.65  #: factor on the wrench after each interval of sustained oscillation
_SIGNIFICANCE = 6.25  #: (2.5)²: significance of the energy of an interval, in variances
#: share of |v|² that must remain in a velocity over several poses: less is noise of the poses
_MIN_COHERENT_MOTION = 0.3
_RECOVERY_RATE = 0.1  #: rate at which the wrench recovers while the hand moves without generated energy [1/s]
_FULL_RECOVERY_S = 1.0  #: time without a wrench after which it is fully restored [s]
_VELOCITY_AVERAGING_S = 0.005  #: averaging time of the velocity [s]
_REDUCTION_RAMP_S = 0.05  #: ramp time of a reduction of the wrench [s]


@kernel
def _average(q: Record, start: float, end: float) -> None:
    """q.mean becomes the mean commanded wrench from `start` to `end` [s]; zero-order hold between wrenches."""
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
    """Update the energy balance over the `passed` [s] from the last pose to this one, and choose the damping."""
    _average(q, q.stamp - q.lag, stamp - q.lag)  # safety: late-poses-meet-their-forces
    step = q.motion
    for i in range(3):
        step[i] = e.position[i] - q.position[i]
        step[3 + i] = 0.0
    if q.arm > 0.0:  # the small rotation R₂R₁ᵀ as a vector
        before, now = q.rotation, e.rotation
        for k in range(3):
            step[3] += 0.5 * (before[1, k] * now[2, k] - before[2, k] * now[1, k])
            step[4] += 0.5 * (before[2, k] * now[0, k] - before[0, k] * now[2, k])
            step[5] += 0.5 * (before[0, k] * now[1, k] - before[1, k] * now[0, k])
    given, due, square = 0.0, 0.0, 0.0
    # components that are not rendered: only the magnets' passive wrench acts there
    for i in range(0 if q.pushes else 3, 6 if q.arm > 0.0 else 3):
        given += q.mean[i] * step[i]
        due += 0.5 * (q.wrench[i] + gain * wrench[i]) * step[i]
        square += step[i] * step[i] if i < 3 else q.arm * q.arm * step[i] * step[i]
    for i in range(6):
        step[i] /= passed
    q.energy += given
    acted = False  # in free flight the hand's damping dissipates none of the world's energy
    for i in range(0 if q.pushes else 3, 6 if q.arm > 0.0 else 3):
        acted = acted or q.wrench[i] != 0.0 or wrench[i] != 0.0
    surplus = _count_surplus(q, wrench, passed)
    own = OWN_DAMPING * square / passed if acted else 0.0  # safety: no-credit-in-free-flight
    balance = q.balance + own - (given - due) - surplus
    _soften(q, stamp, passed, given - due + surplus, own, acted)
    q.balance = min(max(balance, -_MAX_DEFICIT_J), CREDIT)
    q.damping = 0.0
    if q.passive and balance < 0.0 and square > _MIN_MOTION_M * _MIN_MOTION_M:  # safety: active-worlds-are-left-alone
        most = min(_MAX_DAMPING, 0.25 * _MIN_HAND_MASS_KG / (q.dt + passed + late + q.lag))
        q.damping = min(most, -balance * passed / square)  # safety: damping-is-bounded


@kernel
def _forget_motion(q: Record, stamp: float) -> None:
    """Restart the summation intervals at `stamp` [s]."""
    q.moved[:] = 0.0
    q.smooth[:] = 0.0
    q.made = q.spread = q.poses = q.taken = 0.0
    q.since = q.touched = stamp


@kernel
def _soften(q: Record, stamp: float, passed: float, made: float, own: float, acted: bool) -> None:
    """Update the interval's sums of motion, energy `made` and dissipation `own` [J]; reduce a sustained oscillation.

    Damping that is late can take only so much. What goes on swinging although it makes energy is too stiff for this
    hand: of its wrench a share is taken away, until the motion dies by itself.
    """
    blend = passed / (passed + _VELOCITY_AVERAGING_S)
    square = 0.0
    for i in range(6 if q.arm > 0.0 else 3):
        q.smooth[i] += blend * (q.motion[i] - q.smooth[i])
        square += q.smooth[i] * q.smooth[i] * (1.0 if i < 3 else q.arm * q.arm)
    q.moved[0] += square * passed
    if acted:
        q.touched = stamp
        q.made += made
        q.spread += made * made
        q.poses += 1.0
        q.taken += own
    elif stamp - q.touched > _FULL_RECOVERY_S:  # safety: stiffness-returns-in-free-space
        q.softer = q.softened = 0.0
    if stamp - q.since < _INTERVAL_S:
        return
    lasts = (
        q.moved[0] > _MIN_MEAN_SQUARE_VELOCITY * _INTERVAL_S
        and q.moved[0] > _SUSTAINED_RATIO * q.moved[1]
        and q.moved[1] > _SUSTAINED_RATIO * q.moved[2]
    )
    # Within the dissipation of the minimum hand damping no world is changed.
    most = q.taken if q.softer == 0.0 else _DISSIPATION_THRESHOLD * q.taken
    # Noise of poses generates and dissipates energy alternately, and moves from pose to pose, not over several.
    likely = q.made * q.made > min(_SIGNIFICANCE, q.poses / 3.0) * q.spread
    likely = likely and OWN_DAMPING * q.moved[0] > _MIN_COHERENT_MOTION * q.taken
    if q.passive and lasts and likely and q.made > most:  # safety: lasting-oscillation-is-softened
        q.softer = 1.0 - (1.0 - q.softer) * _REDUCTION_FACTOR
    elif lasts and q.made < 0.5 * _DISSIPATION_THRESHOLD * q.taken:
        q.softer = max(q.softer - _RECOVERY_RATE * _INTERVAL_S, 0.0)
    q.moved[2], q.moved[1], q.moved[0] = q.moved[1], q.moved[0], 0.0
    q.made = q.spread = q.poses = q.taken = 0.0
    q.since = stamp


@kernel
def _count_surplus(q: Record, wrench: Array, passed: float) -> float:
    """Increase of the energy generated by the world's time step since the last pose, `passed` [s] ago [J]."""
    made = q.stored - q.counted
    if not np.isfinite(made):
        return 0.0
    for i in range(6 if q.arm > 0.0 else 3):
        made += 0.5 * (q.world_wrench[i] + wrench[i]) * q.motion[i] * passed
    before = q.surplus
    q.surplus = max(before + made, 0.0)  # safety: memory-energy-counted
    return float(q.surplus - before)


@kernel
def _remember_wrench(q: Record, now: float, gain: float, wrench: Array) -> None:
    """Store `gain` times `wrench` (6,) [N, N·m], acting from `now` [s] on; merged with the last entry if too close in
    time."""
    last = (q.count - 1) % TICKS
    since = now - q.times[last]
    if q.count > 0 and 0.0 < since < q.spacing:
        for i in range(6):
            q.wrenches[last, i] += (gain * wrench[i] - q.wrenches[last, i]) * q.dt / (since + q.dt)
        return
    at = q.count % TICKS
    q.times[at] = now
    for i in range(6):
        q.wrenches[at, i] = gain * wrench[i]
    q.count += 1


@kernel
def damp_wrench(q: Record, e: Record, wrench: Array, now: float, gain: float, out: Array) -> None:
    """Update the observer at this tick's pose; out (6,) becomes `wrench` (6,) plus the required damping wrench.

    q is a PASSIVITY, e an ESTIMATE, now the time [s]; gain 0 to 1 is what the guard lets through. In [N, N·m].
    """
    total = now + e.age
    moved = 0.0
    q.softened += (q.softer - q.softened) * min(q.dt / _REDUCTION_RAMP_S, 1.0)
    left = 1.0 - q.softened
    for i in range(6):
        total += wrench[i]
        out[i] = left * wrench[i]
    for i in range(3):
        total += e.position[i]
        moved += abs(e.position[i] - q.position[i])
        if q.arm > 0.0:
            total += e.rotation[i, 0] + e.rotation[i, 1] + e.rotation[i, 2]
    if not np.isfinite(total):  # the guard handles it; nothing is counted, and all sums restart
        q.stamp, q.damping = -np.inf, 0.0
        return
    stamp = now - max(e.age, 0.0)
    # A constant stamp while the pose moves: it is a prediction for the present.
    if moved > _MIN_MOTION_M and stamp <= q.newest:
        if q.predicted <= 0:
            q.stamp = -np.inf
        q.predicted = TICKS
    q.newest = max(stamp, q.newest)
    if q.predicted > 0:
        q.predicted -= 1
        stamp = now
    passed = stamp - q.stamp
    if passed > _MAX_POSE_GAP_S or passed < 0.0:
        q.motion[:] = 0.0
        q.damping = 0.0
        _forget_motion(q, stamp)
    elif passed > _SAME_TIME_S:
        _count_energy(q, e, wrench, stamp, passed, now - stamp, gain * left)
        needed = now - stamp + 2.0 * passed + q.lag  # from this pose to the next one and back
        q.spacing = needed / (TICKS - 8) if needed > (TICKS - 8) * q.dt else 0.0
    if passed > _SAME_TIME_S or passed < 0.0:
        q.stamp = stamp
        for i in range(3):
            q.position[i] = e.position[i]
            for j in range(3):
                q.rotation[i, j] = e.rotation[i, j]
        q.counted = q.stored
        for i in range(6):
            q.wrench[i], q.world_wrench[i] = gain * left * wrench[i], wrench[i]
    if q.damping > 0.0:
        for i in range(3):
            if q.pushes:
                out[i] -= q.damping * q.motion[i]  # safety: damping-brakes
            out[3 + i] -= q.damping * q.arm * q.arm * q.motion[3 + i]  # safety: damping-brakes-turns
    _remember_wrench(q, now, gain, out)


def restart_passivity(passivity: Records, passive: bool) -> None:
    """Restart the observer (1,) PASSIVITY for another world, `passive` or not: earlier wrenches do not count."""
    for name in ("energy", "damping", "predicted", "count", "motion", "surplus", "softer", "spacing"):
        passivity[name] = 0
    passivity["stored"] = passivity["counted"] = np.nan
    passivity["balance"] = CREDIT
    passivity["stamp"] = passivity["newest"] = -np.inf
    passivity["passive"] = passive
