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
_POWER_WINDOW = 1.0  #: over which the present load is averaged [s]


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
    power: Array,
) -> None:
    c_winding, c_body, g_inner, g_outer, ambient = heat[0], heat[1], heat[2], heat[3], heat[4]
    for j in range(currents.size):
        load = currents[j] ** 2 * resistance[j] * (1.0 + alpha * (winding[j] - reference))
        inward = g_inner * (winding[j] - body[j])
        winding[j] += dt * (load - inward) / c_winding
        body[j] += dt * ((inward - g_outer * (body[j] - ambient)) / c_body + _PULL * (boundary[j] - body[j]))
        power[j] += min(dt / _POWER_WINDOW, 1.0) * (load - power[j])


@kernel
def _remaining(winding: Array, body: Array, power: Array, heat: Array, limit: float) -> float:
    """Shortest time over the channels until the winding reaches `limit` at constant `power`; inf if never."""
    c_winding, c_body, g_inner, g_outer, ambient = heat[0], heat[1], heat[2], heat[3], heat[4]
    a, b, d = g_inner / c_winding, g_inner / c_body, (g_inner + g_outer) / c_body
    root = np.sqrt((a - d) ** 2 + 4.0 * a * b)
    fast, slow = 0.5 * (a + d + root), 0.5 * (a + d - root)
    shortest = np.inf
    for j in range(winding.size):
        if winding[j] >= limit:
            return 0.0
        end_body = ambient + power[j] / g_outer
        end = end_body + power[j] / g_inner
        if end <= limit:
            continue
        # θ(t) = end + p e^(−fast t) + q e^(−slow t), from the state now and its slope
        start = winding[j] - end
        slope = power[j] / c_winding - a * (winding[j] - body[j])
        q = (slope + fast * start) / (fast - slow)
        p = start - q
        low, high = 0.0, 50.0 / slow
        for _ in range(40):
            middle = 0.5 * (low + high)
            if end + p * np.exp(-fast * middle) + q * np.exp(-slow * middle) < limit:
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
        self.power = np.zeros(channels)
        self.remaining = np.inf
        self._ticks = 0
        self._prediction_every = max(1, round(0.02 / dt))

    def update(self, currents: Array, boundary: Array) -> None:
        """One tick with measured `currents` (m,) [A] and `boundary` temperatures (m,) [K]."""
        if self._ticks == 0:  # a device that was used a minute ago starts warm
            self.body[:] = boundary
            self.winding[:] = boundary
        coils = self._coils
        _observe(
            self._dt,
            currents,
            boundary,
            coils.resistance,
            coils.temperature_coefficient,
            coils.reference_temperature,
            self._heat,
            self.winding,
            self.body,
            self.power,
        )
        if self._ticks % self._prediction_every == 0:
            self.remaining = _remaining(self.winding, self.body, self.power, self._heat, coils.heat.derate)
        self._ticks += 1
