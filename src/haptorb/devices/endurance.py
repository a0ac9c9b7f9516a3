"""How long a channel may be loaded from cold before its winding reaches the temperature where currents are reduced."""

from __future__ import annotations

import numpy as np

from haptorb.devices.device import Device

__all__ = ["endurance"]


def endurance(device: Device, shares: tuple[float, ...] = (1.0, 0.75, 0.5, 0.25)) -> tuple[tuple[float, float], ...]:
    """(share of full current, seconds until derating or inf) for the channel that heats fastest, alone."""
    coils, heat = device.coils, device.coils.heat
    # Of coils that warm no other the one that heats fastest is all there is to compute.
    model = heat.network(device.channels) if heat.coupling is not None else heat.network(1)
    cold = coils.resistance_at(np.full(device.channels, heat.ambient))
    alpha = coils.temperature_coefficient / (
        1 + coils.temperature_coefficient * (heat.ambient - coils.reference_temperature)
    )
    rows = []
    for share in shares:
        powers = (share * coils.current_limit) ** 2 * cold
        load = np.zeros(model.windings)
        load[int(np.argmax(powers)) if model.windings > 1 else 0] = powers.max()
        rows.append((share, model.time_to(heat.derate - heat.ambient, load, drive="current", coefficient=alpha)))
    return tuple(rows)
