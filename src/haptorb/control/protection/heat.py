"""How hot the windings are, and how long the present load may last: a two-node model fed with measured currents.

The copper cannot be touched by a thermometer; its temperature is integrated from i²R, and the body node is pulled
gently to the boundary thermometer, so that a wrong start or a wrong room is forgotten within seconds.
"""

from __future__ import annotations

import numpy as np

from haptorb.control.protection.tick_time import SILENCE
from haptorb.numerics.arrays import Record, Records
from haptorb.numerics.compiled import kernel

__all__ = ["observe_heat"]

_PULL = 0.5  #: rate at which the body follows the thermometer [1/s]
_LOAD_WINDOW = 1.0  #: over which the present load is averaged [s]
_STEP = 0.02  #: longest step of the integration [s]
_LONGEST = 60.0  #: time that one tick can make up for [s]; a longer pause leaves the windings as warm as after this
_OFTEN = 0.02  #: between two computations of the time that is left [s]


@kernel
def _mean_square(before: float, now: float, x: float) -> float:
    """Mean of i² while a current goes from `before` to `now` [A] as e^(−x) of a coil does, x = R dt/L."""
    if not x < 50.0:
        return now * now
    if x < 1e-6:
        return (before * before + before * now + now * now) / 3.0
    gone = -np.expm1(-x)
    end = (now - before * (1.0 - gone)) / gone
    gap, share = before - end, gone / x
    return float(max(end * end + 2.0 * end * gap * share + gap * gap * share * (1.0 - 0.5 * gone), 0.0))


@kernel
def observe_heat(h: Record, coils: Records, elapsed: float) -> None:
    """Advance the winding temperatures of `coils` (m,) by `elapsed` [s], with what was measured in this tick.

    h is a HEAT; ticks in which nothing could be read are made up for.
    """
    elapsed = min(elapsed + h.pending, _LONGEST)
    h.pending = 0.0
    steps = max(1, int(np.ceil(elapsed / _STEP - 1e-9)))
    dt, weight = elapsed / steps, -np.expm1(-elapsed / _LOAD_WINDOW)
    pull = -np.expm1(-_PULL * dt)
    # After a long silence the readings tell that the device switched off, but not when: at the latest its watchdog did.
    held = SILENCE / elapsed if elapsed > 1.05 * SILENCE else 0.0
    hottest = -np.inf
    for j in range(coils.size):
        c = coils[j]
        if not h.started:  # a device that was used a minute ago starts warm
            c.body = c.winding = c.boundary
            c.heat_current = c.current
        winding, body = c.winding, c.body
        warm = 1.0 + h.coefficient * (winding - h.reference)
        x = c.cold * warm * elapsed / c.inductance if c.inductance > 0.0 else np.inf
        square = _mean_square(c.heat_current, c.current, x)
        if held > 0.0:
            square = held * c.heat_current**2 + (1.0 - held) * square
        cold = square * c.cold
        c.heat_current = c.current
        for _ in range(steps):
            inward = h.winding_to_body * (winding - body)
            outward = h.body_to_air * (body - h.ambient)
            winding += dt * (cold * (1.0 + h.coefficient * (winding - h.reference)) - inward) / h.winding_capacity
            body += dt * (inward - outward) / h.body_capacity + pull * (c.boundary - body)
        c.winding, c.body = winding, body
        c.load += weight * (cold - c.load)
        if winding > hottest or winding != winding:  # once not a number, never again below a limit
            hottest = winding
    h.hottest = hottest
    h.remaining_age += elapsed
    if not h.started or h.remaining_age >= _OFTEN - 1e-9:
        h.remaining_age = 0.0
        h.remaining = _remaining(h, coils)
    h.started = True


@kernel
def _remaining(h: Record, coils: Records) -> float:
    """Shortest time over `coils` (m,) until the winding reaches h.derate at constant current [s]; inf if never.

    The load is i²R at the reference temperature. Warm copper takes more power from the same current, which makes the
    two-node equations no less linear: only the winding's own rate changes, and may change sign (thermal runaway).
    """
    limit, alpha, reference = h.derate, h.coefficient, h.reference
    c_winding, c_body, g_inner, g_outer = h.winding_capacity, h.body_capacity, h.winding_to_body, h.body_to_air
    shortest = np.inf
    for j in range(coils.size):
        winding, body, load = coils[j].winding, coils[j].body, coils[j].load
        if winding >= limit:
            return 0.0
        # d(winding) = −a winding + b body + s,  d(body) = c winding − d body + r, all per second
        a, b = (g_inner - alpha * load) / c_winding, g_inner / c_winding
        c, d = g_inner / c_body, (g_inner + g_outer) / c_body
        s, r = load * (1.0 - alpha * reference) / c_winding, g_outer * h.ambient / c_body
        root = np.sqrt((a - d) ** 2 + 4.0 * b * c)
        fast, slow = -0.5 * (a + d + root), -0.5 * (a + d - root)
        det = fast * slow
        if abs(slow) < 1e-12:  # exactly between settling and running away: a hair to either side is the same for years
            slow, det = 1e-12, fast * 1e-12
        end = (d * s + b * r) / det
        if slow < 0.0 and end <= limit:
            continue
        # θ(t) = end + p e^(fast t) + q e^(slow t), from the state now and its slope
        start, slope = winding - end, -a * winding + b * body + s
        q = (slope - fast * start) / (slow - fast)
        p = start - q
        low, high = 0.0, 1.0
        while end + p * np.exp(fast * high) + q * np.exp(slow * high) < limit and high < 1e6:
            low, high = high, 2.0 * high
        if high >= 1e6:
            continue
        for _ in range(30):
            middle = 0.5 * (low + high)
            if end + p * np.exp(fast * middle) + q * np.exp(slow * middle) < limit:
                low = middle
            else:
                high = middle
        shortest = min(shortest, high)
    return shortest
