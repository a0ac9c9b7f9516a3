"""How hot the windings are at most, and how long the present load may last: a thermal network fed with currents.

The copper cannot be touched by a thermometer; its temperature is integrated from i²R, and each coil's body is pulled
gently to its boundary thermometer, so that a wrong start or a wrong room is forgotten within seconds. Coils that are
coupled warm each other through a core, which no thermometer touches.

Capacities and conductances are known within `tolerance` only. So heat flows into every node at the greatest rate that
they allow, and out of it at the smallest: the rate of change of each temperature is nowhere below the true one. Because
a warmer node never cools another, it follows that no temperature is ever below the true one (Kamke's theorem), however
the values are off within the tolerance, for each coil by itself. A law like energy's does not hold on the way.
"""

from __future__ import annotations

import numpy as np

from haptorb.control.protection.remaining_time import remaining_time
from haptorb.control.protection.tick_time import SILENCE
from haptorb.numerics.arrays import Record, Records
from haptorb.numerics.compiled import kernel

__all__ = ["observe_heat"]

_PULL = 0.5  #: rate at which the body follows the thermometer [1/s]
_LOAD_WINDOW = 1.0  #: over which the present load is averaged [s]
_STEP = 0.02  #: longest step of the integration [s]
_LONGEST = 60.0  #: time that one tick can make up for [s]; a longer pause leaves the windings as warm as after this
_OFTEN = 0.02  #: between two computations of the time that is left [s]
_SELDOM = 0.1  #: the same for coupled coils, of which a computation takes as long as a third of a tick's other work [s]


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
    # After a long silence the readings tell that the device switched off, but not when: at the latest its watchdog did.
    held = SILENCE / elapsed if elapsed > 1.05 * SILENCE else 0.0
    if not h.started:
        _begin(h, coils)
    for j in range(coils.size):
        c = coils[j]
        warm = 1.0 + h.coefficient * (c.winding - h.reference)
        x = c.cold * warm * elapsed / c.inductance if c.inductance > 0.0 else np.inf
        square = _mean_square(c.heat_current, c.current, x)
        if held > 0.0:
            square = held * c.heat_current**2 + (1.0 - held) * square
        c.heating = square * c.cold
        c.heat_current = c.current
        c.load += weight * (c.heating - c.load)
    for _ in range(steps):
        _warm(h, coils, dt)
    hottest = -np.inf
    for j in range(coils.size):
        winding = coils[j].winding
        if winding > hottest or winding != winding:  # once not a number, never again below a limit
            hottest = winding
    h.hottest = hottest
    h.remaining_age += elapsed
    often = _OFTEN if h.core_capacity == 0.0 else _SELDOM
    if not h.started or h.remaining_age >= often - 1e-9:
        h.remaining_age = 0.0
        h.remaining = remaining_time(h, coils)
    h.started = True


@kernel
def _begin(h: Record, coils: Records) -> None:
    """A device that was used a minute ago starts warm: all of a coil as its boundary, the core as the warmest coil."""
    h.core = -np.inf
    for j in range(coils.size):
        c = coils[j]
        c.body = c.winding = c.boundary
        c.heat_current = c.current
        h.core = max(h.core, c.boundary)


@kernel
def _warm(h: Record, coils: Records, dt: float) -> None:
    """A step of `dt` [s] of windings, bodies and core: all flows from the temperatures at its beginning."""
    least, most = 1.0 - h.tolerance, 1.0 + h.tolerance  # safety: heat-is-an-upper-bound
    pull = -np.expm1(-_PULL * dt)
    into_core = 0.0
    for j in range(coils.size):
        c = coils[j]
        winding, body = c.winding, c.body
        to_body, to_air = h.winding_to_body * (winding - body), h.body_to_air * (body - h.ambient)
        to_core = c.to_core * (winding - h.core)  # safety: coils-warm-each-other
        heat = c.heating * (1.0 + h.coefficient * (winding - h.reference))
        # What leaves a node counts with the smallest conductance, what enters it with the greatest.
        net = heat - to_body * (least if to_body > 0.0 else most) - to_core * (least if to_core > 0.0 else most)
        c.winding += dt * net / (h.winding_capacity * (least if net > 0.0 else most))
        net = to_body * (most if to_body > 0.0 else least) - to_air * (least if to_air > 0.0 else most)
        c.body += dt * net / (h.body_capacity * (least if net > 0.0 else most)) + pull * (c.boundary - body)
        into_core += to_core * (most if to_core > 0.0 else least)
    if into_core != 0.0:  # never without a core
        h.core += dt * into_core / (h.core_capacity * (least if into_core > 0.0 else most))
