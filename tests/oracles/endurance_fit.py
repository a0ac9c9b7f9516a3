"""Two-node thermal model with the three endurances that Zárate 2020 prints of its coils."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from haptorb.errors import InputError
from haptorb.thermal import TwoNode

__all__ = ["endurance_fit"]


def endurance_fit(
    limit_rise: float = 60.0,
    *,
    sustained: float = 17.0,
    full: float = 240.0,
    full_time: float = 5.0,
    half: float = 60.0,
    half_time: float = 60.0,
    inside: float = 0.15,
) -> TwoNode:
    """The two bodies that end at `limit_rise` [K] in all three endurances, started cold.

    sustained, full, half [W]; full_time, half_time [s]. Full power is 20 A through 0.6 Ω (erratum E15), half duty a
    quarter of it. Three figures leave one of four values open: `inside` is the share of the whole thermal resistance
    that lies between winding and body. Raises InputError where no such two bodies exist.

    At 60 K (25 → 85 °C) and the default share: 15.05 J/K, 72.9 J/K, 1.889 W/K, 0.333 W/K. All four go
    with 1/limit_rise.

    >>> coil = endurance_fit(60.0)
    >>> [round(coil.time_to(60.0, power), 3) for power in (240.0, 60.0)]
    [5.0, 60.0]
    """
    values = (limit_rise, sustained, full, full_time, half, half_time)
    if not all(np.isfinite(value) and value > 0.0 for value in values) or not 0.0 < inside < 1.0:
        raise InputError(f"all must be positive and finite and 0 < inside < 1; got {values} and inside = {inside}")
    if not full > half > sustained or full_time >= half_time:
        raise InputError("needs full > half > sustained and full_time < half_time")
    resistance = limit_rise / sustained
    to_body, to_air = 1 / (inside * resistance), 1 / ((1 - inside) * resistance)

    def coil(body_capacity: float) -> TwoNode | None:
        """The coil with this body that stands full power for full_time, if a winding can do it."""

        def excess(winding_capacity: float) -> float:
            model = TwoNode(winding_capacity, body_capacity, to_body, to_air)
            return float(model.rise(full_time, full)[0]) - limit_rise

        # All heat in the winding is the most that it must store.
        low, high = 1e-6 * full * full_time / limit_rise, full * full_time / limit_rise
        if excess(low) <= 0.0:
            return None  # even a winding without capacity stays below: the body alone takes the heat
        return TwoNode(brentq(excess, low, high, xtol=1e-14, rtol=1e-12), body_capacity, to_body, to_air)

    def late(log_capacity: float) -> float:
        model = coil(float(np.exp(log_capacity)))
        return float("nan") if model is None else float(model.rise(half_time, half)[0]) - limit_rise

    scale = np.log(half * half_time / limit_rise)
    grid = np.linspace(scale - 7, scale + 5, 49)
    excesses = np.array([late(value) for value in grid])
    crossing = np.flatnonzero((excesses[:-1] > 0.0) & (excesses[1:] <= 0.0))
    if not len(crossing):
        raise InputError(
            f"no two-body model with {inside:.0%} of the thermal resistance inside withstands {full:g} W for "
            f"{full_time:g} s, {half:g} W for {half_time:g} s and {sustained:g} W continuously; choose another `inside`"
        )
    at = int(crossing[0])
    found = coil(float(np.exp(brentq(late, grid[at], grid[at + 1], xtol=1e-12, rtol=1e-12))))
    if found is None:  # pragma: no cover - both ends of the bracket have a winding, so what lies between has one
        raise InputError("the endurance figures are at the limit of the two-body model; choose another `inside`")
    return found
