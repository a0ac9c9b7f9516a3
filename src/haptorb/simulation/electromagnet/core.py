"""The simulated core: a part of its moment lags behind the currents, a part stays when they are gone."""

from __future__ import annotations

import numpy as np

from haptorb.devices.electromagnet.core_dynamics import CoreDynamics
from haptorb.numerics.arrays import Array, Record, Records, fields
from haptorb.numerics.compiled import kernel

__all__ = ["CORE", "core_step", "make_core"]

#: How the core departs from one that follows the currents at once.
CORE = fields(
    ("share", "f8"),  # of the moment that lags
    ("time", "f8"),  # constant of the lag [s]
    ("remanent", "f8"),  # moment that stays along an axis [A·m²]
    ("reversing", "f8"),  # change of the moment that reduces the remanence from full to zero [A·m²]
    ("lagging", "f8", (3,)),  # the moment through the lag [A·m²]
    ("play", "f8", (3,)),  # the moment through the play [A·m²]
    ("extra", "f8", (3,)),  # moment beside that of the currents [A·m²]
)


def make_core(dynamics: CoreDynamics) -> Records:
    """(1,) CORE without any history."""
    made = np.zeros(1, dtype=CORE)
    made["share"], made["time"] = dynamics.eddy_share, dynamics.eddy_time
    made["remanent"], made["reversing"] = dynamics.remanent_moment, dynamics.reversing_moment
    return made


@kernel
def core_step(core: Record, moment_per_current: Array, coils: Records, dt: float) -> None:
    """Advance a CORE by `dt` [s], in which the mean currents of `coils` (m,) flow; moment_per_current (3, m) [m²]."""
    gone = -np.expm1(-dt / core.time)
    for a in range(3):
        moment = 0.0
        for k in range(coils.size):
            moment += moment_per_current[a, k] * coils[k].mean
        core.lagging[a] += gone * (moment - core.lagging[a])
        core.play[a] = max(moment - core.reversing, min(moment + core.reversing, core.play[a]))
        stays = core.remanent * (core.play[a] - moment) / core.reversing
        core.extra[a] = stays - core.share * (moment - core.lagging[a])
