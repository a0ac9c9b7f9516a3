"""Heat of the windings: upper bound of their temperatures, derating, and remaining time under the present load.

The copper has no thermometer; its temperature is integrated from i²R, and each coil's body is corrected towards its
boundary thermometer, so that a wrong initial or ambient temperature decays within seconds. Coupled coils heat each
other through a core, which has no thermometer.

Capacities and conductances are known within `tolerance` only. So heat flows into every node at the maximum rate within
that tolerance, and out of it at the minimum: no temperature rises more slowly than the true one. Because a warmer node
never cools another, no temperature is ever below the true one (Kamke's theorem), for any values within the tolerance,
for each coil individually. The model therefore does not conserve energy.
"""

from __future__ import annotations

import numpy as np

from haptorb.arrays import Record, Records
from haptorb.compiled import kernel
from haptorb.control.missed_deadlines import WATCHDOG_TIMEOUT_S
from haptorb.thermal import warm_ratio

__all__ = ["derating_share", "observe_heat", "remaining_time"]


@kernel
def derating_share(h: Record) -> float:
    """Share of the current that may flow at the temperature of the hottest winding.

    1 up to h.derate, from there falling linearly to 0 at h.stop, where the guard trips. h is a HEAT.
    """
    if h.hottest > h.derate:
        return float((h.stop - h.hottest) / (h.stop - h.derate))
    return 1.0


# --------------------------------------------------------------------------------------------------
# Remaining time under the present load: until a winding reaches the derating temperature, at constant currents.


_FIRST_STEP_S = 0.02  #: first prediction step [s]
_STEP_RATIO = 1.15  #: ratio of one step to the previous one
_STEPS = 90  #: number of steps: ten hours in total
_IMPLICIT = 0.55  #: weight of the end of a step: nearly second order, and stable for any step length


@kernel
def remaining_time(h: Record, coils: Records) -> float:
    """Shortest time [s] until the winding of one of `coils` (m,) reaches h.derate at constant current; inf if never.

    h is a HEAT. The load is i²R at the reference temperature.
    """
    coupled = False
    for j in range(coils.size):
        if coils[j].winding >= h.derate:
            return 0.0
        coupled = coupled or coils[j].to_core > 0.0
    if coupled or h.tolerance > 0.0:
        return _step_ahead(h, coils)
    return _solve_single(h, coils)


@kernel
def _step_ahead(h: Record, coils: Records) -> float:
    """Remaining time of coupled coils, or of values with a tolerance: prediction with growing steps.

    Each is implicit, and as in the observer heat leaves a node with the smallest conductance and enters it with the
    largest. Winding and body of a coil are eliminated, then the core's balance is solved.
    """
    core, dt, t = h.core, _FIRST_STEP_S, 0.0
    for j in range(coils.size):
        c = coils[j]
        c.ahead_winding, c.ahead_body = c.winding, c.body
    for _ in range(_STEPS):
        core = _find_core(h, coils, core, dt)
        before, hottest = -np.inf, -np.inf
        for j in range(coils.size):
            c = coils[j]
            winding = c.free + c.share * core
            before, hottest = max(before, c.ahead_winding), max(hottest, winding)
            c.ahead_body = c.body_free + c.body_share * winding
            c.ahead_winding = winding
        if not hottest < h.derate:
            return t + dt * (h.derate - before) / (hottest - before) if hottest > before else t
        t += dt
        dt *= _STEP_RATIO
    return np.inf


@kernel
def _find_core(h: Record, coils: Records, core: float, dt: float) -> float:
    """Core temperature `dt` [s] later [K]; `coils` store the coefficients of the resulting winding and body
    temperatures.

    winding = free + share · core, body = body_free + body_share · winding. With thermal runaway within the step there
    is no such balance: the winding is infinitely hot.
    """
    least, most, end = 1.0 - h.tolerance, 1.0 + h.tolerance, _IMPLICIT
    start = 1.0 - end
    inflow, balance, constant = 0.0, 0.0, 0.0
    for j in range(coils.size):
        c = coils[j]
        w, b = c.ahead_winding, c.ahead_body
        leaves = h.winding_to_body * (least if w > b else most)
        enters = h.winding_to_body * (most if w > b else least)
        to_core, from_winding = c.to_core * (least if w > core else most), c.to_core * (most if w > core else least)
        to_air = h.body_to_air * (least if b > h.ambient else most)
        gain, still = c.load * h.coefficient, c.load * (1.0 - h.coefficient * h.reference)
        rate_w = still + gain * w - leaves * (w - b) - to_core * (w - core)
        rate_b = enters * (w - b) - to_air * (b - h.ambient)
        capacity_w = h.winding_capacity * (least if rate_w > 0.0 else most) / dt
        capacity_b = h.body_capacity * (least if rate_b > 0.0 else most) / dt
        whole = capacity_b + end * (enters + to_air)
        c.body_free = (capacity_b * b + start * rate_b + end * to_air * h.ambient) / whole
        c.body_share = end * enters / whole
        whole = capacity_w + end * (leaves * (1.0 - c.body_share) + to_core - gain)
        if whole <= 0.0:
            c.free, c.share = np.inf, 0.0
            continue
        c.free = (capacity_w * w + start * rate_w + end * (still + leaves * c.body_free)) / whole
        c.share = end * to_core / whole
        inflow += from_winding * (w - core)
        balance += end * from_winding * (1.0 - c.share)
        constant += end * from_winding * c.free
    if balance == 0.0:
        return core  # no core
    capacity = h.core_capacity * (least if inflow > 0.0 else most) / dt
    return float((capacity * core + start * inflow + constant) / (capacity + balance))


@kernel
def _solve_single(h: Record, coils: Records) -> float:
    """Remaining time of uncoupled coils with exact values: two nodes each, in closed form.

    Warm copper dissipates more power at the same current; the two-node equations remain linear: only the winding's own
    rate changes, and may change sign (thermal runaway).
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
        # On the stability boundary a tiny offset to either side has no effect for years.
        if abs(slow) < 1e-12:
            slow, det = 1e-12, fast * 1e-12
        end = (d * s + b * r) / det
        if slow < 0.0 and end <= limit:
            continue
        # θ(t) = end + p e^(fast t) + q e^(slow t), from the present state and its slope
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


_OBSERVER_GAIN = 0.5  #: observer gain from thermometer to body [1/s]
_LOAD_AVERAGING_S = 1.0  #: averaging time of the present load [s]
_MAX_INTEGRATION_STEP_S = 0.02  #: longest step of the integration [s]
_MAX_STEP_S = 60.0  #: limit on the time integrated in one tick [s]; a longer pause has the same effect
_PREDICTION_INTERVAL_S = 0.02  #: interval between two computations of the remaining time [s]
#: the same for coupled coils, where one computation takes a third of a tick's other work [s]
_COUPLED_PREDICTION_INTERVAL_S = 0.1


@kernel
def _mean_square(before: float, now: float, x: float) -> float:
    """Mean of i² while a current changes from `before` to `now` [A] exponentially as e^(−x), x = R dt/L."""
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
    """Advance the winding temperatures of `coils` (m,) by `elapsed` [s], from this tick's measurements.

    h is a HEAT; ticks without readings are included in the next update.
    """
    elapsed = min(elapsed + h.pending, _MAX_STEP_S)
    h.pending = 0.0
    steps = max(1, int(np.ceil(elapsed / _MAX_INTEGRATION_STEP_S - 1e-9)))
    dt, weight = elapsed / steps, -np.expm1(-elapsed / _LOAD_AVERAGING_S)
    # After a long silence the device has switched off, at an unknown time: at the latest when its watchdog expired.
    held = WATCHDOG_TIMEOUT_S / elapsed if elapsed > 1.05 * WATCHDOG_TIMEOUT_S else 0.0
    if not h.started:
        _begin(h, coils)
    for j in range(coils.size):
        c = coils[j]
        warm = warm_ratio(h.coefficient, h.reference, c.winding)
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
        if winding > hottest or winding != winding:  # NaN propagates: it is never below a limit again
            hottest = winding
    h.hottest = hottest
    h.remaining_age += elapsed
    often = _PREDICTION_INTERVAL_S if h.core_capacity == 0.0 else _COUPLED_PREDICTION_INTERVAL_S
    if not h.started or h.remaining_age >= often - 1e-9:
        h.remaining_age = 0.0
        h.remaining = remaining_time(h, coils)
    h.started = True


@kernel
def _begin(h: Record, coils: Records) -> None:
    """Initialise warm, for a device used shortly before: a coil at its boundary temperature, the core at the warmest
    coil."""
    h.core = -np.inf
    for j in range(coils.size):
        c = coils[j]
        c.body = c.winding = c.boundary
        c.heat_current = c.current
        h.core = max(h.core, c.boundary)


@kernel
def _warm(h: Record, coils: Records, dt: float) -> None:
    """Advance windings, bodies and core by `dt` [s]; explicit Euler."""
    least, most = 1.0 - h.tolerance, 1.0 + h.tolerance  # safety: heat-is-an-upper-bound
    pull = -np.expm1(-_OBSERVER_GAIN * dt)
    into_core = 0.0
    for j in range(coils.size):
        c = coils[j]
        winding, body = c.winding, c.body
        to_body, to_air = h.winding_to_body * (winding - body), h.body_to_air * (body - h.ambient)
        to_core = c.to_core * (winding - h.core)  # safety: coils-warm-each-other
        heat = c.heating * warm_ratio(h.coefficient, h.reference, winding)
        # Heat flow out of a node uses the smallest conductance, heat flow into it the largest.
        net = heat - to_body * (least if to_body > 0.0 else most) - to_core * (least if to_core > 0.0 else most)
        c.winding += dt * net / (h.winding_capacity * (least if net > 0.0 else most))
        net = to_body * (most if to_body > 0.0 else least) - to_air * (least if to_air > 0.0 else most)
        c.body += dt * net / (h.body_capacity * (least if net > 0.0 else most)) + pull * (c.boundary - body)
        into_core += to_core * (most if to_core > 0.0 else least)
    if into_core != 0.0:  # skipped without a core
        h.core += dt * into_core / (h.core_capacity * (least if into_core > 0.0 else most))
