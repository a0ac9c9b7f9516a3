"""How hot the windings are, and how long the present load may last: a two-node model fed with measured currents.

The copper cannot be touched by a thermometer; its temperature is integrated from i²R, and the body node is pulled
gently to the boundary thermometer, so that a wrong start or a wrong room is forgotten within seconds.
"""

from __future__ import annotations

import numpy as np

from haptorb.control.protection.tick_time import SILENCE
from haptorb.devices.device import Coils
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel

__all__ = ["ELAPSED", "PENDING", "HeatObserver", "observe"]

_PULL = 0.5  #: rate at which the body follows the thermometer [1/s]
_LOAD_WINDOW = 1.0  #: over which the present load is averaged [s]
_STEP = 0.02  #: longest step of the integration [s]
_LONGEST = 60.0  #: time that one tick can make up for [s]; a longer pause leaves the windings as warm as after this
_OFTEN = 0.02  #: between two looks at the time that is left [s]

#: places in the numbers: what it finds, then what it is told once
HOTTEST, REMAINING, _TICKS, _SINCE, ELAPSED, _ALPHA, _REFERENCE, _LIMIT = range(8)
_C_WINDING, _C_BODY, _INNER, _OUTER, _AMBIENT, PENDING = range(8, 14)
#: rows of the coils: temperatures [K], i²R at the reference temperature, averaged [W], resistance there [Ω], inductance
#: [H] and the current of the tick before [A]
WINDING, BODY, LOAD, _RESISTANCE, _INDUCTANCE, _BEFORE = range(6)


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
def observe(numbers: Array, coils: Array, currents: Array, boundary: Array) -> float:
    """A tick, numbers[ELAPSED] + numbers[PENDING] [s] after the last one that could be read, with measured `currents`
    (m,) [A] and `boundary` temperatures (m,) [K].

    numbers (14,) and coils (6, m) are a `HeatObserver`'s memory. Returns the hottest winding [K], NaN if any is.
    """
    n = numbers
    elapsed = min(n[ELAPSED] + n[PENDING], _LONGEST)
    n[PENDING] = 0.0
    steps = max(1, int(np.ceil(elapsed / _STEP - 1e-9)))
    dt, weight = elapsed / steps, -np.expm1(-elapsed / _LOAD_WINDOW)
    pull = -np.expm1(-_PULL * dt)
    # After a long silence the readings tell that the device switched off, but not when: at the latest its watchdog did.
    held = SILENCE / elapsed if elapsed > 1.05 * SILENCE else 0.0
    hottest = -np.inf
    for j in range(currents.size):
        if n[_TICKS] == 0.0:  # a device that was used a minute ago starts warm
            coils[BODY, j] = coils[WINDING, j] = boundary[j]
            coils[_BEFORE, j] = currents[j]
        winding, body = coils[WINDING, j], coils[BODY, j]
        inductance, warm = coils[_INDUCTANCE, j], 1.0 + n[_ALPHA] * (winding - n[_REFERENCE])
        x = coils[_RESISTANCE, j] * warm * elapsed / inductance if inductance > 0.0 else np.inf
        square = _mean_square(coils[_BEFORE, j], currents[j], x)
        if held > 0.0:
            square = held * coils[_BEFORE, j] ** 2 + (1.0 - held) * square
        cold = square * coils[_RESISTANCE, j]
        coils[_BEFORE, j] = currents[j]
        for _ in range(steps):
            inward = n[_INNER] * (winding - body)
            outward = n[_OUTER] * (body - n[_AMBIENT])
            winding += dt * (cold * (1.0 + n[_ALPHA] * (winding - n[_REFERENCE])) - inward) / n[_C_WINDING]
            body += dt * (inward - outward) / n[_C_BODY] + pull * (boundary[j] - body)
        coils[WINDING, j], coils[BODY, j] = winding, body
        coils[LOAD, j] += weight * (cold - coils[LOAD, j])
        if winding > hottest or winding != winding:  # once not a number, never again below a limit
            hottest = winding
    n[HOTTEST] = hottest
    n[_SINCE] += elapsed
    if n[_TICKS] == 0.0 or n[_SINCE] >= _OFTEN - 1e-9:
        n[_SINCE] = 0.0
        n[REMAINING] = _remaining(numbers, coils)
    n[_TICKS] += 1.0
    return float(hottest)


@kernel
def _remaining(numbers: Array, coils: Array) -> float:
    """Shortest time over the channels until the winding reaches the limit at constant current; inf if never.

    The load is i²R at the reference temperature. Warm copper takes more power from the same current, which makes the
    two-node equations no less linear: only the winding's own rate changes, and may change sign (thermal runaway).
    """
    n, limit, alpha, reference = numbers, numbers[_LIMIT], numbers[_ALPHA], numbers[_REFERENCE]
    c_winding, c_body, g_inner, g_outer, ambient = n[_C_WINDING], n[_C_BODY], n[_INNER], n[_OUTER], n[_AMBIENT]
    winding, body, load = coils[WINDING], coils[BODY], coils[LOAD]
    shortest = np.inf
    for j in range(winding.size):
        if winding[j] >= limit:
            return 0.0
        # d(winding) = −a winding + b body + s,  d(body) = c winding − d body + r, all per second
        a, b = (g_inner - alpha * load[j]) / c_winding, g_inner / c_winding
        c, d = g_inner / c_body, (g_inner + g_outer) / c_body
        s, r = load[j] * (1.0 - alpha * reference) / c_winding, g_outer * ambient / c_body
        root = np.sqrt((a - d) ** 2 + 4.0 * b * c)
        fast, slow = -0.5 * (a + d + root), -0.5 * (a + d - root)
        det = fast * slow
        if abs(slow) < 1e-12:  # exactly between settling and running away: a hair to either side is the same for years
            slow, det = 1e-12, fast * 1e-12
        end = (d * s + b * r) / det
        if slow < 0.0 and end <= limit:
            continue
        # θ(t) = end + p e^(fast t) + q e^(slow t), from the state now and its slope
        start, slope = winding[j] - end, -a * winding[j] + b * body[j] + s
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


class HeatObserver:
    """Winding temperatures (m,) [K] and the time that is left; one `update` per tick.

    numbers  (14,) and coils (6, m): all that it remembers, for compiled code
    """

    def __init__(self, coils: Coils, dt: float) -> None:
        heat, channels = coils.heat, len(coils.names)
        self.numbers: Array = np.array(
            [
                heat.ambient, np.inf, 0.0, 0.0, dt, coils.temperature_coefficient,
                coils.reference_temperature, heat.derate, heat.winding_capacity, heat.body_capacity,
                heat.winding_to_body, heat.body_to_air, heat.ambient, 0.0,
            ]
        )  # fmt: skip
        self.coils: Array = np.zeros((6, channels))
        self.coils[_RESISTANCE] = coils.resistance
        self.coils[_INDUCTANCE] = coils.inductance
        self.winding: Array = self.coils[WINDING]  #: (m,) [K]
        self.body: Array = self.coils[BODY]  #: (m,) [K]
        self.load: Array = self.coils[LOAD]  #: (m,) i²R at the reference temperature, averaged [W]
        self.winding[:] = self.body[:] = heat.ambient

    @property
    def hottest(self) -> float:
        """Temperature of the hottest winding [K]."""
        return float(self.numbers[HOTTEST])

    @property
    def remaining(self) -> float:
        """Time until a winding reaches the derating temperature under the present load [s]; inf if never."""
        return float(self.numbers[REMAINING])

    def update(self, currents: Array, boundary: Array, elapsed: float) -> None:
        """A tick `elapsed` [s] after the last, measured `currents` (m,) [A], `boundary` temperatures (m,) [K]."""
        self.numbers[ELAPSED] = elapsed
        observe(self.numbers, self.coils, currents, boundary)
