"""Reference wrench on the tool: computed by another method, more accurately than in loop and simulation.

Many charges on the ring's faces, at each of them the field of the windings in closed form with the core's response (of
dipoles if the sizes are unknown), and the core's response to the ring charge by charge from the series: no tables, and
no kernels shared with the controller's model.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, check_finite
from haptorb.devices.base import State
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.magnetics import dipole
from haptorb.magnetics.magnets import ChargedRing
from haptorb.magnetics.soft_sphere import SoftSphere

__all__ = ["true_wrench"]


def true_wrench(
    device: SphericalElectromagnet, state: State, currents: ArrayLike, *, radial: int = 4, azimuth: int = 16
) -> Array:
    """(6,) force [N] and torque about the magnet [N·m] at `state` under `currents` (m,) [A], with the core's
    attraction.

    >>> from haptorb.devices.loader import load
    >>> round(1e3 * float(true_wrench(load("omni"), State.at((0, 0, 0.05)), (0, 0, 0))[2]), 1)    # erratum E18
    -52.9
    """
    tool = device.tool
    ring = ChargedRing(
        tool.outer_radius, tool.inner_radius, tool.length, tool.remanence, radial=radial, azimuth=azimuth
    )
    at, q = ring.points @ state.R_SR.T + state.p, ring.charges
    amperes = check_finite(currents, "currents")
    if device.windings is not None and device.has_sizes:
        known = device.core, device.moment_per_current, device.moments_at
        forces = q[:, None] * (device.windings.field(*known, at, closed=True) @ amperes)
    else:
        forces = q[:, None] * dipole.field(np.broadcast_to(device.moment_per_current @ amperes, at.shape), at)
    forces = forces + SoftSphere(device.core_radius, device.core_permeability).forces(at, q, precision=1e-9)
    return np.concatenate([forces.sum(axis=0), np.cross(at - state.p, forces).sum(axis=0)])
