"""The coils as an electrician meets them: chopped supply, R and L in series, resistance and heat that follow the load.

Every step is exact for a duty, an electromotive force and a resistance held in it: the current is an exponential, its
square's mean is known, and the two-node heat is a matrix. Left out: the chopper's ripple (its period is short against
L/R), mutual inductance between the nearly orthogonal coils, and eddy currents in the core.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from haptorb.devices.device import Device
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.physics.thermal import heat_step

__all__ = ["BODY", "CURRENT", "WINDING", "CoilConstants", "chop", "coil_step", "cold", "wires"]

#: rows of a coil state, shape (3, m): current [A], winding and body temperature [K]
CURRENT, WINDING, BODY = 0, 1, 2


class CoilConstants(NamedTuple):
    """What does not change about the coils."""

    resistance: Array  #: (m,) at the reference temperature [Ω]
    inductance: Array  #: (m,) [H]
    voltage: float  #: [V]
    coefficient: float  #: [1/K]
    reference: float  #: [K]
    ambient: float  #: [K]


def wires(device: Device) -> CoilConstants:
    """The coils of `device`, copied into arrays that compiled code may keep."""
    coils = device.coils
    return CoilConstants(
        np.array(coils.resistance, dtype=np.float64),
        np.array(coils.inductance, dtype=np.float64),
        float(device.supply.voltage),
        float(coils.temperature_coefficient),
        float(coils.reference_temperature),
        float(coils.heat.ambient),
    )


def cold(wires: CoilConstants) -> Array:
    """(3, m) a coil state with no current, everything at the ambient temperature.

    Rows: current [A], winding [K], body [K].
    """
    state = np.zeros((3, len(wires.resistance)))
    state[WINDING:] = wires.ambient
    return state


@kernel
def chop(duties: Array, steps: float, out: Array) -> None:
    """Clip `duties` (m,) to −1…1 and round their magnitudes to 1/steps; what is not finite becomes zero."""
    for k in range(duties.shape[0]):
        duty = duties[k]
        if not np.isfinite(duty):
            duty = 0.0
        out[k] = np.rint(min(max(duty, -1.0), 1.0) * steps) / steps


@kernel
def coil_step(
    state: Array, wires: CoilConstants, heat: Array, duties: Array, emf: Array, dt: float, mean: Array
) -> None:
    """Advance `state` (3, m) by `dt` [s]; `mean` (m,) [A] becomes the mean current in it.

    emf (m,) [V] is what the moving tool induces against the current; heat (2, 3) is `TwoNode.step(dt)`.
    """
    for k in range(duties.shape[0]):
        winding = state[WINDING, k]
        resistance = wires.resistance[k] * (1.0 + wires.coefficient * (winding - wires.reference))
        end = (duties[k] * wires.voltage - emf[k]) / resistance
        gap = state[CURRENT, k] - end
        x = resistance * dt / wires.inductance[k]
        gone = -np.expm1(-x)
        share = gone / x if x > 0.0 else 1.0  # mean of the decaying part; its square's mean likewise
        mean[k] = end + gap * share
        square = end * end + 2.0 * end * gap * share + gap * gap * share * (1.0 - 0.5 * gone)
        state[CURRENT, k] = end + gap * (1.0 - gone)
        state[WINDING, k], state[BODY, k] = heat_step(heat, winding, state[BODY, k], wires.ambient, resistance * square)
