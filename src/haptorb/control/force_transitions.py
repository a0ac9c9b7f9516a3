"""Rate limit of a client's force, in the wrench and in the currents; changes of client and world pass through zero.

Records: one GUARD, and one COIL per channel (`haptorb.control.guard`).
"""

from __future__ import annotations

import numpy as np

from haptorb.arrays import Array, Record, Records
from haptorb.compiled import kernel
from haptorb.control.trip_reasons import GuardState

__all__ = ["RAMP_UP_S", "limit_client_rate", "note_uncommanded", "pass_over"]


RAMP_UP_S = 0.3  #: from zero to the full wrench after engaging [s]
_CHANGE_OVER_S = 0.05  #: from the largest force or torque to zero, and back, on a change of world [s]

_OFF, _RAMPING, _TRIPPED = int(GuardState.OFF), int(GuardState.RAMPING), int(GuardState.TRIPPED)


@kernel
def _approach(now: Array, goal: Array, limit: float, step: float) -> bool:
    """Move `now` (3,) by at most `step` towards `goal` (3,), both clamped to the norm `limit`; return whether it
    arrived."""
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
    """Steps of force [N] and torque [N·m] that `now` (6,) may change by in this tick, including the ramp's own
    change."""
    force, torque = g.force_rate * g.dt, g.torque_rate * g.dt
    if g.state == _RAMPING:
        ramped = g.dt / RAMP_UP_S
        force -= ramped * np.sqrt(now[0] ** 2 + now[1] ** 2 + now[2] ** 2)
        torque -= ramped * np.sqrt(now[3] ** 2 + now[4] ** 2 + now[5] ** 2)
    return max(force, 0.0), max(torque, 0.0)


@kernel
def pass_over(g: Record, wrench: Array, session: float, mapping: float) -> None:
    """g.wrench_rendered (6,) becomes `wrench` (6,) [N, N·m]; a change of the commanding client or mapping passes
    through zero.

    g.commanded is the part that the client `session` commands through its `mapping`; it changes at the rate limits at
    most. Another client, and another mapping, are rendered once the previous force has become zero. So is another
    world; once its wrench has been reached, its rate is not limited. After an off state the wrench starts at zero.
    """
    total = 0.0
    for i in range(6):
        total += wrench[i] + g.commanded[i]
        g.wrench_rendered[i] = wrench[i]
    if not np.isfinite(total):  # the limits on the wrench handle it
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
    goal = g.wrench_rendered  # used as scratch space
    for i in range(6):
        goal[i] = share * g.commanded[i]
    _approach(g.client[:3], goal[:3], g.force, force)  # safety: client-force-rate
    _approach(g.client[3:], goal[3:], g.torque, torque)  # safety: client-torque-rate
    force, torque = _steps(g, g.world)
    share = g.dt / _CHANGE_OVER_S  # slower than a client's rate limit, because the user does not expect it
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
        g.wrench_rendered[i] = wrench[i] if whole else g.world[i] + g.client[i]


@kernel
def note_uncommanded(g: Record) -> None:
    """Allow steps of the part that no client commands: g.allowance (2,) grows by its change of force and torque."""
    for k in range(2):
        change = 0.0
        for i in range(3 * k, 3 * k + 3):
            own = g.wrench_commanded[i] - g.gain * g.client[i]
            change += (own - g.uncommanded[i]) ** 2
            g.uncommanded[i] = own
            g.client_flows = g.client_flows or g.client[i] != 0.0
        g.allowance[k] += np.sqrt(change)


@kernel
def _find_steps(coils: Records, k: int, requested: Array, scale: float) -> tuple[float, float]:
    """Changes from the expected currents to the commanded ones, and from these to `scale` of `requested` (m,) [A], as
    force [N], k = 0, or torque [N·m], k = 1, at this pose."""
    step, behind = 0.0, 0.0
    for i in range(3 * k, 3 * k + 3):
        a, b = 0.0, 0.0
        for j in range(coils.size):
            c = coils[j]
            a += c.wrench[i] * (c.current_commanded - c.current_expected)
            b += c.wrench[i] * (scale * requested[j] - c.current_commanded)
        step += a * a
        behind += b * b
    return np.sqrt(step), np.sqrt(behind)


@kernel
def limit_client_rate(g: Record, coils: Records, requested: Array, scale: float, pushes: bool, turns: bool) -> None:
    """Rate limit: shorten the step from the expected to the commanded currents to the largest rate of a client's force.

    The commanded wrench respects that rate already; but currents that were limited or slewed would catch up in one
    step. The part that no client commands is not limited: it may step by its change since the currents last matched the
    requested ones. A shorter step is within all limits, as both its ends are.
    """
    share = 1.0
    for k in range(2):
        if turns if k == 1 else pushes:
            allowed = (g.torque_rate if k == 1 else g.force_rate) * g.dt + g.allowance[k]
            step, _ = _find_steps(coils, k, requested, scale)
            if step > allowed:
                share = min(share, allowed / step)
    if share < 1.0:
        for j in range(coils.size):
            c = coils[j]
            c.current_commanded = c.current_expected + share * (c.current_commanded - c.current_expected)
    silent = True
    for k in range(2):
        _, behind = _find_steps(coils, k, requested, scale)
        if behind < g.allowance[k]:
            g.allowance[k] = behind
        if turns if k == 1 else pushes:
            silent = silent and behind <= (g.torque_rate if k == 1 else g.force_rate) * g.dt
    for i in range(6):
        silent = silent and g.client[i] == 0.0
    if silent:
        g.client_flows = False
