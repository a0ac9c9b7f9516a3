"""One tick of predictive contouring control: progress, estimate of the hand's force, and the plan of the force.

After Langerak, Zárate, Vechev, Lindlbauer, Panozzo and Hilliges, "Optimal Control for Electromagnetic Haptic Guidance
Systems", UIST 2020: the hand's own progress, not a clock, determines the reference; a plan over a short horizon
weighs the deviation across the path against the heat of the coils, and only its first step is used.
"""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Array, Record, Records
from haptorb.numerics.compiled import kernel
from haptorb.worlds.path_guidance.box_solver import solve_box
from haptorb.worlds.path_guidance.path_search import fill_frame, find_arc, follow_arc

__all__ = ["WORK", "advance_plan"]

WORK = 64  #: rows of the scratch memory: Hessian, three vectors, the solver's own, frames
_REACH = 3e-3  #: of progress in a tick [m]: 3 m/s at 1 kHz
_LOST = 15e-3  #: a hand farther from its place on the path has been set down elsewhere [m]
_PACE = 0.15  #: time constant with which the pace is smoothed [s]
_RISE = 0.25  #: time constant with which guidance follows the pace [s]
_MOST = 30  #: Newton steps
_PRECISION = 1e-5  #: of the plan [N]


@kernel
def _observe(m: Record, s: Record, frame: Array, p: Array, v: Array, dt: float) -> None:
    """Bring deviation, its rate, the hand's push and the pace up to this tick: an observer of e'' = (f + d − be')/m.

    The force that acted meanwhile is the last one. All poles are at s.observer; the push is held within what guidance
    can resist."""
    w = s.observer * dt
    along = 0.0
    for i in range(3):
        along += frame[1, i] * v[i]
    m.pace += -np.expm1(-dt / _PACE) * (along - m.pace)
    square = m.pace * m.pace
    wanted = 1.0 if s.slowest == 0.0 else square / (square + s.slowest * s.slowest)
    m.share += -np.expm1(-dt / _RISE) * (wanted - m.share)
    most = 2.0 * s.strength
    for a in range(2):
        y, force = 0.0, 0.0
        for i in range(3):
            y += frame[2 + a, i] * (p[i] - frame[0, i])
            force += frame[2 + a, i] * m.force[i]
        rate = m.rate[a]
        before = m.across[a] + dt * rate
        error = y - before
        m.rate[a] = rate + dt / s.mass * (force + m.push[a] - s.damping * rate) + 3.0 * w * w / dt * error
        m.across[a] = before + min(3.0 * w, 1.0) * error
        m.push[a] = min(max(m.push[a] + s.mass * w * w * w / (dt * dt) * error, -most), most)


@kernel
def _weigh_heat(s: Record, frame: Array, matrix: Array, passive: Array, ohms: Array, out: Array, per: Array) -> bool:
    """out (2, 2) [1/N²] and out[2] (2,) [1/N]: heat's share of the cost of the force across the path.

    The currents of a force F are i = A⁻¹(F − F₀), F₀ what the core pulls by itself: power iᵀRi. per (3, 3) becomes A⁻¹.
    False, and zeros, where there is no device with three coils.
    """
    for a in range(3):
        for b in range(2):
            out[a, b] = 0.0
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    d, e, f = matrix[1, 0], matrix[1, 1], matrix[1, 2]
    g, h, k = matrix[2, 0], matrix[2, 1], matrix[2, 2]
    size = a * (e * k - f * h) - b * (d * k - f * g) + c * (d * h - e * g)
    if not abs(size) > 1e-12:
        return False
    per[0, 0], per[0, 1], per[0, 2] = (e * k - f * h) / size, (c * h - b * k) / size, (b * f - c * e) / size
    per[1, 0], per[1, 1], per[1, 2] = (f * g - d * k) / size, (a * k - c * g) / size, (c * d - a * f) / size
    per[2, 0], per[2, 1], per[2, 2] = (d * h - e * g) / size, (b * g - a * h) / size, (a * e - b * d) / size
    for coil in range(3):
        still = 0.0
        for i in range(3):
            still -= per[coil, i] * passive[i]
        for x in range(2):
            along = 0.0
            for i in range(3):
                along += per[coil, i] * frame[2 + x, i]
            out[2, x] += 2.0 * s.heat * ohms[coil] * along * still
            for y in range(2):
                other = 0.0
                for i in range(3):
                    other += per[coil, i] * frame[2 + y, i]
                out[x, y] += 2.0 * s.heat * ohms[coil] * along * other
    return True


@kernel
def _plan(m: Record, s: Record, heat: Array, work: Array) -> None:
    """Find the forces of the horizon, sideways then outward, each at most s.strength: row 2n + 3 of `work`.

    Those sideways begin at the last plan, m.plan (n,), the others at zero."""
    n = s.from_push.size
    size = 2 * n
    hessian, linear, low, high = work[:size], work[size], work[size + 1], work[size + 2]
    for x in range(2):
        most = s.strength * (1.0 if x == 0 else s.height)
        for i in range(n):
            at = x * n + i
            linear[at] = s.from_place[i, 0] * m.across[x] + s.from_place[i, 1] * m.rate[x]
            linear[at] += s.from_push[i] * m.push[x] + heat[2, x]
            low[at], high[at] = -most, most
            for y in range(2):
                for j in range(n):
                    cost = heat[x, y] if i == j else 0.0
                    if x == y:
                        cost += s.cost[i, j]
                    hessian[at, y * n + j] = cost
    x = work[size + 3]
    for i in range(n):
        x[i], x[n + i] = m.plan[i], 0.0
    m.steps = solve_box(hessian, linear, low, high, x, work[size + 4 :], _MOST, _PRECISION)
    for i in range(n):
        m.plan[i] = x[i]


@kernel
def advance_plan(
    memory: Records, settings: Records, places: Array, tangents: Array, actuation: Array, motion: Array, dt: float,
    work: Array, wrench: Array,
) -> None:  # fmt: skip
    """Advance `memory`, (1,) MEMORY, by `dt` [s] and fill `wrench` (6,) [N].

    places, tangents: (k, 3) of the path [m]. actuation (3, 5): force per ampere of three coils [N/A], force without
    current [N], resistances [Ω]; zeros if heat has no weight. motion (2, 3): position [m] and velocity [m/s] of the
    hand. work (WORK, 2n) is overwritten.
    """
    m, s = memory[0], settings[0]
    n = s.from_push.size
    below = work[4 * n + 8 :]
    frame, heat, per = below[0:4, 0:3], below[4:7, 0:2], below[4:7, 3:6]
    p, v = motion[0], motion[1]
    for i in range(6):
        wrench[i] = 0.0
    if m.started == 0.0:
        m.arc = find_arc(p, places, s.spacing)
    else:
        m.arc = follow_arc(p, places, s.spacing, s.closed, m.arc, _REACH)
    fill_frame(places, tangents, s.spacing, m.arc, frame)
    gap, lag = 0.0, 0.0
    for i in range(3):
        gap += (p[i] - frame[0, i]) ** 2
        lag += (p[i] - frame[0, i]) * frame[1, i]
    if m.started == 1.0 and gap > _LOST * _LOST:
        m.started = 0.0
        m.arc = find_arc(p, places, s.spacing)
        fill_frame(places, tangents, s.spacing, m.arc, frame)
    if m.started == 0.0:
        m.started, m.lag, m.pace, m.share = 1.0, 0.0, 0.0, 1.0 if s.slowest == 0.0 else 0.0
        m.push[:], m.rate[:], m.plan[:], m.force[:] = 0.0, 0.0, 0.0, 0.0
        for a in range(2):
            m.across[a] = 0.0
            for i in range(3):
                m.across[a] += frame[2 + a, i] * (p[i] - frame[0, i])
    m.lag = lag
    distance = np.sqrt(frame[0, 0] * frame[0, 0] + frame[0, 1] * frame[0, 1] + frame[0, 2] * frame[0, 2])
    for i in range(3):
        m.place[i] = frame[0, i] * (1.0 - s.lower / distance)
    _observe(m, s, frame, p, v, dt)
    known = _weigh_heat(s, frame, actuation[:, :3], actuation[:, 3], actuation[:, 4], heat, per)
    _plan(m, s, heat, work)
    x, y = m.share * work[2 * n + 3, 0], m.share * work[2 * n + 3, n]
    size = np.sqrt(x * x + y * y)
    cut = 1.0 if size <= s.strength else s.strength / size
    for i in range(3):
        m.force[i] = cut * (x * frame[2, i] + y * frame[3, i])
        wrench[i] = m.force[i]
    m.heat = 0.0
    if known:
        for coil in range(3):
            current = 0.0
            for i in range(3):
                current += per[coil, i] * (m.force[i] - actuation[i, 3])
            m.heat = min(m.heat + actuation[coil, 4] * current * current, s.power)
