"""How hot the windings are, and how long the present load may last: a two-node model fed with measured currents.

The copper cannot be touched by a thermometer; its temperature is integrated from i²R, and the body node is pulled
gently to the boundary thermometer, so that a wrong start or a wrong room is forgotten within seconds.
"""

from __future__ import annotations

import numpy as np

from haptorb.devices.device import Coils
from haptorb.physics.arrays import Array
from haptorb.physics.compiled import kernel

__all__ = ["HeatObserver"]

_PULL = 0.5  #: rate at which the body follows the thermometer [1/s]
_LOAD_WINDOW = 1.0  #: over which the present load is averaged [s]


@kernel
def _observe(
    dt: float,
    currents: Array,
    boundary: Array,
    resistance: Array,
    alpha: float,
    reference: float,
    heat: Array,
    winding: Array,
    body: Array,
    mean_load: Array,
) -> float:
    """One step; returns the hottest winding [K], NaN if any is."""
    hottest = -np.inf
    c_winding, c_body, g_inner, g_outer, ambient = heat[0], heat[1], heat[2], heat[3], heat[4]
    for j in range(currents.size):
        load = currents[j] ** 2 * resistance[j] * (1.0 + alpha * (winding[j] - reference))
        inward = g_inner * (winding[j] - body[j])
        winding[j] += dt * (load - inward) / c_winding
        body[j] += dt * ((inward - g_outer * (body[j] - ambient)) / c_body + _PULL * (boundary[j] - body[j]))
        mean_load[j] += min(dt / _LOAD_WINDOW, 1.0) * (currents[j] ** 2 * resistance[j] - mean_load[j])
        if winding[j] > hottest or winding[j] != winding[j]:  # once not a number, never again below a limit
            hottest = winding[j]
    return hottest


@kernel
def _remaining(
    winding: Array, body: Array, load: Array, alpha: float, reference: float, heat: Array, limit: float
) -> float:
    """Shortest time over the channels until the winding reaches `limit` at constant current; inf if never.

    `load` is i²R at the reference temperature. Warm copper takes more power from the same current, which makes the
    two-node equations no less linear: only the winding's own rate changes, and may change sign (thermal runaway).
    """
    c_winding, c_body, g_inner, g_outer, ambient = heat[0], heat[1], heat[2], heat[3], heat[4]
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
    """Winding temperatures (m,) [K] and the time that is left; one `update` per tick."""

    def __init__(self, coils: Coils, dt: float) -> None:
        heat = coils.heat
        self._dt = dt
        self._coils = coils
        self._heat = np.array(
            [heat.winding_capacity, heat.body_capacity, heat.winding_to_body, heat.body_to_air, heat.ambient]
        )
        channels = len(coils.names)
        self.winding = np.full(channels, heat.ambient)
        self.body = np.full(channels, heat.ambient)
        self.load = np.zeros(channels)  #: i²R at the reference temperature, averaged [W]
        self.hottest = heat.ambient
        self.remaining = np.inf
        self._ticks = 0
        self._prediction_every = max(1, round(0.02 / dt))

    def update(self, currents: Array, boundary: Array) -> None:
        """One tick with measured `currents` (m,) [A] and `boundary` temperatures (m,) [K]."""
        if self._ticks == 0:  # a device that was used a minute ago starts warm
            self.body[:] = boundary
            self.winding[:] = boundary
        coils = self._coils
        self.hottest = _observe(
            self._dt,
            currents,
            boundary,
            coils.resistance,
            coils.temperature_coefficient,
            coils.reference_temperature,
            self._heat,
            self.winding,
            self.body,
            self.load,
        )
        if self._ticks % self._prediction_every == 0:
            self.remaining = _remaining(
                self.winding,
                self.body,
                self.load,
                coils.temperature_coefficient,
                coils.reference_temperature,
                self._heat,
                coils.heat.derate,
            )
        self._ticks += 1
