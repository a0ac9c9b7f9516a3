"""The coils as an electrician meets them: chopped supply, R and L in series, resistance and heat that follow the load.

Every step is exact for a duty, an electromotive force and a resistance held in it: the current is an exponential, its
square's mean is known, and the heat is a matrix: of two nodes each, or of all coils and what lies between them. Left
out: the chopper's ripple (its period is short against L/R), mutual inductance between the nearly orthogonal coils, and
eddy currents in the core.
"""

from __future__ import annotations

import numpy as np

from haptorb.devices.device import Device
from haptorb.numerics.arrays import Array, Record, Records, fields
from haptorb.numerics.compiled import kernel, tick_kernel
from haptorb.physics.thermal import heat_step
from haptorb.physics.thermal_network import network_step

__all__ = ["COIL", "chop", "coil_step", "cold_coils", "network_coil_step"]

#: Of each coil: what does not change about it, and how it is now.
COIL = fields(
    ("resistance", "f8"),  # at the reference temperature [Ω]
    ("inductance", "f8"),  # [H]
    ("voltage", "f8"),  # of the supply [V]
    ("coefficient", "f8"),  # of the resistance [1/K]
    ("reference", "f8"),  # temperature [K]
    ("ambient", "f8"),  # temperature [K]
    ("duty", "f8"),  # −1 to 1
    ("emf", "f8"),  # that the moving mover induces against the current [V]
    ("current", "f8"),  # [A]
    ("winding", "f8"),  # temperature [K]
    ("body", "f8"),  # temperature [K]
    ("mean", "f8"),  # current of the last step [A]
)


def cold_coils(device: Device) -> Records:
    """(m,) COIL of `device`: no current, everything at the ambient temperature."""
    coils = device.coils
    made = np.zeros(device.channels, dtype=COIL)
    made["resistance"], made["inductance"] = coils.resistance, coils.inductance
    made["voltage"] = device.supply.voltage
    made["coefficient"], made["reference"] = coils.temperature_coefficient, coils.reference_temperature
    made["ambient"] = made["winding"] = made["body"] = coils.heat.ambient
    return made


@tick_kernel
def chop(duties: Array, steps: float, out: Array) -> None:
    """Clip `duties` (m,) to −1…1 and round their magnitudes to 1/steps; what is not finite becomes zero."""
    for k in range(duties.shape[0]):
        duty = duties[k]
        if not np.isfinite(duty):
            duty = 0.0
        out[k] = np.rint(min(max(duty, -1.0), 1.0) * steps) / steps


@kernel
def _drive(c: Record, dt: float) -> float:
    """Advance the current of a COIL by `dt` [s] under its duty and emf; the mean power that heats it meanwhile [W]."""
    resistance = c.resistance * (1.0 + c.coefficient * (c.winding - c.reference))
    end = (c.duty * c.voltage - c.emf) / resistance
    gap = c.current - end
    x = resistance * dt / c.inductance
    gone = -np.expm1(-x)
    share = gone / x if x > 0.0 else 1.0  # mean of the decaying part; the mean of its square too
    c.mean = end + gap * share
    square = end * end + 2.0 * end * gap * share + gap * gap * share * (1.0 - 0.5 * gone)
    c.current = end + gap * (1.0 - gone)
    return float(resistance * square)


@kernel
def coil_step(coils: Records, heat: Array, dt: float) -> None:
    """Advance `coils`, (m,) COIL, that do not warm each other by `dt` [s] under their duties and emf.

    heat (2, 3) is `TwoNode.step(dt)`.
    """
    for k in range(coils.size):
        c = coils[k]
        power = _drive(c, dt)
        c.winding, c.body = heat_step(heat, c.winding, c.body, c.ambient, power)


@kernel
def network_coil_step(coils: Records, heat: Array, core: float, dt: float) -> float:
    """Advance `coils`, (m,) COIL, by `dt` [s] under their duties and emf; the core's temperature after it [K].

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
