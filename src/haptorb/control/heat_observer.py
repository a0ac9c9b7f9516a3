"""How hot the windings are, and how long the present load may last: a two-node model fed with measured currents.

The copper cannot be touched by a thermometer; its temperature is integrated from i²R, and the body node is pulled
gently to the boundary thermometer, so that a wrong start or a wrong room is forgotten within seconds.
"""

from __future__ import annotations

import numpy as np

from haptorb.devices.device import Coils
from haptorb.physics.arrays import Array
from haptorb.physics.compiled import kernel

__all__ = ["HeatObserver", "observe"]

_PULL = 0.5  #: rate at which the body follows the thermometer [1/s]
_LOAD_WINDOW = 1.0  #: over which the present load is averaged [s]

#: places in the numbers: what it finds, then what it is told once
HOTTEST, REMAINING, _TICKS, _EVERY, _DT, _ALPHA, _REFERENCE, _LIMIT = range(8)
_C_WINDING, _C_BODY, _INNER, _OUTER, _AMBIENT = range(8, 13)
#: rows of the coils: temperatures [K], i²R at the reference temperature, averaged [W], and resistance there [Ω]
WINDING, BODY, LOAD, _RESISTANCE = range(4)


@kernel
def observe(numbers: Array, coils: Array, currents: Array, boundary: Array) -> float:
    """One tick with measured `currents` (m,) [A] and `boundary` temperatures (m,) [K]; returns the hottest winding [K].

    numbers (13,) and coils (4, m) are a `HeatObserver`'s memory. NaN if any winding is.
    """
    n, dt, weight = numbers, numbers[_DT], min(numbers[_DT] / _LOAD_WINDOW, 1.0)
    hottest = -np.inf
    for j in range(currents.size):
        if n[_TICKS] == 0.0:  # a device that was used a minute ago starts warm
            coils[BODY, j] = coils[WINDING, j] = boundary[j]
        winding, body = coils[WINDING, j], coils[BODY, j]
        cold = currents[j] ** 2 * coils[_RESISTANCE, j]
        inward = n[_INNER] * (winding - body)
        winding += dt * (cold * (1.0 + n[_ALPHA] * (winding - n[_REFERENCE])) - inward) / n[_C_WINDING]
        outward = n[_OUTER] * (body - n[_AMBIENT])
        coils[WINDING, j] = winding
        coils[BODY, j] += dt * ((inward - outward) / n[_C_BODY] + _PULL * (boundary[j] - body))
        coils[LOAD, j] += weight * (cold - coils[LOAD, j])
        if winding > hottest or winding != winding:  # once not a number, never again below a limit
            hottest = winding
    n[HOTTEST] = hottest
    if n[_TICKS] % n[_EVERY] == 0.0:
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

    numbers  (13,) and coils (4, m): all that it remembers, for compiled code
    """

    def __init__(self, coils: Coils, dt: float) -> None:
        heat, channels = coils.heat, len(coils.names)
        self.numbers: Array = np.array(
            [
                heat.ambient, np.inf, 0.0, max(1, round(0.02 / dt)), dt, coils.temperature_coefficient,
                coils.reference_temperature, heat.derate, heat.winding_capacity, heat.body_capacity,
                heat.winding_to_body, heat.body_to_air, heat.ambient,
            ]
        )  # fmt: skip
        self.coils: Array = np.zeros((4, channels))
        self.coils[_RESISTANCE] = coils.resistance
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

    def update(self, currents: Array, boundary: Array) -> None:
        """One tick with measured `currents` (m,) [A] and `boundary` temperatures (m,) [K]."""
        observe(self.numbers, self.coils, currents, boundary)
