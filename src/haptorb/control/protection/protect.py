"""Protection of one tick in two compiled passes, because the allocator lies between: of the wrench, of the currents.

They string the rules together: passivity control and guard; then current check, heat, guard and drive.
"""

from __future__ import annotations

from haptorb.control.protection.current_check import check_currents
from haptorb.control.protection.drive import choose_duties, rest_coils
from haptorb.control.protection.guard import (
    begin_tick,
    check_estimate,
    check_readings,
    limit_currents,
    limit_wrench,
    pass_over,
    trip,
)
from haptorb.control.protection.heat import observe_heat
from haptorb.control.protection.passivity import damp_wrench
from haptorb.control.protection.trip import Trip
from haptorb.numerics.arrays import Array, Record, Records
from haptorb.numerics.compiled import kernel, tick_kernel

__all__ = ["protect_currents", "protect_wrench", "skip_tick"]

_SAMPLE, _MISMATCH = int(Trip.SAMPLE_NOT_FINITE), int(Trip.CURRENT_MISMATCH)


@tick_kernel
def protect_wrench(
    state: Records, wrench: Array, p: Array, R: Array, v: Array, w: Array, now: float, age: float, valid: bool,
    reversed: bool, client: Records,
) -> None:  # fmt: skip
    """A tick begins at `now` [s]: what may be asked of the coils for the world's `wrench` (6,) [N, N·m] is in
    guard.asked of `state`, (1,) PROTECTION: passed over, damped, then limited. The part of it that `client`, (1,)
    CLIENT_FORCE, commands is in guard.commanded. The rest is the estimate's."""
    s = state[0]
    g, e = s.guard, s.estimate
    _keep_estimate(e, p, R, v, w)
    e.age, e.valid = age, valid
    begin_tick(s.clock, g, now)
    pass_over(g, wrench, client[0].session, client[0].mapping)
    damp_wrench(s.passivity, e, g.wanted, now, g.gain, g.asked)
    check_estimate(g, valid, age, reversed)
    limit_wrench(g)


@tick_kernel
def protect_currents(
    state: Records, coils: Records, wanted: Array, matrix: Array, currents: Array, age: float, temperatures: Array,
    applied: Array, duties: Array,
) -> None:  # fmt: skip
    """duties (m,) become what may be applied for `wanted` currents (m,) [A]: limited, then driven; zero when it is off.

    state (1,) PROTECTION and coils (m,) COIL; matrix (6, m) wrench per ampere; currents (m,) [A], `age` [s] old, and
    temperatures (m,) [K] are readings; applied (m,) are the duties since the last tick.
    """
    s = state[0]
    clock, g, heat = s.clock, s.guard, s.heat
    _keep_readings(coils, matrix, currents, temperatures, applied)
    _induce(s.estimate, coils)
    plausible = check_currents(clock, coils, age)
    reason = check_readings(coils)
    if reason == _SAMPLE:
        trip(g, _SAMPLE)  # and nothing is learned from it
    else:
        observe_heat(heat, coils, clock.elapsed)  # safety: windings-heat-by-the-clock
        if reason != 0:
            trip(g, reason)
        elif not plausible:  # safety: current-mismatch-trips
            trip(g, _MISMATCH)
    limit_currents(g, heat, coils, wanted)
    s.drive.dt = max(clock.elapsed, clock.period)
    if g.gain > 0.0:  # safety: off-means-zero-duties
        choose_duties(s.drive, coils)
    else:
        rest_coils(coils)
    for j in range(coils.size):
        duties[j] = coils[j].duty


@kernel
def skip_tick(state: Records, now: float) -> None:
    """A tick at `now` [s] in which nothing could be read: time passes, and the windings are observed later."""
    s = state[0]
    begin_tick(s.clock, s.guard, now)
    s.heat.pending += s.clock.elapsed


@kernel
def _keep_estimate(e: Record, p: Array, R: Array, v: Array, w: Array) -> None:
    for i in range(3):
        e.position[i], e.velocity[i], e.angular_velocity[i] = p[i], v[i], w[i]
        for j in range(3):
            e.rotation[i, j] = R[i, j]


@kernel
def _keep_readings(coils: Records, matrix: Array, currents: Array, temperatures: Array, applied: Array) -> None:
    for j in range(coils.size):
        c = coils[j]
        c.current, c.boundary, c.applied = currents[j], temperatures[j], applied[j]
        for i in range(6):
            c.wrench[i] = matrix[i, j]


@kernel
def _induce(e: Record, coils: Records) -> None:
    """What the coils push against: the power that they give to the mover, per ampere."""
    for j in range(coils.size):
        c = coils[j]
        c.emf = 0.0
        for i in range(3):
            c.emf += e.velocity[i] * c.wrench[i] + e.angular_velocity[i] * c.wrench[3 + i]
