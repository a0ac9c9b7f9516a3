"""Simulated magnetic core: eddy-current lag, remanence with hysteresis, and saturation of its moment.

A ball of permeability µ has the moment 3V/µ0 (µ − 1)/(µ + 2) B. As its magnetisation M approaches saturation M_s,
µ − 1 falls as 1 − |M|/M_s (Fröhlich and Kennelly: M = χH/(1 + χH/M_s)), and the moment by 3/(µ − 1) |M|/(M_s − |M|),
relative: negligible below half of M_s, because of the demagnetising field of a ball. `devices.core_parameters` has
the values of lag and remanence.
"""

from __future__ import annotations

import numpy as np

from haptorb.arrays import Array, Record, Records, fields
from haptorb.compiled import kernel
from haptorb.devices.core_parameters import CoreDynamics
from haptorb.magnetics.dipole import MU0
from haptorb.magnetics.soft_sphere import SoftSphere

__all__ = ["CORE", "core_step", "make_core"]

_MAX_SATURATION_SHARE = 0.9  #: share of saturation up to which the model is evaluated

#: Departure of the core from an ideal one without lag, remanence and saturation.
CORE = fields(
    ("share", "f8"),  # lagging share of the moment
    ("time", "f8"),  # time constant of the lag [s]
    ("remanent", "f8"),  # remanent moment along an axis [A·m²]
    ("reversing", "f8"),  # change of the moment that reduces the remanence from maximum to zero [A·m²]
    ("saturation", "f8"),  # saturation moment [A·m²]
    ("softness", "f8"),  # 3/(µ − 1)
    ("lagging", "f8", (3,)),  # moment after the first-order lag [A·m²]
    ("play", "f8", (3,)),  # moment after the hysteresis (play) operator [A·m²]
    ("extra", "f8", (3,)),  # moment in addition to that of the currents [A·m²]
)


def make_core(dynamics: CoreDynamics, core: SoftSphere | None = None, saturation: float = np.inf) -> Records:
    """(1,) CORE in the initial, demagnetised state; `core` saturates at the flux density `saturation` [T]."""
    made = np.zeros(1, dtype=CORE)
    made["saturation"] = np.inf
    if core is not None:
        made["saturation"] = 4 * np.pi / 3 * core.radius**3 * saturation / MU0
        made["softness"] = 3.0 / (core.permeability - 1.0)
    made["share"], made["time"] = dynamics.eddy_share, dynamics.eddy_time
    made["remanent"], made["reversing"] = dynamics.remanent_moment, dynamics.reversing_moment
    return made


@kernel
def core_step(core: Record, moment_per_current: Array, coils: Records, dt: float) -> None:
    """Advance a CORE by `dt` [s] under the mean currents of `coils` (m,).

    moment_per_current (6, m) [m²]: of coils and core together, and below that of the core alone, which saturates.
    """
    gone, square = -np.expm1(-dt / core.time), 0.0
    for a in range(3):
        moment, own = 0.0, 0.0
        for k in range(coils.size):
            moment += moment_per_current[a, k] * coils[k].mean
            own += moment_per_current[3 + a, k] * coils[k].mean
        square += own * own
        core.lagging[a] += gone * (moment - core.lagging[a])
        core.play[a] = max(moment - core.reversing, min(moment + core.reversing, core.play[a]))
        stays = core.remanent * (core.play[a] - moment) / core.reversing
        core.extra[a] = stays - core.share * (moment - core.lagging[a])
    full = min(np.sqrt(square) / core.saturation, _MAX_SATURATION_SHARE)
    lost = core.softness * full / (1.0 - full)
    for a in range(3):
        for k in range(coils.size):
            core.extra[a] -= lost * moment_per_current[3 + a, k] * coils[k].mean
