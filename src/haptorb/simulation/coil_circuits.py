"""Electrical and thermal model of the simulated coils: chopped supply, resistance, inductance, back-EMF, and heat.

Every step is exact for constant duty, back-EMF and resistance: the current is an exponential with a known mean square,
and the heat a matrix, of two nodes per coil or of all coils with the core. Neglected: the chopper's ripple (its period
is short compared with L/R), mutual inductance between the nearly orthogonal coils, and eddy currents in the core.
"""

from __future__ import annotations

import numpy as np

from haptorb.arrays import Array, Record, Records, fields
from haptorb.compiled import kernel, tick_kernel
from haptorb.devices.base import Device
from haptorb.thermal import heat_step, network_step, warm_ratio

__all__ = ["COIL", "chop", "coil_step", "cold_coils", "network_coil_step"]


#: One record per coil: parameters and state.
COIL = fields(
    ("resistance", "f8"),  # at the reference temperature [Ω]
    ("inductance", "f8"),  # [H]
    ("voltage", "f8"),  # of the supply [V]
    ("coefficient", "f8"),  # of the resistance [1/K]
    ("reference", "f8"),  # temperature [K]
    ("ambient", "f8"),  # temperature [K]
    ("duty", "f8"),  # −1 to 1
    ("emf", "f8"),  # back-EMF of the moving mover [V]
    ("current", "f8"),  # [A]
    ("winding", "f8"),  # temperature [K]
    ("body", "f8"),  # temperature [K]
    ("mean", "f8"),  # current of the last step [A]
)


def cold_coils(device: Device) -> Records:
    """(m,) COIL of `device`: no current, all temperatures ambient."""
    coils = device.coils
    made = np.zeros(device.channels, dtype=COIL)
    made["resistance"], made["inductance"] = coils.resistance, coils.inductance
    made["voltage"] = device.supply.voltage
    made["coefficient"], made["reference"] = coils.temperature_coefficient, coils.reference_temperature
    made["ambient"] = made["winding"] = made["body"] = coils.heat.ambient
    return made


@tick_kernel
def chop(duties: Array, steps: float, out: Array) -> None:
    """Clip `duties` (m,) to −1…1 and round their magnitudes to 1/steps; non-finite values become zero."""
    for k in range(duties.shape[0]):
        duty = duties[k]
        if not np.isfinite(duty):
            duty = 0.0
        out[k] = np.rint(min(max(duty, -1.0), 1.0) * steps) / steps


@kernel
def _drive(c: Record, dt: float) -> float:
    """Advance the current of a COIL by `dt` [s] under its duty and emf; returns the mean heating power [W]."""
    resistance = c.resistance * warm_ratio(c.coefficient, c.reference, c.winding)
    end = (c.duty * c.voltage - c.emf) / resistance
    gap = c.current - end
    x = resistance * dt / c.inductance
    gone = -np.expm1(-x)
    share = gone / x if x > 0.0 else 1.0  # mean of the decaying part, and of its square
    c.mean = end + gap * share
    square = end * end + 2.0 * end * gap * share + gap * gap * share * (1.0 - 0.5 * gone)
    c.current = end + gap * (1.0 - gone)
    return float(resistance * square)


@kernel
def coil_step(coils: Records, heat: Array, dt: float) -> None:
    """Advance uncoupled `coils`, (m,) COIL, by `dt` [s] under their duties and emf.

    heat (2, 3) is `TwoNode.step(dt)`.
    """
    for k in range(coils.size):
        c = coils[k]
        power = _drive(c, dt)
        c.winding, c.body = heat_step(heat, c.winding, c.body, c.ambient, power)


@kernel
def network_coil_step(coils: Records, heat: Array, core: float, dt: float) -> float:
    """Advance `coils`, (m,) COIL, by `dt` [s] under their duties and emf; returns the core's new temperature [K].

    heat (2 m + 1, 3 m + 1) is the step of a `ThermalNetwork` of windings, bodies and a core, which is at `core` [K].
    """
    m = coils.size
    rises, after, power = np.empty(2 * m + 1), np.empty(2 * m + 1), np.empty(m)
    ambient = coils[0].ambient
    for k in range(m):
        c = coils[k]
        rises[k], rises[m + k] = c.winding - ambient, c.body - ambient
        power[k] = _drive(c, dt)
    rises[2 * m] = core - ambient
    network_step(heat, rises, power, after)
    for k in range(m):
        coils[k].winding, coils[k].body = ambient + after[k], ambient + after[m + k]
    return float(ambient + after[2 * m])
