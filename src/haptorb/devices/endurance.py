"""How long a channel may be loaded from cold before its winding reaches the temperature where currents are reduced."""

from __future__ import annotations

import numpy as np

from haptorb.devices.device import Device
from haptorb.physics.thermal import TwoNode

__all__ = ["endurance"]


def endurance(device: Device, shares: tuple[float, ...] = (1.0, 0.75, 0.5, 0.25)) -> tuple[tuple[float, float], ...]:
    """(share of full current, seconds until derating or inf) for the channel that heats fastest, the current held."""
    coils, heat = device.coils, device.coils.heat
    model = TwoNode(heat.winding_capacity, heat.body_capacity, heat.winding_to_body, heat.body_to_air)
    cold = coils.resistance_at(np.full(device.channels, heat.ambient))
    alpha = coils.temperature_coefficient / (
        1 + coils.temperature_coefficient * (heat.ambient - coils.reference_temperature)
    )
    rows = []
    for share in shares:
        power = float(np.max((share * coils.current_limit) ** 2 * cold))
        rows.append((share, model.time_to(heat.derate - heat.ambient, power, drive="current", coefficient=alpha)))
    return tuple(rows)
